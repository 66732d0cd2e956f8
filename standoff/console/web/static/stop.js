// STOP: sent until the console says that it has heard it, and said in red while it has not.

import { randomHex, seconds } from "./connection.js";

const TICK_MS = 100;
const AGAIN_MS = 500;
const UNHEARD_MS = 900;
const TOLD_MS = 2500;


export class Stop extends EventTarget {
  // `tell` shows a line.
  constructor(connection, button, alert, tell) {
    super();
    Object.assign(this, { connection, button, alert, tell, id: null, pressedMs: 0, sentMs: 0 });
    connection.addEventListener("stop-heard", ({ detail }) => { if (detail.id === this.id) this.heard(); });
    connection.addEventListener("open", () => { if (this.id) this.send(); });
    setInterval(() => this.tick(), TICK_MS);
  }

  get waitedMs() { return performance.now() - this.pressedMs; }

  press() {
    if (!this.id) {
      this.id = randomHex(8);
      this.pressedMs = performance.now();
    }
    this.button.classList.remove("heard");
    this.button.classList.add("pressed");
    this.send();
  }

  send() {
    this.sentMs = performance.now();
    this.connection.pass("stop", { id: this.id });
  }

  heard() {
    if (!this.alert.hidden) this.tell(`STOP was heard after ${seconds(this.waitedMs)}.`);
    this.id = null;
    this.alert.hidden = true;
    this.button.classList.remove("pressed");
    this.button.classList.add("heard");
    clearTimeout(this.telling);
    this.telling = setTimeout(() => this.button.classList.remove("heard"), TOLD_MS);
  }

  tick() {
    if (!this.id) return;
    if (performance.now() - this.sentMs > AGAIN_MS) this.send();
    if (this.waitedMs < UNHEARD_MS) return;
    this.alert.hidden = false;
    this.alert.querySelector(".waited").textContent = seconds(this.waitedMs);
  }
}
