// The bench page: picture, focus, stage, session.

import "./ages.js";
import { drawTrace } from "./charts.js";
import { region } from "./picture_card.js";
import { byId, command, connection, costOf, nameCells, onKey, setText, show } from "./shell.js";
import { TypedNumbers } from "./typed.js";

const AGAIN_MS = 3000;

let state = null;
let planShown = "";
let isPlanRunning = false;
let isRoom = true; // on the disk, for the plan that is chosen

connection.addEventListener("levels", ({ detail }) => {
  drawTrace(byId("trace"), detail.trace, detail.trace_s, Number(state?.focus.peak) || 0, state?.focus.is_past_peak && !isPlanRunning);
});

connection.addEventListener("state", ({ detail }) => {
  state = detail;
  const { focus, stage, run, control } = state;
  const isMine = control.is_mine;
  focus_(focus, isMine);
  stage_(stage, isMine);
  run_(run, isMine);
});

function enable(isEnabled, ...ids) { for (const id of ids) if (byId(id)) byId(id).disabled = !isEnabled; }

function focus_(focus, isMine) {
  setText("focus-percent", focus.percent_text);
  setText("focus-value", focus.value);
  setText("focus-peak", focus.peak);
  setText("focus-hint", isPlanRunning ? "" : focus.hint); // a session's heights are its plan's
  byId("focus-hint").className = `hint ${focus.is_past_peak ? "past" : focus.trend}`;
  region.set(focus.region);
  if (document.activeElement !== byId("metric")) byId("metric").value = focus.metric;
  enable(isMine, "metric", "forget-peak");
}

function stage_(stage, isMine) {
  const isReady = isMine && stage.state === "ready" && !state.job;
  setText("stage-height", stage.height);
  setText("stage-name", stage.name);
  setText("stage-motion", state.job?.is_stopping ? "stopping" : stage.motion_text);
  byId("stage-motion").className = `hint ${stage.state !== "ready" || stage.motion === "alarm" ? "fail" : stage.motion}`;
  setText("stage-target", stage.target || stage.warnings.join("; ") || (state.job ? `waits for: ${state.job.name}` : ""));
  setText("stage-homed", stage.homed_text);
  byId("stage-homed").className = `tag ${stage.is_homed ? "ok" : "warn"}`;
  setText("stage-limits", stage.limits);
  show("unlock", stage.motion === "alarm");
  byId("home").classList.toggle("primary", stage.state === "ready" && !stage.is_homed && stage.motion !== "homing");
  enable(isReady, "home", "unlock");
  for (const element of [...byId("move-form").elements, ...document.querySelectorAll("[data-step]")]) {
    if (element.id !== "home" && element.id !== "unlock") element.disabled = !(isReady && stage.is_homed);
  }
}

function run_(run, isMine) {
  isPlanRunning = ["running", "paused"].includes(run.state);
  const level = { running: "ok", finished: "ok", paused: "warn", stopped: "warn", failed: "fail" }[run.state] || "";
  setText("run-state", run.state === "idle" ? "" : run.state);
  byId("run-state").className = `tag ${level}`;
  setText("run-name", run.session && `${run.session} · ${run.plan}`);
  setText("run-left", run.left);
  show("run-progress-row", run.state !== "idle");
  byId("run-progress").max = Math.max(run.planned, 1);
  byId("run-progress").value = run.captured;
  setText("run-count", `${run.captured} of ${run.planned}`);
  show("pause", isPlanRunning && !run.is_pause_wanted);
  show("go-on", isPlanRunning && run.is_pause_wanted);
  show("resume-last", ["stopped", "failed"].includes(run.state) || (run.state === "finished" && run.captured < run.planned));
  show("run-placed", Boolean(run.placed));
  byId("run-placed").firstElementChild.textContent = run.placed;
  show("run-message", Boolean(run.message));
  setText("run-message", run.message);
  show("run-form", !isPlanRunning);
  show("preview", !isPlanRunning);
  enable(isMine, "pause", "go-on", "target-moved");
  enable(isMine && !state.job && isRoom, "run");
  enable(isMine && !state.job, "resume", "resume-last"); // the rest of a plan may still have room
  for (const button of document.querySelectorAll("#plan-table button")) button.disabled = !isMine;
}

connection.addEventListener("plan", ({ detail }) => { if (detail.rows.length) table(detail.rows, detail.session); });
connection.addEventListener("preview", ({ detail }) => {
  if (isPlanRunning) return;
  isRoom = detail.is_room;
  byId("run").title = isRoom ? "" : "There is not enough space on the disk for this plan";
  byId("preview").classList.toggle("bad", !isRoom);
  setText("preview", costOf(detail));
  if (state) run_(state.run, state.control.is_mine); // Run goes with the room, not with the next state
  if (!state || state.run.state === "idle" || planShown === "preview") table(detail.rows, "");
});

const STATES = { pending: "", next: "▶ next", done: "✓ done", failed: "✗ failed" };

function table(rows, session) {
  planShown = session ? "run" : "preview";
  const body = byId("plan-table").tBodies[0];
  body.replaceChildren(...rows.map((row) => {
    const line = document.createElement("tr");
    line.className = row.state;
    for (const [text, kind] of [[row.index, "figure"], [row.what, ""], [row.orientation, "figure"], [row.height, "figure"], [row.focus, "figure"], [STATES[row.state] + (row.note ? `: ${row.note}` : ""), "state"]]) {
      const cell = line.insertCell();
      cell.textContent = text;
      cell.className = kind;
    }
    const cell = line.insertCell();
    cell.className = "buttons";
    if (row.state === "done" && session) {
      const again = document.createElement("button");
      again.type = "button";
      again.textContent = "Retake";
      again.onclick = () => command("retake", { session, index: row.index });
      cell.append(again);
    }
    return line;
  }));
  nameCells(byId("plan-table"));
  show("plan-table", rows.length > 0);
}

function preview() {
  if (byId("plan").value) connection.send("preview", { plan: byId("plan").value });
}

byId("metric").onchange = () => command("metric", { metric: byId("metric").value });
byId("forget-peak").onclick = () => command("forget-peak");
byId("home").onclick = () => command("home");
byId("unlock").onclick = () => command("unlock");
const typedHeight = new TypedNumbers("move", { height_mm: ["move-to", "height"] });
byId("move-form").onsubmit = (event) => {
  event.preventDefault();
  const typed = typedHeight.read();
  if (typed && typed.height_mm !== null) command("move", typed);
};
for (const button of document.querySelectorAll("[data-step]")) {
  button.onclick = () => command("move", { height_mm: Number(button.dataset.step), is_relative: true });
}
byId("plan").onchange = () => { planShown = "preview"; preview(); };
byId("run-form").onsubmit = (event) => {
  event.preventDefault();
  const name = byId("session-name").value.trim() || freshName();
  byId("session-name").value = "";
  command("run", { plan: byId("plan").value, session: name });
};
byId("pause").onclick = () => command("pause");
byId("target-moved").onclick = () => command("target-moved");
byId("go-on").onclick = () => command("go-on");
byId("resume-last").onclick = () => command("resume", { session: state.run.session });
if (byId("resume")) byId("resume").onclick = () => command("resume", { session: byId("unfinished").value });

function freshName() {
  const now = new Date();
  const two = (value) => String(value).padStart(2, "0");
  return `${byId("plan").value} ${now.getFullYear()}-${two(now.getMonth() + 1)}-${two(now.getDate())} ${two(now.getHours())}.${two(now.getMinutes())}.${two(now.getSeconds())}`;
}

onKey("f", () => byId("forget-peak").click());
onKey("p", () => (state?.run.is_pause_wanted ? byId("go-on") : byId("pause")).click());
connection.addEventListener("open", preview);
setInterval(() => { if (!isRoom && connection.isOpen) preview(); }, AGAIN_MS); // space may be freed meanwhile
if (connection.isOpen) preview();
