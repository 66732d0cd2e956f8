// The page of one capture: its images with their real levels, a brightness window, neighbours.

import { byId, command, connection, onKey, setText, tell } from "./shell.js";

const { session, index, address, query, limit, frames } = byId("capture").dataset;
const STEPS = 1000; // of the sliders
const LOW_SHARE = 0.002, HIGH_SHARE = 0.998; // of the levels, for the automatic window
const SAMPLES = 20000;
const UNITS = { noise: "DN standard deviation", exposures: "exposures" };
const canvas = byId("levels");
let image = "mean";
let levels = null, rows = 0, cols = 0, least = 0, most = 1;

async function load(wanted) {
  image = wanted;
  for (const button of document.querySelectorAll("[data-image]")) button.setAttribute("aria-pressed", String(button.dataset.image === wanted));
  setText("reading", "loading …");
  const answer = await fetch(`${address}/levels/${wanted}${query}`);
  if (image !== wanted) return; // another one was chosen meanwhile
  if (!answer.ok) {
    const page = new DOMParser().parseFromString(await answer.text(), "text/html");
    setText("reading", page.querySelector("main p")?.textContent || "This image cannot be read.");
    return;
  }
  rows = Number(answer.headers.get("X-Rows"));
  cols = Number(answer.headers.get("X-Cols"));
  const read = new Float32Array(await answer.arrayBuffer());
  if (image !== wanted) return;
  levels = read;
  canvas.width = cols;
  canvas.height = rows;
  canvas.style.width = `min(100%, calc(max(100vh - 15rem, 18rem) * ${cols / rows}))`;
  automatic();
  setText("reading", `${cols} × ${rows} pixels; move over the picture to read its levels`);
}

function automatic() {
  if (!levels) return;
  const every = Math.max(1, Math.floor(levels.length / SAMPLES));
  const sampled = levels.filter((value, i) => i % every === 0 && !Number.isNaN(value)).sort();
  least = Infinity;
  most = -Infinity;
  for (const value of levels) { if (value < least) least = value; if (value > most) most = value; }
  if (!(most > least)) { least = Number.isFinite(least) ? least : 0; most = least + 1; }
  const at = (share) => Math.round((STEPS * (sampled[Math.floor(share * (sampled.length - 1))] - least)) / (most - least)) || 0;
  byId("low").value = image === "exposures" ? 0 : at(LOW_SHARE);
  byId("high").value = image === "exposures" ? STEPS : Math.max(at(HIGH_SHARE), at(LOW_SHARE) + 1);
  draw();
}

function draw() {
  if (!levels) return;
  const level = (id) => least + (byId(id).valueAsNumber / STEPS) * (most - least);
  const low = level("low"), scale = 255 / Math.max(level("high") - low, 1e-9);
  const picture = new ImageData(cols, rows);
  const pixels = new Uint32Array(picture.data.buffer);
  const marked = byId("marks").checked ? 0xff2020ff : 0; // red, opaque
  const highest = limit && image !== "noise" && image !== "exposures" ? Number(limit) - 0.5 : Infinity;
  for (let i = 0; i < pixels.length; i += 1) {
    const value = levels[i];
    const grey = Math.max(0, Math.min(255, (value - low) * scale)) | 0;
    const isBad = value >= highest || Number.isNaN(value);
    pixels[i] = isBad && marked ? marked : 0xff000000 | (grey * 0x10101);
  }
  canvas.getContext("2d").putImageData(picture, 0, 0);
  setText("window", `${low.toPrecision(4)} to ${level("high").toPrecision(4)}`);
}

canvas.onpointermove = (event) => {
  if (!levels) return;
  const box = canvas.getBoundingClientRect();
  const x = Math.floor(((event.clientX - box.left) * cols) / box.width);
  const y = Math.floor(((event.clientY - box.top) * rows) / box.height);
  if (x < 0 || y < 0 || x >= cols || y >= rows) return;
  const value = levels[y * cols + x];
  setText("reading", `x ${x}, y ${y}: ${Number.isNaN(value) ? "not valid in any exposure" : `${value.toFixed(image === "exposures" ? 0 : 2)} ${UNITS[image] || "DN"}`}`);
};
for (const button of document.querySelectorAll("[data-image]")) {
  button.onclick = () => load(button.dataset.image);
  onKey(button.dataset.image[0], () => button.click());
}
if (byId("frame-number")) byId("frame-number").onchange = ({ target }) => {
  const isFrame = target.checkValidity() && target.valueAsNumber <= Number(frames);
  if (!isFrame) {
    tell(`The number of the frame must be a whole number from 1 to ${frames}.`);
    target.value = target.defaultValue;
  } else {
    target.defaultValue = target.value;
    load(String(target.valueAsNumber - 1));
  }
};
for (const id of ["low", "high"]) byId(id).oninput = draw;
byId("marks").onchange = draw;
byId("whole").onchange = () => byId("view").classList.toggle("whole", byId("whole").checked);
byId("automatic").onclick = automatic;
onKey("a", automatic);
onKey("s", () => byId("marks").click());
onKey("z", () => byId("whole").click());
onKey("arrowleft", () => byId("previous")?.click());
onKey("arrowright", () => byId("next")?.click());

function change(what, fields) {
  connection.addEventListener("changed", () => location.reload(), { once: true });
  command(what, { session, index: Number(index), ...fields });
}
if (byId("exclude")) {
  byId("exclude").onclick = () => {
    const reason = window.prompt("Why is this capture not to be used? The reason is recorded.");
    if (reason?.trim()) change("exclude", { reason: reason.trim().slice(0, 300) });
  };
}
if (byId("include")) byId("include").onclick = () => change("include", {});
connection.addEventListener("state", ({ detail: { control } }) => {
  for (const id of ["exclude", "include"]) if (byId(id)) byId(id).disabled = !control.is_mine;
});
for (const each of document.querySelectorAll("[data-image], #frame-number, #automatic")) each.disabled = false;
byId("view").classList.toggle("whole", byId("whole").checked); // chosen before this script came
load("mean");
