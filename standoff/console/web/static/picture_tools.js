// Tools of the live picture: level under the cursor, line profile, grid and cross-hair over it.

import { begin, drawProfile } from "./charts.js";
import { byId, command, connection, onKey, setText, show } from "./shell.js";

const PROBE_MS = 100;
const PROFILE_MS = 200;
const LOST_MS = 2000;
const STEPS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const NEAR_PX = 14;

const clip = (value, low, high) => Math.min(Math.max(value, low), high);

// Ask again and again, never before the last answer has come; `question` returns null for nothing.
function poll(what, periodMs, question) {
  let sentMs = null;
  connection.addEventListener(what, () => { sentMs = null; });
  setInterval(() => {
    const fields = question();
    if (!fields || (sentMs !== null && performance.now() - sentMs < LOST_MS)) return;
    if (connection.send(what, fields)) sentMs = performance.now();
  }, periodMs);
}

// What is drawn over the picture, in pixels of the screen.
export class Overlay {
  constructor(view, canvas) {
    Object.assign(this, { view, canvas, parts: 0, hasCross: false, pixel: null, line: null });
    view.addEventListener("change", () => this.draw());
  }

  draw() {
    const { context, ratio } = begin(this.canvas);
    const { view } = this;
    const { width, height } = view.canvas;
    const segments = [];
    for (let part = 1; part < this.parts; part++) {
      const [x, y] = [width * part / this.parts, height * part / this.parts];
      segments.push([[x, 0], [x, height]], [[0, y], [width, y]]);
    }
    this.stroke(context, ratio, segments, "#ffffffa0");
    const cross = [[[width / 2, 0], [width / 2, height]], [[0, height / 2], [width, height / 2]]];
    if (this.hasCross) this.stroke(context, ratio, cross, "#40e0ff");
    if (this.line) this.stroke(context, ratio, [this.line], "#ff9f1c", this.line);
    if (this.pixel) {
      const centre = this.pixel.map((value) => value + 0.5);
      const arm = (right, down) => [0.7, 0.7 + 12 / this.view.scale].map((reach) => [centre[0] + right * reach, centre[1] + down * reach]);
      this.stroke(context, ratio, Object.values(STEPS).map((step) => arm(...step)), "#40e0ff");
    }
  }

  // Lines with a dark border, which show on black and on white; small squares at `ends`.
  stroke(context, ratio, segments, colour, ends = []) {
    context.beginPath();
    for (const [from, to] of segments) {
      context.moveTo(...this.view.shown(from).map((value) => value * ratio));
      context.lineTo(...this.view.shown(to).map((value) => value * ratio));
    }
    for (const end of ends) {
      const [x, y] = this.view.shown(end).map((value) => (value - 4) * ratio);
      context.rect(x, y, 8 * ratio, 8 * ratio);
    }
    for (const [width, style] of [[3, "#000000a0"], [1, colour]]) {
      context.lineWidth = width * ratio;
      context.strokeStyle = style;
      context.stroke();
    }
  }
}

// The level under the cursor; with the keyboard Alt and arrows move a cross-hair.
export class Probe {
  constructor(view, overlay) {
    Object.assign(this, { view, overlay, pixel: null, isSpoken: false });
    view.frame.addEventListener("pointermove", (event) => this.point(view.at(event)), true);
    view.frame.addEventListener("pointerleave", () => { if (!overlay.pixel) this.point(null); });
    view.frame.addEventListener("keydown", (event) => this.key(event));
    poll("probe", PROBE_MS, () => this.pixel && { x: this.pixel[0], y: this.pixel[1] });
    connection.addEventListener("probe", ({ detail }) => this.tell(detail));
  }

  point(place) {
    const { width, height } = this.view.canvas;
    const pixel = place && place.map(Math.floor);
    const isInside = pixel && pixel[0] >= 0 && pixel[1] >= 0 && pixel[0] < width && pixel[1] < height;
    this.pixel = isInside ? pixel : null;
    if (this.overlay.pixel) { this.overlay.pixel = null; this.overlay.draw(); }
    if (!isInside) this.tell(null);
  }

  key(event) {
    const step = STEPS[event.key];
    if (!step || !event.altKey) return;
    event.preventDefault(); // of going back a page
    const { width, height } = this.view.canvas;
    const from = this.pixel ?? [Math.floor(width / 2), Math.floor(height / 2)];
    const by = event.shiftKey ? 10 : 1;
    this.pixel = [clip(from[0] + by * step[0], 0, width - 1), clip(from[1] + by * step[1], 0, height - 1)];
    this.isSpoken = true;
    this.overlay.pixel = this.pixel;
    this.view.reveal(this.pixel);
  }

  tell(detail) {
    const isRead = detail && detail.level_dn !== null && this.pixel;
    show("probe-help", !isRead);
    show("probe", Boolean(isRead));
    if (!isRead) return;
    const { x, y, level_dn: level, mean_dn: mean, max_level_dn: most } = detail;
    setText("probe", `x ${x}, y ${y} px · ${level} DN (${(100 * level / most).toFixed(1)} %) · mean of 5 × 5: ${mean.toFixed(1)} DN`);
    // Once for each step with the keyboard, not ten times a second; never of a step before.
    if (!this.isSpoken || x !== this.pixel[0] || y !== this.pixel[1]) return;
    setText("probe-spoken", `x ${x}, y ${y}: ${level} DN`);
    this.isSpoken = false;
  }
}

// Levels along a line: drag it, or move it with arrows and its end with Shift and arrows.
export class ProfileTool {
  constructor(view, overlay, region) {
    Object.assign(this, { view, overlay, region, isOn: false, held: null });
    byId("profile-on").onclick = () => this.switch(!this.isOn);
    byId("profile-on").disabled = false;
    onKey("l", () => byId("profile-on").click());
    const { frame } = view;
    frame.addEventListener("pointerdown", (event) => this.begin(event));
    frame.addEventListener("pointermove", (event) => this.drag(event));
    for (const kind of ["pointerup", "pointercancel"]) frame.addEventListener(kind, () => { this.held = null; });
    frame.addEventListener("keydown", (event) => this.key(event));
    view.addEventListener("gesture", () => { this.held = null; });
    poll("profile", PROFILE_MS, () => this.isOn && this.question());
    connection.addEventListener("profile", ({ detail }) => { if (this.isOn) drawProfile(byId("profile"), detail.levels_dn, detail.length_px); });
  }

  switch(isOn) {
    this.isOn = isOn;
    this.region.isOn = !isOn;
    const { width, height } = this.view.canvas;
    const isKept = this.line?.every(([x, y]) => x <= width && y <= height);
    if (isOn && !isKept) this.line = [[width / 4, height / 2], [width * 3 / 4, height / 2]];
    byId("profile-on").setAttribute("aria-pressed", isOn);
    show("profile-panel", isOn);
    this.place(this.line);
  }

  place(line) {
    this.line = line;
    this.overlay.line = this.isOn ? line : null;
    this.overlay.draw();
  }

  // Pixel centres are at integers there; here pixel 3 reaches from 3 to 4.
  question() {
    const { width, height } = this.view.canvas;
    const [start, end] = this.line.map(([x, y]) => [clip(x - 0.5, -0.5, width - 0.5), clip(y - 0.5, -0.5, height - 0.5)]);
    return { start, end };
  }

  within([x, y]) { return [clip(x, 0, this.view.canvas.width), clip(y, 0, this.view.canvas.height)]; }

  // An end that is near is moved; elsewhere a new line begins.
  begin(event) {
    if (!this.isOn || event.button !== 0) return;
    const at = this.within(this.view.at(event));
    const distance = (end) => Math.hypot(end[0] - at[0], end[1] - at[1]) * this.view.scale;
    this.held = this.line.findIndex((end) => distance(end) < NEAR_PX);
    if (this.held < 0) { this.held = 1; this.place([at, at]); }
    this.view.frame.setPointerCapture(event.pointerId);
  }

  drag(event) {
    if (this.held === null || !this.isOn) return;
    const at = this.within(this.view.at(event));
    this.place(this.line.map((end, index) => (index === this.held ? at : end)));
  }

  key(event) {
    const step = STEPS[event.key];
    if (!this.isOn || !step || event.altKey) return;
    event.preventDefault();
    const moved = (end) => this.within(end.map((value, axis) => value + 5 * step[axis]));
    this.place(event.shiftKey ? [this.line[0], moved(this.line[1])] : this.line.map(moved));
  }
}
