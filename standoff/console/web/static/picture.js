// The live picture: one byte per pixel to the canvas, and the region drawn on it.

const HEADER_BYTES = 24;
const MAGIC = 0x31464f53; // "SOF1"
const SATURATED = 255;
const OPAQUE = 0xff000000;
const MARK = 0xff2020ff; // red, as ABGR
const RATED = 30;

export class LivePicture {
  constructor(canvas, acknowledge) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d", { alpha: false });
    this.acknowledge = acknowledge;
    this.image = null;
    this.marks = true;
    this.scale = 1;
    this.colours = new Uint32Array(256);
    this.drawn = 0;
    this.latencies = [];
    this.times = [];
    this.colour();
  }

  // Colour of each level; brightened, the levels below a quarter fill the whole range.
  colour() {
    for (let level = 0; level < 256; level++) {
      const grey = Math.min(255, level * this.scale);
      this.colours[level] = OPAQUE | (grey << 16) | (grey << 8) | grey;
    }
    if (this.marks) this.colours[SATURATED] = MARK;
  }

  draw(buffer) {
    const header = new DataView(buffer, 0, HEADER_BYTES);
    if (header.getUint32(0, true) !== MAGIC) return;
    const sequence = header.getUint32(4, true);
    const receivedMs = header.getFloat64(8, true);
    const width = header.getUint16(16, true);
    const height = header.getUint16(18, true);
    if (!this.image || this.image.width !== width || this.image.height !== height) {
      this.canvas.width = width;
      this.canvas.height = height;
      this.image = this.context.createImageData(width, height);
      this.pixels = new Uint32Array(this.image.data.buffer);
    }
    const levels = new Uint8Array(buffer, HEADER_BYTES, width * height);
    const { pixels, colours } = this;
    for (let index = 0; index < levels.length; index++) pixels[index] = colours[levels[index]];
    this.context.putImageData(this.image, 0, 0);
    this.acknowledge(sequence);
    this.drawn += 1;
    const now = performance.timeOrigin + performance.now();
    this.times.push(now);
    this.latencies.push(now - receivedMs);
    if (this.times.length > RATED) { this.times.shift(); this.latencies.shift(); }
  }

  rate() {
    const { times } = this;
    return times.length < 2 ? 0 : 1000 * (times.length - 1) / (times.at(-1) - times[0]);
  }

  latencyMs() {
    const sorted = [...this.latencies].sort((one, other) => one - other);
    return sorted.length ? sorted[Math.floor(sorted.length / 2)] : 0;
  }
}

// Choosing a region: drag with the mouse, or arrows, Shift and arrows, Delete.
export class RegionTool {
  constructor(frame, box, canvas, choose) {
    Object.assign(this, { frame, box, canvas, choose, region: null, from: null });
    frame.addEventListener("pointerdown", (event) => this.begin(event));
    frame.addEventListener("pointermove", (event) => this.drag(event));
    frame.addEventListener("pointerup", (event) => this.end(event));
    frame.addEventListener("keydown", (event) => this.key(event));
    new ResizeObserver(() => this.place()).observe(canvas);
  }

  // Region [x, y, width, height] in pixels of the picture, or null.
  set(region) {
    if (this.from || String(region) === String(this.region)) return;
    this.region = region;
    this.place();
  }

  place() {
    this.box.hidden = !this.region;
    if (!this.region) return;
    const scale = this.canvas.clientWidth / this.canvas.width;
    const [x, y, width, height] = this.region.map((value) => `${value * scale}px`);
    Object.assign(this.box.style, { left: x, top: y, width, height });
  }

  at(event) {
    const bounds = this.canvas.getBoundingClientRect();
    const clip = (value, top) => Math.round(Math.min(Math.max(value, 0), top));
    return [
      clip((event.clientX - bounds.left) * this.canvas.width / bounds.width, this.canvas.width),
      clip((event.clientY - bounds.top) * this.canvas.height / bounds.height, this.canvas.height),
    ];
  }

  begin(event) {
    if (event.button !== 0 || !document.body.classList.contains("mine")) return;
    this.from = this.at(event);
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

  key(event) {
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (!document.body.classList.contains("mine")) return;
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
    this.place();
    this.choose(region);
  }
}
