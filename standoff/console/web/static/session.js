// The page of one session: report, resume, retake, pose reference.

import { byId, command, connection } from "./shell.js";

const session = byId("session").dataset.name;
let wasWriting = false;

byId("write-report").onclick = () => {
  command("report", { session });
  // A report that is done before the next state comes is shown as well.
  wasWriting = true;
};
if (byId("resume-session")) byId("resume-session").onclick = () => { command("resume", { session }); location.href = "/"; };
for (const button of document.querySelectorAll("[data-retake]")) {
  button.onclick = () => command("retake", { session, index: Number(button.dataset.retake) });
}
for (const button of document.querySelectorAll("[data-reference]")) {
  button.onclick = () => command("pose-reference", { session, index: Number(button.dataset.reference) });
}

connection.addEventListener("state", ({ detail: { job, control } }) => {
  for (const button of document.querySelectorAll("main button")) button.disabled = !control.is_mine || (job && !button.dataset.reference);
  const isWriting = Boolean(job?.name.startsWith("writing the report"));
  if (wasWriting && !isWriting) location.reload();
  wasWriting = isWriting;
});
