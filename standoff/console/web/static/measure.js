// Live measurement: the edge under the region, four corners, squareness; and the focus sweep.

import { drawEdge, drawSweep } from "./charts.js";
import { view } from "./picture_card.js";
import { Choice, byId, command, connection, setText, show } from "./shell.js";
import { TypedNumbers } from "./typed.js";

const WAITING = "drag a region over a straight edge to measure it";
const MEASURING = "measuring the edge …";
const COMPILING = "the first edge waits for the numerical code, which is compiled once: up to a minute …";
const watched = { "watch-field": new Choice(), "watch-square": new Choice() };
let corners = [];
let peakMm = null;
let isAwaited = false;
let isCompiling = false;

connection.addEventListener("measure", ({ detail }) => {
  const { edge } = detail;
  show("edge", Boolean(edge));
  show("edge-why", !edge);
  isAwaited = detail.is_awaited;
  setText("edge-why", detail.why_not || (isAwaited ? awaited() : WAITING));
  if (edge) {
    for (const [id, text] of [["sigma", edge.sigma], ["mtf50", edge.mtf50], ["lp", edge.mtf50_lp]]) setText(`edge-${id}`, text);
    const others = edge.edges > 1 ? `, the longest of ${edge.edges}` : "";
    const remarks = edge.remarks ? `; ${edge.remarks}` : "";
    setText("edge-note", `at ${edge.angle}°${others}, ${detail.rate}/s${remarks}`);
    drawEdge(byId("esf"), edge.distance, edge.levels);
  }
  const { square } = detail;
  const said = { "watch-field": detail.has_field, "watch-square": square.is_wanted };
  for (const [id, choice] of Object.entries(watched)) if (choice.isSettled) byId(id).checked = said[id];
  place(detail.field);
  show("square", square.is_wanted);
  setText("square-advice", square.advice || (square.why_not && "no tilt") || "…");
  byId("square-advice").className = `hint ${square.advice === "level" ? "rising" : ""}`;
  setText("square-tilt", square.why_not || square.tilt);
});

const awaited = () => (isCompiling ? COMPILING : MEASURING);
connection.addEventListener("state", ({ detail }) => {
  isCompiling = detail.is_compiling;
  if (isAwaited) setText("edge-why", awaited());
});

// The four regions on the picture, with their focus in percent of their own peak.
function place(field = corners) {
  corners = field;
  const boxes = byId("corners");
  while (boxes.children.length < field.length) boxes.append(Object.assign(document.createElement("div"), { className: "corner" }));
  [...boxes.children].forEach((box, index) => {
    const corner = field[index];
    box.hidden = !corner;
    if (!corner) return;
    view.cover(box, corner.region);
    const sigma = corner.sigma === "–" ? "" : `\nσ ${corner.sigma} px`;
    const text = corner.why_not || `${corner.percent} %${sigma}`;
    if (box.textContent !== text) box.textContent = text;
  });
}
view.addEventListener("change", () => place());

connection.addEventListener("sweep", ({ detail }) => {
  const isRunning = detail.state === "running";
  show("sweep", detail.points.length > 0);
  show("sweep-message", detail.state !== "idle");
  setText("sweep-message", isRunning ? `sweeping: ${detail.progress}` : detail.message);
  byId("sweep-message").className = `hint ${{ done: "rising", failed: "past" }[detail.state] ?? ""}`;
  setText("sweep-advice", detail.advice);
  byId("sweep-advice").title = detail.tilt;
  peakMm = detail.peak_mm;
  show("go-to-peak", peakMm !== null);
  if (detail.points.length) drawSweep(byId("sweep"), detail.points, detail.curve, peakMm);
});

connection.addEventListener("state", ({ detail: { control, stage, camera, job } }) => {
  const isFree = control.is_mine && !job && stage.state === "ready" && camera.state === "ready";
  for (const element of byId("sweep-form").elements) element.disabled = !isFree;
  byId("go-to-peak").disabled = !isFree;
  for (const id of Object.keys(watched)) byId(id).disabled = !control.is_mine;
});

const typedSweep = new TypedNumbers("sweep-focus", {
  low_mm: ["sweep-low", "lowest height"],
  high_mm: ["sweep-high", "highest height"],
  steps: ["sweep-steps", "number of heights"],
});
byId("sweep-form").onsubmit = (event) => {
  event.preventDefault();
  const typed = typedSweep.read();
  if (typed) command("sweep-focus", {
    ...typed,
    has_field: byId("sweep-corners").checked,
    ends_at_peak: byId("sweep-ends").checked,
  });
};
byId("go-to-peak").onclick = () => command("move", { height_mm: peakMm });
for (const [id, choice] of Object.entries(watched)) {
  byId(id).onchange = ({ target }) => { choice.make(); command(id, { is_on: target.checked }); };
}
