// Live measurement: the edge under the region, four corners, squareness; and the focus sweep.

import { drawEdge, drawSweep } from "./charts.js";
import { view } from "./picture_card.js";
import { byId, command, connection, setText, show } from "./shell.js";

const WAITING = "drag a region over a straight edge to measure it";
let corners = [];
let peakMm = null;

connection.addEventListener("measure", ({ detail }) => {
  const { edge } = detail;
  show("edge", Boolean(edge));
  show("edge-why", !edge);
  setText("edge-why", detail.why_not || WAITING);
  if (edge) {
    setText("edge-sigma", edge.sigma);
    setText("edge-mtf50", edge.mtf50);
    setText("edge-lp", edge.mtf50_lp);
    setText("edge-note", `at ${edge.angle}°${edge.edges > 1 ? `, the longest of ${edge.edges}` : ""}, ${detail.rate}/s`);
    drawEdge(byId("esf"), edge.distance, edge.levels);
  }
  byId("watch-field").checked = detail.has_field;
  place(detail.field);
  const { square } = detail;
  byId("watch-square").checked = square.is_wanted;
  show("square", square.is_wanted);
  setText("square-advice", square.advice || (square.why_not && "no tilt") || "…");
  byId("square-advice").className = `hint ${square.advice === "level" ? "rising" : ""}`;
  setText("square-tilt", square.why_not || square.tilt);
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
    const [left, top] = view.shown(corner.region);
    const [width, height] = corner.region.slice(2).map((value) => value * view.scale);
    for (const [name, value] of Object.entries({ left, top, width, height })) box.style[name] = `${value}px`;
    const text = `${corner.percent} %${corner.sigma === "–" ? "" : `\nσ ${corner.sigma} px`}`;
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
  for (const id of ["watch-field", "watch-square"]) byId(id).disabled = !control.is_mine;
});

const number = (id) => {
  const value = byId(id).valueAsNumber;
  return Number.isFinite(value) ? value : null;
};

byId("sweep-form").onsubmit = (event) => {
  event.preventDefault();
  command("sweep-focus", {
    low_mm: number("sweep-low"),
    high_mm: number("sweep-high"),
    steps: number("sweep-steps") ?? 15,
    has_field: byId("sweep-corners").checked,
    ends_at_peak: byId("sweep-ends").checked,
  });
};
byId("go-to-peak").onclick = () => command("move", { height_mm: peakMm });
byId("watch-field").onchange = (event) => command("watch-field", { is_on: event.target.checked });
byId("watch-square").onchange = (event) => command("watch-square", { is_on: event.target.checked });
