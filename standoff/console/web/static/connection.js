// The one websocket of a page: says hello, passes messages on, and notices when it is lost.
//
// The console says something ten times a second. A connection that is silent is lost, whatever the
// browser says of it: it may be open for minutes after the console has stopped.

const REPLACED = 4001;
const RETRY_MS = 1000;
const TICK_MS = 100;
const SILENT_MS = 1200; // silent for so long, it is lost
const ABANDON_MS = 5000; // silent for so long, another one is opened beside it
const PING_MS = 500;
const CLOCKS = 20;

export const seconds = (ms) => `${(ms / 1000).toFixed(ms < 9950 ? 1 : 0)} s`;

export function randomHex(bytes) {
  return [...crypto.getRandomValues(new Uint8Array(bytes))].map((byte) => byte.toString(16).padStart(2, "0")).join("");
}

function identity() {
  let own = sessionStorage.getItem("viewer");
  if (!own) {
    own = randomHex(16);
    sessionStorage.setItem("viewer", own);
  }
  return own;
}

export class Connection extends EventTarget {
  constructor({ pictures }) {
    super();
    this.pictures = pictures;
    this.isOpen = false; // and has been heard of just now
    this.socket = null;
    this.state = {};
    this.clocks = []; // how far the console's clock is ahead of this page's, with the round trip
    this.heardMs = this.tickedMs = performance.now();
    this.open();
    setInterval(() => this.tick(), TICK_MS);
  }

  open() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/live`);
    socket.binaryType = "arraybuffer";
    Object.assign(this, { socket, begunMs: performance.now(), pings: new Map(), pinged: 0, pingedMs: 0, roundTripMs: 0, answerMs: undefined, clocks: [] });
    socket.onopen = () => {
      if (this.socket === socket) this.pass("hello", { viewer: identity(), name: operator(), pictures: this.pictures });
    };
    socket.onmessage = ({ data }) => {
      if (this.socket !== socket) return;
      this.heard();
      if (data instanceof ArrayBuffer) {
        this.dispatchEvent(new CustomEvent("picture", { detail: data }));
        return;
      }
      const message = JSON.parse(data);
      if (message.type === "pong") this.answered(message);
      // What has not become different is not sent again.
      if (message.type === "state") this.state = { ...this.state, ...message };
      this.dispatchEvent(new CustomEvent(message.type, { detail: message.type === "state" ? this.state : message }));
    };
    socket.onclose = ({ code }) => {
      if (this.socket !== socket) return;
      // This tab was duplicated: it continues as a page of its own.
      if (code === REPLACED) sessionStorage.removeItem("viewer");
      this.lose();
      setTimeout(() => { if (this.socket === socket) this.open(); }, RETRY_MS);
    };
  }

  heard() {
    this.heardMs = performance.now();
    if (this.isOpen) return;
    this.isOpen = true;
    this.dispatchEvent(new CustomEvent("open"));
  }

  lose() {
    if (!this.isOpen && this.wasTold) return;
    this.isOpen = false;
    this.wasTold = true; // that there is none, if there never was one
    this.dispatchEvent(new CustomEvent("lost"));
  }

  tick() {
    const now = performance.now();
    // A page that was asleep, or had no processor, has first to read what came meanwhile.
    const isAwake = now - this.tickedMs < 5 * TICK_MS;
    this.tickedMs = now;
    if (isAwake && this.silentMs > SILENT_MS) this.lose();
    if (isAwake && this.silentMs > ABANDON_MS && now - this.begunMs > ABANDON_MS && this.socket.readyState !== WebSocket.CLOSED) {
      const silent = this.socket;
      this.open();
      silent.close();
    }
    if (this.socket.readyState === WebSocket.OPEN && now - this.pingedMs > PING_MS) {
      this.pingedMs = now;
      this.pinged += 1;
      this.pings.set(this.pinged, now);
      this.pass("ping", { number: this.pinged, round_trip_ms: this.answerMs });
      this.answerMs = undefined;
    }
    this.dispatchEvent(new CustomEvent("tick"));
  }

  answered({ number, now_ms: consoleMs }) {
    const sentMs = this.pings.get(number);
    if (sentMs !== undefined) {
      const now = performance.now();
      this.roundTripMs = this.answerMs = now - sentMs;
      this.clocks.push({ roundTripMs: this.roundTripMs, aheadMs: consoleMs - performance.timeOrigin - (sentMs + now) / 2 });
      if (this.clocks.length > CLOCKS) this.clocks.shift();
    }
    for (const each of this.pings.keys()) if (each <= number) this.pings.delete(each);
  }

  // The console's time in ms since 1970, by the answer that took least.
  get consoleMs() {
    const best = this.clocks.reduce((one, other) => (one && one.roundTripMs <= other.roundTripMs ? one : other), null);
    return performance.timeOrigin + performance.now() + (best?.aheadMs ?? 0);
  }

  get silentMs() { return performance.now() - this.heardMs; }

  // Of the last answer, or of the one that is awaited if that takes longer already.
  get latencyMs() {
    const [oldestMs] = this.pings.values();
    return Math.max(this.roundTripMs, oldestMs === undefined ? 0 : performance.now() - oldestMs);
  }

  send(what, fields = {}) { return this.isOpen && this.pass(what, fields); }

  // Send over a connection that may be lost: it arrives if that comes back.
  pass(what, fields = {}) {
    if (this.socket.readyState !== WebSocket.OPEN) return false;
    this.socket.send(JSON.stringify({ do: what, ...fields }));
    return true;
  }
}

export function operator() {
  return localStorage.getItem("operator") || "";
}
