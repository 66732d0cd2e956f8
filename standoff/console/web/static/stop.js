// STOP: sent until the console says that it has heard it, and said in red while it has not. Heard is not stopped:
// the button is green only once the stage was seen at rest, and red where that is not so.

import { randomHex, seconds } from "./connection.js";

const TICK_MS = 100;
const AGAIN_MS = 500;
const UNHEARD_MS = 900;
const TOLD_MS = 2500;


export class Stop extends EventTarget {
  // `alert` is of a STOP that was not heard, `moving` of a stage that was not seen to stop; `tell` shows a line.
  constructor(connection, button, alert, moving, tell) {
    super();
    Object.assign(this, { connection, button, alert, moving, tell, id: null, heardNumber: null, seenNumber: 0, pressedMs: 0, sentMs: 0 });
    connection.addEventListener("stop-heard", ({ detail }) => { if (detail.id === this.id) this.heard(detail.number); });
    connection.addEventListener("state", ({ detail }) => this.ended(detail.stop));
    connection.addEventListener("open", () => { if (this.id) this.send(); });
    setInterval(() => this.tick(), TICK_MS);
  }

  get waitedMs() { return performance.now() - this.pressedMs; }

  press() {
    if (!this.id) {
      this.id = randomHex(8);
      this.pressedMs = performance.now();
    }
    this.mark("pressed");
    this.send();
  }

  send() {
    this.sentMs = performance.now();
    this.connection.pass("stop", { id: this.id });
  }

  heard(number) {
    if (!this.alert.hidden) this.tell(`STOP was heard after ${seconds(this.waitedMs)}.`);
    this.id = null;
    this.heardNumber = number;
    this.alert.hidden = true;
  }

  // What became of the last STOP, of whatever page.
  ended({ number, outcome, fault }) {
    this.number = number;
    this.seenNumber = Math.min(this.seenNumber, number); // a console that was started again counts anew
    const isOurs = this.heardNumber !== null && number >= this.heardNumber;
    const hasFailed = outcome === "failed" && number > this.seenNumber;
    this.moving.hidden = !hasFailed;
    this.moving.querySelector(".what").textContent = fault && `${fault[0].toUpperCase()}${fault.slice(1)}.`;
    if (this.id) return; // pressed again
    if (outcome === "failed") this.mark(hasFailed ? "failed" : "");
    else if (outcome === "stopped" && isOurs) {
      this.heardNumber = null;
      this.mark("stopped");
      clearTimeout(this.telling);
      this.telling = setTimeout(() => { if (this.button.classList.contains("stopped")) this.mark(""); }, TOLD_MS);
    } else if (outcome === "stopped" && !this.button.classList.contains("stopped")) this.mark("");
  }

  seen() {
    this.seenNumber = this.number;
    this.moving.hidden = true;
    this.mark("");
  }

  mark(name) {
    for (const each of ["pressed", "stopped", "failed"]) this.button.classList.toggle(each, each === name);
  }

  tick() {
    if (!this.id) return;
    if (performance.now() - this.sentMs > AGAIN_MS) this.send();
    if (this.waitedMs < UNHEARD_MS) return;
    this.alert.hidden = false;
    this.alert.querySelector(".waited").textContent = seconds(this.waitedMs);
  }
}
