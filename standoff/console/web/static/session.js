// The page of one session: results, resume, retake, exclude, pose reference.

import { byId, command, connection, setText, show } from "./shell.js";

const session = byId("session").dataset.name;
const hadCurves = byId("session").dataset.curves === "yes";
const LEVELS = { running: "warn", done: "ok", failed: "fail", stopped: "warn" };
let wasRunning = false;
let numberSeen = null; // of the last result: each one has the next number

function compute(result, fields = {}) {
  command("result", { session, result, ...fields });
}

for (const button of document.querySelectorAll("[data-result]")) {
  button.onclick = () => {
    const isReplacing = "done" in button.dataset;
    if (isReplacing && !window.confirm("Replace the earlier result?")) return;
    compute(button.dataset.result, { is_replacing: isReplacing });
  };
}
for (const form of document.querySelectorAll("[data-pair]")) {
  form.onsubmit = (event) => {
    event.preventDefault();
    const { followup, reference, reference_session, is_replacing } = form.elements;
    compute(form.dataset.pair, {
      followup: Number(followup.value),
      reference: Number(reference.value),
      reference_session: reference_session.value || null,
      is_replacing: is_replacing.checked,
    });
  };
}
connection.addEventListener("refused", ({ detail }) => {
  if (detail.do !== "result") return;
  for (const form of document.querySelectorAll("[data-pair]")) {
    const field = form.elements[detail.key];
    if (field) field.value = field.defaultValue;
  }
});
byId("cancel-result").onclick = () => command("cancel-result");
if (byId("resume-session")) byId("resume-session").onclick = () => { command("resume", { session }); location.href = "/"; };

const ACTIONS = {
  retake: (index) => command("retake", { session, index }),
  reference: (index) => command("pose-reference", { session, index }),
  exclude: (index) => {
    const reason = window.prompt(`Why is capture ${index} not to be used? The reason is recorded.`);
    if (reason?.trim()) change("exclude", { index, reason: reason.trim().slice(0, 300) });
  },
  include: (index) => change("include", { index }),
};
for (const [name, act] of Object.entries(ACTIONS)) {
  for (const button of document.querySelectorAll(`[data-${name}]`)) button.onclick = () => act(Number(button.dataset[name]));
}

function change(what, fields) {
  connection.addEventListener("changed", () => location.reload(), { once: true });
  command(what, { session, ...fields });
}

connection.addEventListener("state", ({ detail: { job, control, result, pose } }) => {
  const isRunning = result.state === "running";
  for (const button of document.querySelectorAll("main button")) button.disabled = !control.is_mine || (job && !button.dataset.reference);
  byId("cancel-result").disabled = !control.is_mine || !isRunning || Boolean(job?.is_stopping);
  show("result-progress", isRunning);
  setText("result-title", `${result.title.charAt(0).toUpperCase()}${result.title.slice(1)}`);
  setText("result-text", [job?.is_stopping ? "stopping" : result.text || "starting", result.total ? `${result.done} of ${result.total}` : "", `${result.seconds} s`].filter(Boolean).join(" · "));
  const bar = byId("result-bar");
  if (result.total) { bar.max = result.total; bar.value = result.done; } else bar.removeAttribute("value");
  const isTold = !isRunning && result.session === session && Boolean(result.message);
  show("result-message", isTold);
  byId("result-message").className = `alert ${result.is_alarming ? "warn" : LEVELS[result.state] || ""}`;
  setText("result-message", result.message);
  // A result that is done before the next state comes is shown as well.
  const isEnded = !isRunning && (wasRunning || (numberSeen !== null && result.number !== numberSeen));
  numberSeen = result.number;
  wasRunning = isRunning;
  // Curves were chosen meanwhile, or none: poses can be computed now, or not.
  const isTyping = document.activeElement.matches("input, select");
  if ((isEnded && result.session === session) || (pose.is_possible !== hadCurves && !isTyping)) location.reload();
});
