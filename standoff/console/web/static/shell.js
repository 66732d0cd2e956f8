// Common to every page: devices, control, stop, questions, notices.

import { Connection, operator, seconds } from "./connection.js";
import { Stop } from "./stop.js";

const NOTICE_MS = 20000;
const MOST_NOTICES = 4;
const LATE_MS = 500; // an answer that takes longer is told
const MUTE_MS = 1500; // one that takes so long may never come
const ANSWER_MS = 1000; // by then the console has taken a choice over, or refused it

export const byId = (id) => document.getElementById(id);
export const setText = (id, text) => {
  const element = byId(id);
  if (element && element.textContent !== String(text)) element.textContent = text;
};
export const number = (id) => { const value = byId(id).valueAsNumber; return Number.isFinite(value) ? value : null; };
export const show = (id, isShown) => { const element = byId(id); if (element) element.hidden = !isShown; };

// On a phone a table is a list, in which each cell has its column's title (console.css).
export function nameCells(table) {
  const titles = [...table.tHead.rows[0].cells].map((cell) => (cell.querySelector(".unseen") ? "" : cell.textContent));
  for (const row of table.tBodies[0].rows) for (const cell of row.cells) if (titles[cell.cellIndex]) cell.dataset.title = titles[cell.cellIndex];
}
for (const table of document.querySelectorAll(".table table")) nameCells(table);

const counted = (count, noun) => `${count} ${noun}${count === 1 ? "" : "s"}`;
export const costOf = (plan) => [
  `${counted(plan.captures, "capture")}, ${counted(plan.placements, "placement")}, about ${plan.time} plus your own time, ${plan.disk} on disk${plan.is_room ? "" : ` — NOT ENOUGH DISK SPACE: ${plan.room}`}`,
  ...plan.warnings,
].join(" · ");

export const connection = new Connection({ pictures: Boolean(byId("picture")) });
let seenNotice = null;
let promptShown = null;

export function command(what, fields = {}) {
  if (!connection.send(what, fields)) tell("The console is not responding.");
}

export function tell(text) {
  const item = document.createElement("li");
  item.textContent = text;
  const list = byId("notices");
  list.prepend(item); // the newest is seen without scrolling
  list.scrollTop = 0;
  while (list.children.length > MOST_NOTICES) list.lastChild.remove();
  setTimeout(() => item.remove(), NOTICE_MS);
}

// Until an operator's choice is settled, what the console says may be of before it.
export class Choice {
  settledMs = -Infinity;
  make() { this.settledMs = performance.now() + ANSWER_MS; }
  settle() { this.settledMs = -Infinity; }
  get isSettled() { return performance.now() > this.settledMs; }
}

function chip(id, name, level, title) {
  const element = byId(id);
  setText(id, name);
  element.className = `chip ${level}`;
  element.title = title;
}

function device(id, status) {
  if (!status) return; // a console without a bench
  const isLate = status.state === "ready" && status.validity && status.validity !== "valid"; // no picture comes
  const level = isLate ? "warn" : { ready: "ok", opening: "warn", lost: "fail" }[status.state];
  chip(`chip-${id}`, id, level, isLate ? "no new picture" : status.text || status.name);
  const alert = byId(`alert-${id}`);
  alert.hidden = status.state !== "lost";
  alert.querySelector(".what").textContent = status.text.endsWith(".") ? status.text : `${status.text}.`;
  alert.querySelector(".remedy").textContent = status.remedy;
}

function prompt(question, isMine) {
  const form = byId("prompt");
  form.hidden = !question;
  const shown = question ? `${question.number} ${isMine}` : null;
  if (shown === promptShown) return;
  promptShown = shown;
  if (!question) return;
  setText("prompt-text", question.text);
  const line = byId("prompt-line");
  line.hidden = !question.wants_text;
  line.value = "";
  const choices = byId("prompt-choices");
  choices.replaceChildren(...question.choices.map(({ key, label }, index) => {
    const button = document.createElement("button");
    button.type = index === 0 ? "submit" : "button";
    button.textContent = label;
    button.dataset.choice = key;
    if (index === 0) button.className = "primary";
    button.disabled = !isMine;
    button.onclick = (event) => {
      event.preventDefault();
      command("answer", { number: question.number, choice: key, text: line.value });
    };
    return button;
  }));
  if (isMine) (question.wants_text ? line : choices.firstChild).focus();
}

function takeControl() {
  const name = window.prompt("Your name, for the journal:", operator()) ?? null;
  if (name === null) return;
  localStorage.setItem("operator", name.slice(0, 60));
  command("take", { name: name.slice(0, 60) });
}

const stopping = byId("stop") && new Stop(connection, byId("stop"), byId("alert-stop"), byId("alert-moving"), tell);

connection.addEventListener("open", () => {
  show("alert-connection", false);
  document.body.classList.remove("lost");
});
connection.addEventListener("lost", () => {
  show("alert-connection", true);
  setText("control-text", "not connected");
  document.body.classList.remove("mine");
  document.body.classList.add("lost");
});
connection.addEventListener("tick", () => {
  const { isOpen, silentMs, latencyMs } = connection;
  const silent = seconds(silentMs);
  setText("silent", silent);
  if (isOpen) document.body.style.removeProperty("--old");
  else document.body.style.setProperty("--old", `"${silent} old"`);
  show("chip-latency", isOpen && latencyMs > LATE_MS);
  setText("latency", seconds(latencyMs));
  show("alert-mute", isOpen && latencyMs > MUTE_MS);
});
connection.addEventListener("refused", ({ detail }) => { if (detail.do !== "plan-check") tell(detail.text); }); // which says it at the field
connection.addEventListener("state", ({ detail: state }) => {
  device("camera", state.camera);
  device("stage", state.stage);
  chip("chip-disk", state.disk.text, state.disk.level, "disk space for sessions");
  show("chip-compiling", state.is_compiling);
  setText("control-text", state.control.text);
  byId("control-text").title = `${state.control.text}; ${state.control.viewers} page(s) connected`;
  show("rename", state.control.is_mine);
  setText("rename", state.control.holder);
  byId("rename").title = `${state.control.holder}: change the name recorded in the journal`;
  const { is_mine: isMine, is_asking: isAsking, may_take: mayTake, asked_by: asker } = state.control;
  show("take-control", !isMine && (!isAsking || mayTake));
  setText("take-control", mayTake ? "Take control" : "Ask for control");
  show("stop-asking", isAsking);
  show("asked", Boolean(asker));
  setText("asked-by", asker);
  show("release-control", state.control.is_mine && state.control.viewers > 1);
  document.body.classList.toggle("mine", state.control.is_mine);
  prompt(state.prompt, state.control.is_mine);
  const last = state.notices.at(-1)?.number ?? 0;
  if (seenNotice === null || last < seenNotice) seenNotice = last;
  for (const notice of state.notices) if (notice.number > seenNotice) tell(notice.text);
  seenNotice = Math.max(seenNotice, last);
});

if (stopping) {
  byId("stop").onclick = () => stopping.press();
  byId("stop").disabled = false; // before, it would not have been heard
  byId("stop-seen").onclick = () => stopping.seen();
}
byId("take-control").onclick = takeControl;
byId("rename").onclick = takeControl;
byId("stop-asking").onclick = () => command("refuse");
byId("grant").onclick = () => command("grant");
byId("refuse").onclick = () => command("refuse");
byId("release-control").onclick = () => command("release");
byId("prompt").onsubmit = (event) => event.preventDefault();
// Escape is the stop key everywhere, even in a text field, before any other handler.
window.addEventListener("keydown", (event) => { if (stopping && event.key === "Escape") { event.preventDefault(); if (!event.repeat) stopping.press(); } }, true);

export function onKey(key, act) {
  window.addEventListener("keydown", (event) => {
    const typing = event.target.closest("input:not([type=checkbox], [type=range]), select, textarea");
    if (typing || event.ctrlKey || event.metaKey || event.altKey || event.repeat) return;
    if (event.key.toLowerCase() === key) { event.preventDefault(); act(); }
  });
}
