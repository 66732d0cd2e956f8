// How old the figures are: what is old is grey and says its age, what is very old is not shown.

import { begin } from "./charts.js";
import { seconds } from "./connection.js";
import { byId, connection, setText, show } from "./shell.js";

// Figures that are nothing once they are too old, by the name of their age.
const FIGURES = {
  focus: ["focus-percent", "focus-value", "focus-peak"],
  levels: ["mean", "saturated"],
  stage: ["stage-height"],
};
const CHARTS = { focus: ["trace"], levels: ["histogram"], edge: ["esf"] };

let ages = {};

// What the console said, and the time since then.
function ageOf(name) {
  const { age_s: ageS, stale_s: staleS, nothing_s: nothingS } = ages[name] ?? { age_s: null };
  if (ageS === null) return { isStale: false, isNothing: false, text: "" };
  // While the console speaks, its next word is awaited before anything is added.
  const total = ageS + (connection.isOpen ? 0 : connection.silentMs / 1000);
  return { isStale: total > staleS, isNothing: total > nothingS, text: `${seconds(1000 * total)} old` };
}

function look() {
  for (const element of document.querySelectorAll("[data-age]")) {
    const { isStale, text } = ageOf(element.dataset.age);
    element.classList.toggle("stale", isStale);
    if (isStale) element.dataset.old = text; else delete element.dataset.old;
  }
  for (const name of Object.keys(ages)) {
    if (!ageOf(name).isNothing) continue;
    for (const id of FIGURES[name] ?? []) setText(id, "–");
    for (const id of CHARTS[name] ?? []) begin(byId(id));
  }
  if (!connection.isOpen && ageOf("camera").isNothing) setText("camera-rate", "– frames/s from the camera");
  if (ageOf("focus").isNothing) setText("focus-hint", "no new picture");
  if (ageOf("pose").isNothing && byId("pose-verdict").textContent !== "–") setText("pose-verdict", "…");
  if (!connection.isOpen && ageOf("stage").isNothing) setText("stage-motion", "not known");
  if (ageOf("edge").isNothing && !byId("edge").hidden) {
    show("edge", false);
    show("edge-why", true);
    setText("edge-why", "no new picture");
  }
  if (ageOf("square").isNothing) for (const id of ["square-advice", "square-tilt"]) setText(id, "–");
  byId("corners").hidden = ageOf("edge").isNothing;
}

connection.addEventListener("state", ({ detail }) => { ages = detail.ages; look(); });
connection.addEventListener("tick", look);
