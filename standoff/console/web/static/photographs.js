// Photographs: sent in parts, imported as sessions, and compared in pairs.

import { NotYet, RETRY_MS, Refused, digestOf, pause, send } from "../sending/sending.js";
import { ResultProgress } from "./result_progress.js";
import { byId, command, connection, setText, show } from "./shell.js";

const $$ = (selector) => document.querySelectorAll(selector);
let isSending = 0;

// ---- Sent

function line(name) {
  const item = document.createElement("li");
  const words = document.createElement("span");
  item.append(`${name}: `, words);
  byId("sending").append(item);
  return (text, isBad = false) => { words.textContent = text; words.className = isBad ? "bad" : ""; };
}

async function sendOne(file, tell) {
  const bytes = await file.arrayBuffer();
  const facts = { name: file.name, location: byId("remove-location").checked ? "remove" : "keep" };
  const one = { sha256: await digestOf(bytes), bytes, facts };
  for (let attempt = 0; ; attempt += 1) {
    try {
      await send("/photographs/arrived", one, (share) => tell(`${Math.round(100 * share)} %`));
      tell("arrived");
      return;
    } catch (error) {
      if (error instanceof Refused) { tell(error.message, true); return; }
      const what = error instanceof NotYet ? "It cannot be sent yet" : "The link is lost";
      tell(`${what} (${error.message}); this page keeps trying.`, true);
      await pause(RETRY_MS[Math.min(attempt, RETRY_MS.length - 1)]);
    }
  }
}

async function sendAll(files) {
  isSending += 1;
  const told = files.map((file) => line(file.name));
  for (const [at, file] of files.entries()) await sendOne(file, told[at]).catch((error) => told[at](error.message, true));
  isSending -= 1;
}

show("insecure", !crypto.subtle);
byId("files").disabled = !crypto.subtle;
byId("files").onchange = () => { sendAll([...byId("files").files]); byId("files").value = ""; };
for (const name of ["dragover", "dragleave", "drop"]) {
  window.addEventListener(name, (event) => {
    if (!event.dataTransfer?.types.includes("Files")) return;
    event.preventDefault(); // a file dropped beside the frame does not replace the page
    byId("drop").classList.toggle("over", name === "dragover");
    if (name === "drop" && crypto.subtle) sendAll([...event.dataTransfer.files]);
  });
}

// ---- Imported

const chosen = () => $$("#import [name=photograph]:checked");

function offerImport() {
  const form = byId("import");
  if (!form) return;
  const now = new Date().toISOString();
  form.elements.session.value = `photographs ${now.slice(0, 10)} ${now.slice(11, 19).replaceAll(":", "")}`;
  form.onchange = enable;
  form.onsubmit = (event) => {
    event.preventDefault();
    const photographs = [...chosen()].map(({ value }) => value);
    const { kind, height, session } = form.elements;
    command("import", { session: session.value, photographs, kind: kind.value, height_mm: height.value ? height.valueAsNumber : 0 });
  };
  for (const button of $$("[data-discard]")) {
    button.onclick = () => { if (window.confirm("Throw this photograph away? The console has no other copy.")) command("discard", { sha256: button.dataset.discard }); };
  }
}

// ---- Compared

let pair = []; // the earlier one, then the later ones

function choose(button) {
  if (pair.includes(button)) pair = pair.filter((one) => one !== button);
  else if (pair.length <= Number(byId("find-changes").dataset.most)) pair = [...pair, button];
  showPair();
}

function showPair() {
  for (const button of $$(".picture-choice")) {
    const at = pair.indexOf(button);
    const role = at < 0 ? "" : at ? "after" : "before";
    button.setAttribute("aria-pressed", String(Boolean(role)));
    button.querySelector(".role").textContent = role;
  }
  const named = (button) => button.querySelector(".name").textContent;
  const words = ["Nothing is chosen.", "Choose the later one, or several.", "", ""][Math.min(pair.length, 3)];
  const later = pair.length === 2 ? () => named(pair[1]) : () => `${pair.length - 1} photographs`;
  setText("chosen", words || `${later()} against ${named(pair[0])}`);
  show("guide", pair.length === 1);
  enable();
}

function compute(result) {
  const [before, after] = pair.map(({ dataset }) => dataset);
  command("result", {
    session: after.session,
    result,
    is_replacing: byId("replace").checked,
    reference_session: before.session,
    reference: Number(before.index),
    followup: Number(after.index),
  });
}

function findChanges() {
  if (pair.length === 2) {
    compute("changes");
    return;
  }
  const [before, ...after] = pair.map(({ dataset }) => dataset);
  command("changes-of-several", {
    reference_session: before.session,
    reference: Number(before.index),
    sessions: after.map(({ session }) => session),
    followups: after.map(({ index }) => Number(index)),
    is_replacing: byId("replace").checked,
  });
}

async function guide() {
  const { session, index } = pair[0].dataset;
  byId("guide").disabled = true;
  try {
    const answer = await fetch(`/guide/to/${encodeURIComponent(session)}/${index}`, { method: "POST" });
    if (!answer.headers.get("Content-Type")?.includes("json")) throw new Error(`the console answers ${answer.status}`);
    const { address, text } = await answer.json();
    if (address) location.assign(address);
    else setText("chosen", text);
  } catch (error) {
    setText("chosen", `The reference cannot be chosen: ${error.message}`);
  } finally {
    if (byId("guide")) byId("guide").disabled = false;
  }
}

function offerPairs() {
  const same = (one) => [...$$(".picture-choice")].find(({ dataset }) => dataset.session === one.dataset.session && dataset.index === one.dataset.index);
  pair = pair.map(same).filter(Boolean);
  for (const button of $$(".picture-choice")) {
    button.onclick = () => choose(button);
    button.disabled = false;
  }
  if (!byId("swap")) return;
  byId("swap").onclick = () => { pair.reverse(); showPair(); };
  byId("find-changes").onclick = findChanges;
  byId("two-distance").onclick = () => compute("calibrate");
  if (byId("guide")) byId("guide").onclick = guide;
  showPair();
}

// ---- What the console says

const progress = new ResultProgress(({ kind }) => ["import", "changes", "calibrate"].includes(kind));
let last = {};
let isRefreshing = false;

function enable() {
  const { control, job } = last;
  const mayAct = Boolean(control?.is_mine) && !job;
  for (const button of $$("[data-controlled], [data-discard]")) button.disabled = !mayAct;
  if (byId("swap")) {
    byId("swap").disabled = pair.length !== 2;
    byId("find-changes").disabled = !mayAct || pair.length < 2;
    byId("two-distance").disabled = !mayAct || pair.length !== 2;
  }
  if (!byId("import")) return;
  const most = Number(byId("import").dataset.most);
  const isTooMany = chosen().length > most;
  byId("import").querySelector("[type=submit]").disabled = !mayAct || isTooMany || !chosen().length;
  setText("too-many", isTooMany ? `At most ${most} are imported at a time: leave some for the next session.` : "");
}

// What is chosen and filled in for the next import: what else arrives does not change it.
function filledIn() {
  const form = byId("import");
  if (!form) return () => {};
  const left = new Set([...form.querySelectorAll("[name=photograph]:not(:checked)")].map(({ value }) => value));
  const values = ["kind", "height", "session"].map((name) => [name, form.elements[name].value]);
  return () => {
    const made = byId("import");
    if (!made) return;
    for (const box of made.querySelectorAll("[name=photograph]")) box.checked = !left.has(box.value);
    for (const [name, value] of values) made.elements[name].value = value;
  };
}

// What has arrived or was imported meanwhile; what the page says of its own files stays.
async function refresh(isImported) {
  isRefreshing = true;
  try {
    const answer = await fetch("/photographs");
    if (!answer.ok) return;
    const page = new DOMParser().parseFromString(await answer.text(), "text/html");
    const fillIn = isImported ? () => {} : filledIn();
    for (const id of ["arrived", "compare"]) byId(id).replaceWith(page.getElementById(id));
    offerImport();
    fillIn();
    offerPairs();
  } finally {
    isRefreshing = false;
  }
}

offerImport();
offerPairs();
connection.addEventListener("state", ({ detail }) => {
  last = detail;
  const isEnded = progress.show(detail);
  enable();
  const isNew = detail.arrivals !== Number(byId("arrived").dataset.revision) && !detail.job;
  const isTyping = document.activeElement.matches("#import input:not([type=checkbox]), #import select");
  if (!isRefreshing && ((isNew && !isSending && !isTyping) || (isEnded && detail.result.kind === "import"))) refresh(isEnded && detail.result.state === "done");
});
