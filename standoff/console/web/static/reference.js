// The pose's reference over the live picture: blended, in turn with it, or its edges alone.
//
// It is shown over a live picture only, and a label says that it is there.

import { view } from "./picture_card.js";
import { byId, connection, onKey, setText, show } from "./shell.js";

const TURN_MS = 500;
const RETRY_MS = 1000;
const BRIGHTEN = 4; // as the live picture

const stillness = window.matchMedia("(prefers-reduced-motion: reduce)");
const images = { photo: byId("reference-photo"), edges: byId("reference-edges") };
const [how, share, frame, label] = ["reference-how", "reference-share", "frame", "reference-label"].map(byId);
let number = null; // of the reference, which the console gives only once
let fault = "";
let isTurned = false; // the reference is what one sees, while it blinks
let turnedMs = 0;

for (const image of Object.values(images)) {
  image.onload = () => { image.dataset.has = image.dataset.of; update(); };
  image.onerror = () => setTimeout(() => { delete image.dataset.of; }, RETRY_MS);
}

// Fetched when it is first shown.
function isThere(kind) {
  const image = images[kind];
  if (image.dataset.of !== String(number)) {
    image.dataset.of = number;
    image.src = `/pose/reference.png?view=${kind}&of=${number}`;
  }
  return image.dataset.has === String(number);
}

function words(mode, isLive) {
  if (!isLive) return "no live picture: the reference is not shown";
  if (mode === "edges") return "edges of the REFERENCE over the live picture";
  if (mode === "blink") return isTurned ? "REFERENCE" : "live picture";
  return Number(share.value) === 100 ? "REFERENCE alone" : `REFERENCE, ${share.value} %, over the live picture`;
}

function update() {
  const mode = number === null || fault ? "off" : how.value;
  const isLive = connection.isOpen && !frame.classList.contains("stale");
  const isPhoto = mode === "blend" || (mode === "blink" && isTurned);
  const hasPhoto = ["blend", "blink"].includes(mode) && isThere("photo"); // before its first turn, too
  images.photo.hidden = !(isPhoto && isLive && hasPhoto);
  images.edges.hidden = !(mode === "edges" && isLive && isThere("edges"));
  images.photo.style.opacity = mode === "blend" ? share.value / 100 : 1;
  images.photo.style.filter = byId("brighten").checked ? `brightness(${BRIGHTEN})` : "";
  label.hidden = mode === "off";
  label.classList.toggle("covers", isPhoto && isLive);
  setText("reference-label", words(mode, isLive));
  show("reference-choice", number !== null);
  how.disabled = Boolean(fault);
  show("reference-share", mode === "blend");
  show("reference-turn", mode === "blink");
}

function place() {
  const { canvas } = view;
  for (const image of Object.values(images)) {
    Object.assign(image.style, { width: `${canvas.width}px`, height: `${canvas.height}px`, transform: canvas.style.transform });
    image.classList.toggle("pixels", canvas.classList.contains("pixels"));
  }
}

function turn() {
  isTurned = !isTurned;
  turnedMs = performance.now();
  update();
}

function choose(mode) {
  if (number === null || fault) return;
  how.value = mode;
  isTurned = false;
  if (mode === "blink") turn(); else update();
}

view.addEventListener("change", place);
connection.addEventListener("state", ({ detail: { pose: { overlay } } }) => {
  ({ number, fault } = overlay);
  update();
});
connection.addEventListener("tick", () => {
  if (how.value === "blink" && !stillness.matches && performance.now() - turnedMs >= TURN_MS) turn();
  else update();
});
connection.addEventListener("lost", update);
how.onchange = () => choose(how.value);
share.oninput = update;
byId("brighten").addEventListener("change", update);
byId("reference-turn").onclick = turn;
onKey("o", () => choose(how.options[(how.selectedIndex + 1) % how.options.length].value));
onKey("r", () => (how.value === "blink" ? turn() : choose("blink")));
place();
