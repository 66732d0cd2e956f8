// Zoom and pan of the live picture: wheel, two fingers, middle button or space bar, buttons, keys.

import { byId, onKey, setText } from "./shell.js";

const LARGEST_PX = 64; // screen pixels of a picture's pixel
const STEP = 1.5;
const PER_LINE = 16;
const PER_DELTA = 0.002;
const PIXELS_SHOW = 2;

export class PictureView extends EventTarget {
  // `hasTool` says whether dragging with the left button does something else than to pan.
  constructor(frame, canvas, hasTool) {
    super();
    Object.assign(this, { frame, canvas, hasTool, scale: 1, left: 0, top: 0 });
    Object.assign(this, { isFitted: true, isMoving: false, hasSpace: false, pointers: new Map() });
    frame.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    frame.addEventListener("mousedown", (event) => { if (event.button === 1) event.preventDefault(); });
    // In the capture phase: what moves the picture is no drag of a tool.
    for (const kind of ["pointerdown", "pointermove", "pointerup", "pointercancel"]) {
      frame.addEventListener(kind, (event) => this.pointer(event), true);
    }
    window.addEventListener("keydown", (event) => this.space(event, true));
    window.addEventListener("keyup", (event) => this.space(event, false));
    window.addEventListener("blur", () => { this.hasSpace = false; });
    new ResizeObserver(() => (this.isFitted ? this.fit() : this.move(1))).observe(frame);
    new ResizeObserver(() => this.fit()).observe(canvas);
    const acts = {
      "zoom-in": ["+", () => this.move(STEP)],
      "zoom-out": ["-", () => this.move(1 / STEP)],
      "zoom-fit": ["0", () => this.fit()],
      "zoom-actual": ["1", () => this.move(this.actual / this.scale)],
    };
    for (const [id, [key, act]] of Object.entries(acts)) {
      byId(id).onclick = act;
      byId(id).disabled = false;
      onKey(key, act);
    }
    onKey("=", acts["zoom-in"][1]); // "+" without Shift
  }

  get actual() { return 1 / (window.devicePixelRatio || 1); }

  get fitting() {
    const { frame, canvas } = this;
    return Math.min(frame.clientWidth / canvas.width, frame.clientHeight / canvas.height) || 1;
  }

  // Place in the picture, in px from its upper left corner: pixel 3 reaches from 3 to 4.
  at(event) {
    const bounds = this.frame.getBoundingClientRect();
    return [(event.clientX - bounds.left - this.left) / this.scale, (event.clientY - bounds.top - this.top) / this.scale];
  }

  // Place in the frame on the screen, of a place in the picture.
  shown([x, y]) { return [this.left + x * this.scale, this.top + y * this.scale]; }

  // Put an element over a region [x, y, width, height] of the picture.
  cover(box, region) {
    const [left, top] = this.shown(region);
    const [width, height] = region.slice(2).map((value) => value * this.scale);
    for (const [name, value] of Object.entries({ left, top, width, height })) box.style[name] = `${value}px`;
  }

  fit() {
    const { frame, canvas } = this;
    frame.style.setProperty("--aspect", canvas.width / canvas.height);
    this.scale = this.fitting;
    this.place();
  }

  // Scale by a factor, so that the picture's point at `from` comes to `to`, both on the screen.
  move(factor, from = null, to = from) {
    const bounds = this.frame.getBoundingClientRect();
    const centre = [bounds.left + bounds.width / 2, bounds.top + bounds.height / 2];
    const [[fromX, fromY], [toX, toY]] = [from ?? centre, to ?? centre];
    const least = Math.min(this.fitting, this.actual);
    const scale = Math.min(Math.max(this.scale * factor, least), LARGEST_PX);
    const ratio = scale / this.scale;
    this.left = toX - bounds.left - (fromX - bounds.left - this.left) * ratio;
    this.top = toY - bounds.top - (fromY - bounds.top - this.top) * ratio;
    this.scale = scale;
    this.place();
  }

  // Pan until a place of the picture is in sight.
  reveal([x, y]) {
    const [right, down] = this.shown([x, y]);
    const { clientWidth: width, clientHeight: height } = this.frame;
    if (right < 0 || right > width) this.left += width / 2 - right;
    if (down < 0 || down > height) this.top += height / 2 - down;
    this.place();
  }

  place() {
    const { frame, canvas, scale } = this;
    this.isFitted = Math.abs(scale / this.fitting - 1) < 1e-3;
    const isWhole = scale <= this.fitting * 1.001;
    // Every pixel can be brought to the middle, and some of the picture always remains there.
    const within = (offset, room, size) => (isWhole ? (room - size) / 2 : Math.min(Math.max(offset, room / 2 - size), room / 2));
    this.left = within(this.left, frame.clientWidth, canvas.width * scale);
    this.top = within(this.top, frame.clientHeight, canvas.height * scale);
    canvas.style.transform = `translate(${this.left}px, ${this.top}px) scale(${scale})`;
    canvas.classList.toggle("pixels", scale >= PIXELS_SHOW * this.actual);
    const percent = 100 * scale / this.actual;
    setText("zoom", `${percent.toFixed(percent < 10 ? 1 : 0)} %`);
    this.dispatchEvent(new Event("change"));
  }

  wheel(event) {
    event.preventDefault();
    const delta = event.deltaY * (event.deltaMode === WheelEvent.DOM_DELTA_LINE ? PER_LINE : 1);
    // A trackpad's pinch comes as a wheel with Ctrl, in small steps.
    const factor = Math.exp(-Math.min(Math.max(delta, -300), 300) * PER_DELTA * (event.ctrlKey ? 5 : 1));
    this.move(factor, [event.clientX, event.clientY]);
  }

  space(event, isDown) {
    if (event.key !== " ") return;
    const isHere = event.target === document.body || event.target === this.frame;
    if (isDown && isHere) event.preventDefault();
    this.hasSpace = isDown && isHere;
    this.frame.classList.toggle("pans", this.hasSpace);
  }

  pointer(event) {
    const { pointers } = this;
    const before = [...pointers.values()];
    if (event.type === "pointerdown") {
      pointers.set(event.pointerId, [event.clientX, event.clientY]);
      const isPan = event.button === 1 || (event.button === 0 && (this.hasSpace || !this.hasTool()));
      if (isPan || pointers.size > 1) {
        if (!this.isMoving) this.dispatchEvent(new Event("gesture"));
        this.isMoving = true;
        this.frame.setPointerCapture(event.pointerId);
      }
    } else if (event.type === "pointermove" && pointers.has(event.pointerId)) {
      pointers.set(event.pointerId, [event.clientX, event.clientY]);
      if (this.isMoving) this.follow(before, [...pointers.values()]);
    }
    if (this.isMoving) event.stopPropagation();
    if (event.type === "pointerup" || event.type === "pointercancel") {
      pointers.delete(event.pointerId);
      if (!pointers.size) this.isMoving = false;
    }
  }

  // The picture goes with the pointer, or with the first two.
  follow(before, after) {
    const middle = (points) => [0, 1].map((axis) => points.slice(0, 2).reduce((sum, point) => sum + point[axis], 0) / Math.min(points.length, 2));
    const apart = ([one, other]) => (other ? Math.max(Math.hypot(one[0] - other[0], one[1] - other[1]), 1) : 1);
    this.move(apart(after) / apart(before), middle(before), middle(after));
  }
}
