// The phone's camera: frames to the computer, its guidance over the picture, and a burst of stills.

const LONGEST_PX = 640;
const SMALLER_PX = 480;
const IN_FLIGHT = 2;
const LATE_MS = 400;
const SLOW_MS = 280;
const FAST_MS = 180;
const BURST = 3;

const area = (width, height, longest) => {
  const factor = Math.min(1, longest / Math.max(width, height));
  return [Math.max(1, Math.round(width * factor)), Math.max(1, Math.round(height * factor))];
};

export class Camera {
  // Frames are sent to `path`; `show` is called with what is answered.
  constructor(video, show, path) {
    this.video = video;
    this.show = show;
    this.path = path;
    this.quality = 0.6;
    this.longest = LONGEST_PX;
    this.inFlight = 0;
    this.sent = 0;
    this.newest = 0;
    this.guidance = null;
    this.takenMs = 0;
    this.answersMs = [];
    this.ages = [];
  }

  async open() {
    this.stream = await navigator.mediaDevices.getUserMedia({
      audio: false,
      video: { facingMode: { ideal: "environment" }, width: { ideal: 1920 }, height: { ideal: 1440 } },
    });
    this.video.srcObject = this.stream;
    await this.video.play();
    this.wanted = true;
    this.lamp = await navigator.wakeLock?.request("screen").catch(() => null);
    this.pump();
  }

  close() {
    this.wanted = false;
    this.lamp?.release();
    for (const track of this.stream?.getTracks() ?? []) track.stop();
    this.video.srcObject = null;
  }

  // Age of what is shown, in ms: since the frame was taken that it was made from.
  get ageMs() {
    return this.guidance ? performance.now() - this.takenMs : Infinity;
  }

  get isLate() {
    return this.ageMs > LATE_MS + 1000 / 3;
  }

  get posesPerS() {
    const since = performance.now() - 3000;
    return this.answersMs.filter((ms) => ms > since).length / 3;
  }

  async pump() {
    const canvas = document.createElement("canvas");
    const drawing = canvas.getContext("2d", { alpha: false });
    while (this.wanted) {
      if (this.inFlight >= IN_FLIGHT || !this.video.videoWidth || document.hidden) {
        await new Promise((resolve) => setTimeout(resolve, 15));
        continue;
      }
      [canvas.width, canvas.height] = area(this.video.videoWidth, this.video.videoHeight, this.longest);
      const takenMs = performance.now();
      drawing.drawImage(this.video, 0, 0, canvas.width, canvas.height);
      const blob = await new Promise((resolve) => canvas.toBlob(resolve, "image/jpeg", this.quality));
      this.inFlight += 1;
      this.sent += 1;
      this.ask(blob, takenMs, this.sent).finally(() => { this.inFlight -= 1; });
      // Half a round trip apart, so that the computer always has one to work on.
      await new Promise((resolve) => setTimeout(resolve, Math.min(100, (this.roundMs ?? 100) / IN_FLIGHT)));
    }
  }

  async ask(blob, takenMs, number) {
    let answer;
    try {
      answer = await fetch(this.path, { method: "POST", body: blob });
    } catch {
      this.show({ lost: true });
      await new Promise((resolve) => setTimeout(resolve, 500));
      return;
    }
    if (!answer.ok) {
      const told = await answer.json().catch(() => ({ text: "" }));
      if (answer.status !== 429) this.show({ fault: told.text });
      await new Promise((resolve) => setTimeout(resolve, 200));
      return;
    }
    const found = await answer.json();
    const nowMs = performance.now();
    this.adapt(nowMs - takenMs);
    if (found.passed_over || number < this.newest || !this.wanted) return;
    this.newest = number;
    this.guidance = found;
    this.takenMs = takenMs;
    this.answersMs = [...this.answersMs.slice(-60), nowMs];
    this.ages = [...this.ages.slice(-60), nowMs - takenMs];
    this.show({ found });
  }

  // Send less where answers take long, and more again where they do not.
  adapt(roundMs) {
    this.roundMs = 0.7 * (this.roundMs ?? roundMs) + 0.3 * roundMs;
    if (this.roundMs > SLOW_MS) {
      if (this.quality > 0.35) this.quality -= 0.05;
      else this.longest = SMALLER_PX;
    } else if (this.roundMs < FAST_MS && this.quality < 0.7) {
      this.quality += 0.02;
      if (this.quality > 0.5) this.longest = LONGEST_PX;
    }
  }

  // The sharpest of a burst at the highest resolution that the browser gives.
  async still() {
    const [track] = this.stream.getVideoTracks();
    const taken = [];
    for (let count = 0; count < BURST; count += 1) {
      const blob = await this.takePhoto(track) ?? await this.grab();
      if (blob) taken.push([await sharpness(blob), blob]);
    }
    if (!taken.length) throw new Error("the camera gave no photograph");
    taken.sort((one, other) => other[0] - one[0]);
    return taken[0][1];
  }

  async takePhoto(track) {
    if (!("ImageCapture" in window)) return null;
    try {
      const capture = new ImageCapture(track);
      const { imageWidth, imageHeight } = await capture.getPhotoCapabilities();
      const blob = await capture.takePhoto({ imageWidth: imageWidth.max, imageHeight: imageHeight.max });
      return blob.type === "image/jpeg" ? blob : null;
    } catch {
      return null; // a frame at the video's resolution is taken instead
    }
  }

  async grab() {
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [this.video.videoWidth, this.video.videoHeight];
    canvas.getContext("2d", { alpha: false }).drawImage(this.video, 0, 0);
    return new Promise((resolve) => canvas.toBlob(resolve, "image/jpeg", 0.95));
  }
}

// Mean squared gradient of the middle of a picture, as it is.
async function sharpness(blob) {
  const picture = await createImageBitmap(blob);
  const side = Math.min(1024, picture.width, picture.height);
  const canvas = new OffscreenCanvas(side, side);
  const drawing = canvas.getContext("2d", { alpha: false });
  drawing.drawImage(picture, (picture.width - side) / 2, (picture.height - side) / 2, side, side, 0, 0, side, side);
  picture.close();
  const { data } = drawing.getImageData(0, 0, side, side);
  let sum = 0;
  for (let at = 4; at < data.length; at += 4) sum += (data[at + 1] - data[at - 3]) ** 2;
  return sum / data.length;
}
