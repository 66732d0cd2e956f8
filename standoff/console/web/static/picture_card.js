// The card of the live picture: its view, its tools and what is drawn over it.

import { drawHistogram } from "./charts.js";
import { setExposure } from "./long_exposure.js";
import { LivePicture } from "./picture.js";
import { PictureView } from "./picture_view.js";
import { Overlay, Probe, ProfileTool } from "./picture_tools.js";
import { RegionTool } from "./region_tool.js";
import { Choice, byId, command, connection, number, onKey, setText, show, tell } from "./shell.js";

const BRIGHTEN = 4;
const STALE_MS = 500, STALE_PICTURES = 3; // a picture is stale once it is older than both

const isMine = () => document.body.classList.contains("mine");
export const picture = new LivePicture(byId("picture"), (sequence, inHandMs) => connection.send("ack", { sequence, in_hand_ms: inHandMs }), () => connection.consoleMs);
export const view = new PictureView(byId("frame"), byId("picture"), () => isMine() || profile.isOn);
export const region = new RegionTool(view, byId("region"), (chosen) => command("region", { region: chosen }));
const overlay = new Overlay(view, byId("overlay"));
const profile = new ProfileTool(view, overlay, region);
new Probe(view, overlay);
let lastPictureMs = 0;
let exposureMs = 0;
let levels = null;

window.standoff = { picture, view, connection }; // for tests and the measurements in benchmarks/

connection.addEventListener("picture", ({ detail }) => {
  picture.draw(detail);
  lastPictureMs = performance.now();
});

setInterval(() => {
  const staleMs = Math.max(STALE_MS, STALE_PICTURES * Math.max(1000 * picture.periodS(), exposureMs));
  const isStale = performance.now() - lastPictureMs > staleMs;
  byId("frame").classList.toggle("stale", isStale);
  show("no-picture", isStale);
  setText("no-picture", lastPictureMs ? "no new picture" : "no picture yet");
  const form = picture.isExact ? "" : picture.reduction > 1 ? `, at 1/${picture.reduction} of the size: the connection is slow` : ", compressed";
  setText("picture-rate", isStale ? "shown: –" : `shown: ${picture.rate().toFixed(picture.rate() < 3 ? 1 : 0)} pictures/s, ${picture.latencyMs().toFixed(0)} ms${form}`);
}, 200);

function histogram() {
  const options = { isSaturated: levels.is_saturated, isLog: byId("log").checked };
  drawHistogram(byId("histogram"), levels.counts, levels.max_level_dn + 1, options);
}

connection.addEventListener("levels", ({ detail }) => {
  levels = detail;
  histogram();
  setText("mean", levels.mean);
  setText("saturated", levels.saturated);
  byId("saturated").classList.toggle("bad", levels.is_saturated);
});

byId("log").onchange = () => { if (levels) histogram(); };
byId("grid").onchange = () => { overlay.parts = Number(byId("grid").value); overlay.draw(); };
byId("cross").onchange = () => { overlay.hasCross = byId("cross").checked; overlay.draw(); };
byId("clear-region").onclick = () => region.change(null);
byId("show-saturated").onchange = (event) => { picture.marks = event.target.checked; picture.colour(); };
byId("brighten").onchange = (event) => { picture.scale = event.target.checked ? BRIGHTEN : 1; picture.colour(); };
onKey("s", () => byId("show-saturated").click());
onKey("b", () => byId("brighten").click());
onKey("c", () => byId("cross").click());
onKey("g", () => {
  const grid = byId("grid");
  grid.selectedIndex = (grid.selectedIndex + 1) % grid.options.length;
  grid.onchange();
});

// Exposure and gain: number, buttons, and a slider whose steps are ratios.
const SLIDES = 1000;
const SLIDE_MS = 150;
let limits = [1, 1];
const setting = new Choice(); // of exposure or gain

connection.addEventListener("state", ({ detail: state }) => {
  const { camera, run } = state;
  const isFree = isMine() && camera.state === "ready" && !["running", "paused"].includes(run.state);
  limits = state.exposure_limits_us;
  exposureMs = (camera.exposure_us ?? 0) / 1000;
  for (const [id, value] of [["exposure", camera.exposure_us], ["gain", camera.gain_db]]) {
    const input = byId(id);
    const isTyped = document.activeElement === input && !input.dataset.sent;
    if (!isTyped && value !== null && setting.isSettled) input.value = value;
    for (const each of byId(`${id}-form`).elements) each.disabled = !isFree;
  }
  byId("auto-exposure").disabled = !isFree || Boolean(state.job);
  byId("snapshot").disabled = !isMine() || (byId("snapshot-frames").value !== "1" && Boolean(state.job));
  if (setting.isSettled) byId("slider").value = SLIDES * Math.log(camera.exposure_us / limits[0]) / Math.log(limits[1] / limits[0]);
  byId("slider").setAttribute("aria-valuetext", `${camera.exposure_us} µs`);
  const all = camera.complete + camera.lost + camera.incomplete;
  setText("frames-lost", `${camera.lost + camera.incomplete} of ${all}`);
  byId("frames-lost").classList.toggle("bad", camera.lost + camera.incomplete > 0);
  const resent = camera.resent ? `, ${camera.resent} packets resent` : "";
  setText("camera-facts", [camera.name, camera.format, ...camera.warnings].filter(Boolean).join(" · "));
  setText("camera-rate", `${camera.rate} frames/s from the camera${resent}`);
  byId("clear-region").disabled = !isMine();
  show("snapshot-link", Boolean(state.snapshot));
  setText("snapshot-link", state.snapshot);
  byId("snapshot-link").href = `/snapshots/${encodeURIComponent(state.snapshot)}`;
});

function wire(id, set) {
  const [form, input] = [byId(`${id}-form`), byId(id)];
  const send = () => {
    input.dataset.sent = "yes"; // what the camera made of it is shown, even while the field has the focus
    if (input.validity.badInput) tell(`The ${id} must be a number.`);
    if (number(id) === null) return;
    setting.make();
    set(number(id));
  };
  input.oninput = () => { delete input.dataset.sent; };
  form.onsubmit = (event) => {
    event.preventDefault();
    if (!input.dataset.sent) send(); // Enter means a change first, which has been sent
  };
  input.onchange = send;
  for (const button of form.querySelectorAll("[data-scale], [data-add]")) {
    button.onclick = () => {
      const now = input.valueAsNumber || 0;
      const next = button.dataset.scale ? now * button.dataset.scale : now + Number(button.dataset.add);
      input.value = Math.max(Number(next.toFixed(1)), Number(input.min));
      send();
    };
  }
  return send;
}

connection.addEventListener("refused", () => setting.settle()); // the fields are set back

const sendExposure = wire("exposure", setExposure);
wire("gain", (gain_db) => command("gain", { gain_db }));
let sliding = null;
byId("slider").oninput = () => {
  setting.make();
  const exposureUs = limits[0] * (limits[1] / limits[0]) ** (byId("slider").value / SLIDES);
  byId("exposure").value = Number(exposureUs.toPrecision(3));
  sliding ??= setTimeout(() => { sliding = null; sendExposure(); }, SLIDE_MS); // the last value counts
};
byId("auto-exposure").onclick = () => command("auto-exposure");
byId("snapshot").onclick = () => command("snapshot", { frames: Number(byId("snapshot-frames").value) });
onKey("n", () => byId("snapshot").click());
onKey("a", () => byId("auto-exposure").click());
