// The live picture: one byte per pixel to the canvas.

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

  periodS() { return this.times.length < 2 ? 0 : 1 / this.rate(); }

  latencyMs() {
    const sorted = [...this.latencies].sort((one, other) => one - other);
    return sorted.length ? sorted[Math.floor(sorted.length / 2)] : 0;
  }
}
