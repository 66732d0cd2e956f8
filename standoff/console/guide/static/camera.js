// The phone's camera: frames to the computer, its guidance over the picture, and a burst of stills.

const LONGEST_PX = 640;
const SMALLER_PX = 480;
const FINE_QUALITY = 0.97;
const IN_FLIGHT = 2;
const LATE_MS = 400;
const SLOW_MS = 280;
const FAST_MS = 180;
const BURST = 3;
const ANSWER_MS = 5000;
const REOPEN_MS = 1000;

const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

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
    this.wantsFine = false;
    this.guidance = null;
    this.takenMs = 0;
    this.answersMs = [];
    this.ages = [];
    this.isClosed = false;
    this.stayLit = this.stayLit.bind(this);
  }

  async open() {
    await this.connect();
    if (this.isClosed) return;
    document.addEventListener("visibilitychange", this.stayLit);
    this.stayLit();
    this.pump();
  }

  close() {
    this.isClosed = true;
    document.removeEventListener("visibilitychange", this.stayLit);
    this.lamp?.release();
    for (const track of this.stream?.getTracks() ?? []) track.stop();
    this.video.srcObject = null;
  }

  async connect() {
    const stream = await navigator.mediaDevices.getUserMedia({
      audio: false,
      video: { facingMode: { ideal: "environment" }, width: { ideal: 1920 }, height: { ideal: 1440 } },
    });
    const [track] = stream.getVideoTracks();
    if (this.isClosed) { // while the browser asked for the permission
      track.stop();
      return;
    }
    // A call or another app takes the camera away.
    track.addEventListener("ended", () => this.reconnect());
    track.addEventListener("mute", () => this.show({ fault: "The camera gives no picture; this page waits for it." }));
    [this.stream, this.track] = [stream, track];
    this.video.srcObject = stream;
    await this.video.play();
  }

  async reconnect() {
    while (!this.isClosed && this.track.readyState !== "live") {
      this.show({ fault: "The camera has stopped; this page opens it again." });
      await pause(REOPEN_MS);
      if (!document.hidden) await this.connect().catch(() => null); // tried again
    }
  }

  // The screen goes dark with the page hidden, and the lock is lost.
  async stayLit() {
    if (document.hidden) return;
    const lamp = await navigator.wakeLock?.request("screen").catch(() => null);
    if (this.isClosed) lamp?.release();
    else this.lamp = lamp;
  }

  get givesPictures() {
    return this.video.videoWidth > 0 && this.track.readyState === "live" && !this.track.muted;
  }

  // Age of what is shown, in ms: since the frame was taken that it was made from.
  get ageMs() {
    return this.guidance ? performance.now() - this.takenMs : Infinity;
  }

  // Young enough for a green to begin, which then lasts a third of a second at the least.
  get isFresh() {
    return this.ageMs <= LATE_MS;
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
    while (!this.isClosed) {
      if (this.inFlight >= IN_FLIGHT || !this.givesPictures || document.hidden) {
        await pause(15);
        continue;
      }
      // One frame as it is, where the computer asks for it, to tell how sharp the camera is.
      const isFine = this.wantsFine;
      this.wantsFine = false;
      [canvas.width, canvas.height] = area(this.video.videoWidth, this.video.videoHeight, isFine ? LONGEST_PX : this.longest);
      const takenMs = performance.now();
      drawing.drawImage(this.video, 0, 0, canvas.width, canvas.height);
      const blob = await new Promise((resolve) => canvas.toBlob(resolve, "image/jpeg", isFine ? FINE_QUALITY : this.quality));
      if (!this.givesPictures) continue; // the camera stopped while this was compressed: it is old by now
      this.inFlight += 1;
      this.sent += 1;
      this.ask(blob, takenMs, this.sent, isFine).finally(() => { this.inFlight -= 1; });
      // Half a round trip apart, so that the computer always has one to work on.
      await pause(Math.min(100, (this.roundMs ?? 100) / IN_FLIGHT));
    }
  }

  async ask(blob, takenMs, number, isFine) {
    let found;
    try {
      const at = `${this.path.includes("?") ? "&" : "?"}at=${takenMs.toFixed(1)}${isFine ? "&fine=1" : ""}`;
      const signal = AbortSignal.timeout(ANSWER_MS); // packets may vanish without a word
      const answer = await fetch(this.path + at, { method: "POST", body: blob, signal });
      const text = await answer.text();
      if (!answer.ok) {
        this.refused(answer.status, text);
        await pause(200);
        return;
      }
      found = JSON.parse(text);
    } catch {
      if (!this.isClosed) this.show({ lost: true });
      await pause(500);
      return;
    }
    const nowMs = performance.now();
    if (!isFine) this.adapt(nowMs - takenMs);
    if (found.passed_over || number < this.newest || this.isClosed) return;
    if (!this.givesPictures) return; // it was taken before the camera stopped, which has been said since
    this.newest = number;
    this.guidance = found;
    this.wantsFine = found.wants_fine && !isFine;
    this.takenMs = takenMs;
    this.answersMs = [...this.answersMs.slice(-60), nowMs];
    this.ages = [...this.ages.slice(-60), nowMs - takenMs];
    this.show({ found });
  }

  refused(status, text) {
    if (this.isClosed || status === 429) return;
    let told = `the computer answers ${status}`;
    if (status === 401) told = "This phone is not paired any more: scan the code again.";
    else if (text.startsWith("{")) told = JSON.parse(text).text;
    this.show({ fault: told });
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
    const taken = [];
    for (let count = 0; count < BURST; count += 1) {
      const blob = await this.takePhoto(this.track) ?? await this.grab();
      if (blob) taken.push({ blob, ...await measured(blob) });
    }
    if (!taken.length) throw new Error("the camera gave no photograph");
    // A frame of the video, taken where a photograph failed, is smaller and looks sharper.
    taken.sort((one, other) => other.pixels - one.pixels || other.sharpness - one.sharpness);
    return taken[0].blob;
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

// Pixels of a picture, and the mean squared gradient of its middle, along and across.
export async function measured(blob) {
  const picture = await createImageBitmap(blob);
  const pixels = picture.width * picture.height;
  const side = Math.min(1024, picture.width, picture.height);
  const canvas = new OffscreenCanvas(side, side);
  const drawing = canvas.getContext("2d", { alpha: false });
  drawing.drawImage(picture, (picture.width - side) / 2, (picture.height - side) / 2, side, side, 0, 0, side, side);
  picture.close();
  const { data } = drawing.getImageData(0, 0, side, side);
  const [along, across] = [4, 4 * side];
  let sum = 0;
  for (let row = 0; row < side - 1; row += 1) {
    for (let at = row * across + 1, end = at + across - along; at < end; at += along) {
      sum += (data[at + along] - data[at]) ** 2 + (data[at + across] - data[at]) ** 2;
    }
  }
  return { pixels, sharpness: sum / (side - 1) ** 2 };
}
