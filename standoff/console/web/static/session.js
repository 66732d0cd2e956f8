// The page of one session: results, resume, retake, exclude, pose reference.

import { ResultProgress } from "./result_progress.js";
import { byId, command, connection } from "./shell.js";

const session = byId("session").dataset.name;
const hadCurves = byId("session").dataset.curves === "yes";
const progress = new ResultProgress((result) => result.session === session);

function compute(result, fields = {}) {
  command("result", { session, result, ...fields });
}

for (const button of document.querySelectorAll("[data-result]")) {
  button.onclick = () => {
    const isReplacing = "done" in button.dataset && button.dataset.result !== "verify";
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

// What is typed into the journal's forms outlives a reload that something else asks for; what was
// typed since, before this script ran, outlives that.
const DRAFT = `draft of ${session}`;
const typed = () => document.querySelectorAll("#note input, #set-height input, #set-height select");
const draft = JSON.parse(sessionStorage.getItem(DRAFT) ?? "[]");
sessionStorage.removeItem(DRAFT);
if (draft.length === typed().length) typed().forEach((field, at) => { field.value ||= draft[at]; });

function reload() {
  sessionStorage.setItem(DRAFT, JSON.stringify([...typed()].map(({ value }) => value)));
  location.reload();
}

function change(what, fields) {
  connection.addEventListener("changed", () => {
    byId(what)?.reset();
    reload();
  }, { once: true });
  command(what, { session, ...fields });
}

byId("note").onsubmit = (event) => {
  event.preventDefault();
  change("note", { text: byId("note").elements.text.value });
};
if (byId("set-height")) {
  byId("set-height").onsubmit = (event) => {
    event.preventDefault();
    const { index, height_mm: height, reason } = byId("set-height").elements;
    change("set-height", { index: index.value ? Number(index.value) : null, height_mm: height.valueAsNumber, reason: reason.value });
  };
}
if (byId("export")) {
  byId("export").onsubmit = (event) => {
    event.preventDefault();
    const { file_format: format, is_replacing: isReplacing } = byId("export").elements;
    command("export", { session, file_format: format.value, is_replacing: isReplacing.checked });
  };
}

connection.addEventListener("state", ({ detail }) => {
  const { job, control, pose } = detail;
  for (const button of document.querySelectorAll("main button:not(#cancel-result)")) button.disabled = !control.is_mine || (job && !button.dataset.reference);
  const isEnded = progress.show(detail);
  // Curves were chosen meanwhile, or none: poses can be computed now, or not.
  const isTyping = document.activeElement.matches("input, select");
  if (isEnded || (pose.is_possible !== hadCurves && !isTyping)) reload();
});
