// The live picture: one byte per pixel to the canvas, as they come or out of a JPEG.

const HEADER_BYTES = 24;
const EXACT = 0x31464f53; // "SOF1"
const COMPRESSED = 0x32464f53; // "SOF2"
const SATURATED = 255;
const HALF = 128;
const OPAQUE = 0xff000000;
const MARK = 0xff2020ff; // red, as ABGR
const RATED = 30;

export class LivePicture {
  // `acknowledge` is told the sequence and for how long the picture was in hand; `nowMs` is the console's time.
  constructor(canvas, acknowledge, nowMs) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d", { alpha: false });
    this.small = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
    Object.assign(this, { acknowledge, nowMs, image: null, decoding: Promise.resolve(), isExact: false, reduction: 1 });
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

  // Pictures are drawn in the order in which they came.
  draw(buffer) {
    const came = performance.now();
    this.decoding = this.decoding.then(() => this.take(buffer, came)).catch((error) => console.warn(`picture: ${error}`));
  }

  async take(buffer, came) {
    const header = new DataView(buffer, 0, HEADER_BYTES);
    const magic = header.getUint32(0, true);
    const [width, height] = [header.getUint16(16, true), header.getUint16(18, true)];
    if (magic === EXACT) this.show(new Uint8Array(buffer, HEADER_BYTES, width * height), width, height, width, height);
    else if (magic === COMPRESSED) await this.decode(buffer, header.getUint32(20, true), width, height);
    else return;
    this.isExact = magic === EXACT;
    const sequence = header.getUint32(4, true);
    this.acknowledge(sequence, performance.now() - came);
    this.drawn += 1;
    this.times.push(performance.now());
    this.latencies.push(this.nowMs() - header.getFloat64(8, true));
    if (this.times.length > RATED) { this.times.shift(); this.latencies.shift(); }
  }

  async decode(buffer, jpegBytes, width, height) {
    const bytes = (start, length) => new Blob([new Uint8Array(buffer, HEADER_BYTES + start, length)]);
    const markBytes = buffer.byteLength - HEADER_BYTES - jpegBytes;
    const opened = await Promise.all([[0, jpegBytes], [jpegBytes, markBytes]].filter(([, length]) => length).map((part) => createImageBitmap(bytes(...part))));
    const [{ width: cols, height: rows }] = opened;
    const [{ data: grey }, marks] = opened.map((bitmap) => this.pixelsOf(bitmap));
    const levels = new Uint8Array(grey.length / 4);
    for (let index = 0; index < levels.length; index++) {
      const isMarked = marks && marks.data[4 * index] >= HALF;
      levels[index] = isMarked ? SATURATED : Math.min(grey[4 * index], SATURATED - 1);
    }
    this.show(levels, cols, rows, width, height);
  }

  pixelsOf(bitmap) {
    const { small } = this;
    Object.assign(small.canvas, { width: bitmap.width, height: bitmap.height });
    small.drawImage(bitmap, 0, 0);
    const pixels = small.getImageData(0, 0, bitmap.width, bitmap.height);
    bitmap.close(); // or it is kept until the next collection of garbage
    return pixels;
  }

  // Levels of `cols` by `rows` pixels, on a canvas of the whole picture's size.
  show(levels, cols, rows, width, height) {
    const { canvas, small, context, colours } = this;
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    if (this.image?.width !== cols || this.image?.height !== rows) {
      this.image = context.createImageData(cols, rows);
      this.pixels = new Uint32Array(this.image.data.buffer);
    }
    const { pixels } = this;
    for (let index = 0; index < levels.length; index++) pixels[index] = colours[levels[index]];
    this.reduction = Math.round(width / cols);
    if (cols === width && rows === height) { context.putImageData(this.image, 0, 0); return; }
    Object.assign(small.canvas, { width: cols, height: rows });
    small.putImageData(this.image, 0, 0);
    context.drawImage(small.canvas, 0, 0, width, height);
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
