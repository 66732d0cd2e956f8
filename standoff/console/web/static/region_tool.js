// Choosing a region: drag with the mouse, or arrows, Shift and arrows, Delete.

import { Choice } from "./shell.js";

export class RegionTool {
  constructor(view, box, choose) {
    const { frame, canvas } = view;
    Object.assign(this, { view, frame, canvas, box, choose, region: null, from: null, before: null, choice: new Choice(), isOn: true });
    frame.addEventListener("pointerdown", (event) => this.begin(event));
    frame.addEventListener("pointermove", (event) => this.drag(event));
    frame.addEventListener("pointerup", (event) => this.end(event));
    frame.addEventListener("pointercancel", () => this.abandon());
    frame.addEventListener("keydown", (event) => this.key(event));
    view.addEventListener("change", () => this.place());
    view.addEventListener("gesture", () => this.abandon());
  }

  // Region [x, y, width, height] in pixels of the picture, or null.
  set(region) {
    if (String(region) === String(this.region) || this.from || !this.choice.isSettled) return;
    this.region = region;
    this.place();
  }

  place() {
    this.box.hidden = !this.region;
    if (this.region) this.view.cover(this.box, this.region);
  }

  at(event) {
    const [x, y] = this.view.at(event);
    const clip = (value, top) => Math.round(Math.min(Math.max(value, 0), top));
    return [clip(x, this.canvas.width), clip(y, this.canvas.height)];
  }

  begin(event) {
    if (event.button !== 0 || !this.isOn || !document.body.classList.contains("mine")) return;
    [this.from, this.before] = [this.at(event), this.region];
    this.frame.setPointerCapture(event.pointerId);
  }

  drag(event) {
    if (!this.from) return;
    const to = this.at(event);
    this.region = [0, 1].map((axis) => Math.min(this.from[axis], to[axis]))
      .concat([0, 1].map((axis) => Math.abs(this.from[axis] - to[axis])));
    this.place();
  }

  end(event) {
    if (!this.from) return;
    this.drag(event);
    this.from = null;
    const isChosen = this.region && this.region[2] >= 8 && this.region[3] >= 8;
    this.change(isChosen ? this.region : null);
  }

  // A second finger has come down, or the system took the pointer: nothing was drawn.
  abandon() {
    if (!this.from) return;
    [this.from, this.region] = [null, this.before];
    this.place();
  }

  key(event) {
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (!this.isOn || event.altKey || !document.body.classList.contains("mine")) return;
    if (event.key === "Delete" || event.key === "Backspace") this.change(null);
    else if (step) this.nudge(step, event.shiftKey);
    else return;
    event.preventDefault();
  }

  nudge([right, down], isSize) {
    const { width, height } = this.canvas;
    const by = 10;
    let [x, y, w, h] = this.region ?? [width * 3 / 8, height * 3 / 8, width / 4, height / 4].map(Math.round);
    if (isSize) [w, h] = [w + by * right, h + by * down];
    else [x, y] = [x + by * right, y + by * down];
    w = Math.min(Math.max(w, 16), width);
    h = Math.min(Math.max(h, 16), height);
    this.change([Math.min(Math.max(x, 0), width - w), Math.min(Math.max(y, 0), height - h), w, h]);
  }

  change(region) {
    this.region = region;
    this.choice.make();
    this.place();
    this.choose(region);
  }
}
