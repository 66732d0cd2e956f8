// The one websocket of a page: says hello, passes messages on, reconnects when lost.

const REPLACED = 4001;
const RETRY_MS = 1000;

function identity() {
  let own = sessionStorage.getItem("viewer");
  if (!own) {
    own = [...crypto.getRandomValues(new Uint8Array(16))]
      .map((byte) => byte.toString(16).padStart(2, "0")).join("");
    sessionStorage.setItem("viewer", own);
  }
  return own;
}

export class Connection extends EventTarget {
  constructor({ pictures }) {
    super();
    this.pictures = pictures;
    this.isOpen = false;
    this.socket = null;
    this.open();
  }

  open() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/live`);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.onopen = () => {
      this.isOpen = true;
      this.send("hello", { viewer: identity(), name: operator(), pictures: this.pictures });
      this.dispatchEvent(new CustomEvent("open"));
    };
    socket.onmessage = ({ data }) => {
      if (data instanceof ArrayBuffer) {
        this.dispatchEvent(new CustomEvent("picture", { detail: data }));
        return;
      }
      const message = JSON.parse(data);
      this.dispatchEvent(new CustomEvent(message.type, { detail: message }));
    };
    socket.onclose = ({ code }) => {
      if (this.socket !== socket) return;
      this.isOpen = false;
      // This tab was duplicated: it continues as a page of its own.
      if (code === REPLACED) sessionStorage.removeItem("viewer");
      this.dispatchEvent(new CustomEvent("lost"));
      setTimeout(() => this.open(), RETRY_MS);
    };
  }

  send(what, fields = {}) {
    if (!this.isOpen) return false;
    this.socket.send(JSON.stringify({ do: what, ...fields }));
    return true;
  }
}

export function operator() {
  return localStorage.getItem("operator") || "";
}
