// The card of the live picture: its view, its tools and what is drawn over it.

import { LivePicture } from "./picture.js";
import { PictureView } from "./picture_view.js";
import { RegionTool } from "./region_tool.js";
import { byId, command, connection, onKey, setText, show } from "./shell.js";

const BRIGHTEN = 4;
const STALE_MS = 1500;

const isMine = () => document.body.classList.contains("mine");
export const picture = new LivePicture(byId("picture"), (sequence) => connection.send("ack", { sequence }));
export const view = new PictureView(byId("frame"), byId("picture"), isMine);
export const region = new RegionTool(view, byId("region"), (chosen) => command("region", { region: chosen }));
let lastPictureMs = 0;

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

byId("clear-region").onclick = () => region.change(null);
byId("show-saturated").onchange = (event) => { picture.marks = event.target.checked; picture.colour(); };
byId("brighten").onchange = (event) => { picture.scale = event.target.checked ? BRIGHTEN : 1; picture.colour(); };
onKey("s", () => byId("show-saturated").click());
onKey("b", () => byId("brighten").click());
