// The card of the live picture: its view, its tools and what is drawn over it.

import { drawHistogram } from "./charts.js";
import { LivePicture } from "./picture.js";
import { PictureView } from "./picture_view.js";
import { Overlay, Probe, ProfileTool } from "./picture_tools.js";
import { RegionTool } from "./region_tool.js";
import { byId, command, connection, onKey, setText, show } from "./shell.js";

const BRIGHTEN = 4;
const STALE_MS = 1500;

const isMine = () => document.body.classList.contains("mine");
export const picture = new LivePicture(byId("picture"), (sequence) => connection.send("ack", { sequence }));
export const view = new PictureView(byId("frame"), byId("picture"), () => isMine() || profile.isOn);
export const region = new RegionTool(view, byId("region"), (chosen) => command("region", { region: chosen }));
const overlay = new Overlay(view, byId("overlay"));
const profile = new ProfileTool(view, overlay, region);
new Probe(view, overlay);
let lastPictureMs = 0;
let levels = null;

window.standoff = { picture, view, connection }; // for tests and the measurements in benchmarks/

connection.addEventListener("picture", ({ detail }) => {
  picture.draw(detail);
  lastPictureMs = performance.now();
});

setInterval(() => {
  const isStale = performance.now() - lastPictureMs > STALE_MS;
  byId("frame").classList.toggle("stale", isStale);
  show("no-picture", isStale);
  setText("no-picture", lastPictureMs ? "no new picture" : "no picture yet");
  setText("picture-rate", isStale ? "–" : `${picture.rate().toFixed(0)} pictures/s, ${picture.latencyMs().toFixed(0)} ms`);
}, 500);

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
