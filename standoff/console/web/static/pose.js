// The pose card: the verdict, its reference, and what it is judged by: a curve of a file, a threshold.

import { Choice, byId, command, connection, number, setText, show, tell } from "./shell.js";

const LARGEST_BYTES = 4 * 2 ** 20; // as the console has it
const RETRY_MS = 1000;
const LEVELS = { GO: "go", "NO GO": "no", UNSURE: "unsure" };

const choice = new Choice();
const [file, curve, threshold, picker] = ["curve-file", "curve-name", "min-dprime", "curve-pick"].map(byId);
let lists = { revision: null, files: [], curves: [] };
let askedMs = -Infinity, asked = 0;

connection.addEventListener("state", ({ detail: { pose, control } }) => {
  verdict(pose);
  judged(pose.curve);
  for (const element of [byId("pose-here"), byId("pose-clear"), byId("curve-send"), file, curve, threshold]) element.disabled = !control.is_mine;
  show("pose-clear", Boolean(pose.reference));
  show("overlay-fault", Boolean(pose.overlay.fault));
  setText("overlay-fault", pose.overlay.fault);
});

function verdict(pose) {
  setText("pose-verdict", pose.verdict || "–");
  byId("pose-verdict").className = `verdict ${LEVELS[pose.verdict] ?? ""}`;
  setText("pose-reason", pose.reference ? pose.reason : "choose a reference: this picture, or a capture of a session");
  setText("pose-reference", pose.reference ? `${pose.margin && `margin ${pose.margin} · `}${pose.probability && `${pose.probability} sure of the threshold · `}against ${pose.reference}` : "");
}

function judged(chosen) {
  if (chosen.revision !== lists.revision && performance.now() - askedMs >= RETRY_MS) fetchLists();
  show("curve-words", Boolean(chosen.name));
  setText("curve-words", chosen.name);
  if (!choice.isSettled) return;
  if (![...file.options].some((each) => each.value === chosen.file)) file.add(new Option(chosen.file, chosen.file));
  if (file.value !== chosen.file) file.value = chosen.file;
  const number = chosen.chosen ?? "";
  if (curve.value !== String(number)) curve.value = number;
  const isTyped = document.activeElement === threshold && !threshold.dataset.sent;
  if (!isTyped) threshold.value = chosen.min_dprime;
}

async function fetchLists() {
  askedMs = performance.now();
  const turn = ++asked;
  let answered;
  try {
    const answer = await fetch("/pose/curves");
    if (!answer.ok) return;
    answered = await answer.json();
  } catch { return; } // the console is lost: asked again later
  if (turn !== asked) return; // asked once more meanwhile: the files may be others
  lists = answered;
  askedMs = -Infinity;
  const chosen = file.value;
  file.replaceChildren(new Option("nothing", ""), ...lists.files.map((each) => new Option(each, each)));
  if (chosen && !lists.files.includes(chosen)) file.add(new Option(chosen, chosen));
  file.value = chosen;
  curve.replaceChildren(new Option(`choose one of ${lists.curves.length}`, ""), ...lists.curves.map((each, index) => new Option(each, index)));
  show("curve-of", lists.curves.length > 1);
}

function choose(fields) {
  choice.make();
  command("pose-curve", fields);
}

async function send(sent) {
  if (sent.size > LARGEST_BYTES) {
    tell(`${sent.name} is too large: a file of curves has at most ${LARGEST_BYTES / 2 ** 20} MiB.`);
    return;
  }
  const headers = { "Content-Type": "application/json", "X-Viewer": sessionStorage.getItem("viewer") };
  let answer;
  try {
    answer = await fetch(`/pose/curves?name=${encodeURIComponent(sent.name)}`, { method: "POST", headers, body: sent });
  } catch {
    tell(`${sent.name} was not sent: it cannot be read, or the console is not responding.`);
    return;
  }
  const { file: kept, text } = await answer.json().catch(() => ({ text: `${sent.name} was not accepted: try again.` }));
  if (kept) choose({ file: kept });
  else tell(text);
}

connection.addEventListener("refused", () => { choice.settle(); }); // the fields are set back
file.onchange = () => choose({ file: file.value });
file.onfocus = fetchLists; // files that were put into the folder meanwhile
curve.onchange = () => { if (curve.value) choose({ file: file.value, curve: Number(curve.value) }); };
threshold.oninput = () => { delete threshold.dataset.sent; };
threshold.onchange = () => {
  threshold.dataset.sent = "yes"; // what the console made of it is shown, even while the field has the focus
  if (number("min-dprime") === null) {
    tell("The threshold of d' must be a number."); // and is set back
    return;
  }
  choice.make();
  command("pose-threshold", { min_dprime: number("min-dprime") });
};
byId("curve-form").onsubmit = (event) => event.preventDefault();
byId("curve-send").onclick = () => picker.click();
picker.onchange = () => {
  const [sent] = picker.files;
  if (sent) send(sent);
  picker.value = ""; // the same file may be sent again
};
byId("pose-here").onclick = () => command("pose-reference");
byId("pose-clear").onclick = () => command("pose-clear");
