// The plan editor: fields to a draft, which the console checks while one types.

import { byId, command, connection, costOf, setText, show } from "./shell.js";

const CHECK_MS = 250;
// A key of a plan file, and the field that it is typed in.
const FIELDS = { heights_mm: "heights", frames_per_capture: "frames", orientations_deg: "orientations", exposure_us: "exposures", bracket: "bracket_exposures" };
const form = byId("plan-form");
const list = byId("targets");
let timer = null;

const ownFields = () => [...form.querySelectorAll("[name]")].filter((field) => !list.contains(field) && field.name !== "file");
const fieldsOf = (item) => [...item.querySelectorAll("[name]")].filter((field) => field.name !== "remove");

function value(field) {
  if (field.type === "checkbox") return field.checked;
  if (field.type !== "number") return field.value;
  if (field.validity.badInput) return null; // the console says what it must be
  return field.value === "" ? 0 : field.valueAsNumber;
}

function fill(fields, values) {
  for (const field of fields) {
    if (field.type === "checkbox") field.checked = values[field.name];
    // A number that may be left out has a placeholder, which says what holds then.
    else field.value = field.placeholder ? values[field.name] || "" : values[field.name] ?? "";
  }
}

const collected = (fields) => Object.fromEntries(fields.map((field) => [field.name, value(field)]));
const draft = () => ({ ...collected(ownFields()), targets: [...list.children].map((item) => collected(fieldsOf(item))) });

function add(values) {
  const item = byId("target").content.firstElementChild.cloneNode(true);
  fill(fieldsOf(item), values);
  item.querySelector("[name=remove]").onclick = () => { item.remove(); check(); };
  list.append(item);
  return item;
}

function check() {
  clearTimeout(timer);
  timer = setTimeout(() => connection.send("plan-check", { draft: draft() }), CHECK_MS);
}

// The field of a key such as "heights_mm" or "targets.0.heights_mm".
function fieldAt(key) {
  const [first, number, field, part] = key.split(".");
  const name = part && field === "bracket" ? `bracket_${part}` : field;
  const own = first !== "targets";
  const fields = own ? ownFields() : fieldsOf(list.children[Number(number)] ?? list);
  const wanted = own ? first : name;
  return fields.find((field) => field.name === (FIELDS[wanted] ?? wanted));
}

function save(isReplacing) {
  command("plan-save", { name: form.elements.file.value.trim(), draft: draft(), is_replacing: isReplacing });
}

function tellFault(text, keys) {
  for (const field of form.querySelectorAll("[aria-invalid]")) field.removeAttribute("aria-invalid");
  for (const key of keys) fieldAt(key)?.setAttribute("aria-invalid", "true");
  show("draft-fault", Boolean(text));
  setText("draft-fault", text);
}

connection.addEventListener("draft", ({ detail }) => {
  tellFault(detail.text, detail.keys);
  setText("draft-cost", detail.is_ok ? costOf(detail) : "");
});
// What is no draft at all, such as half a frame.
connection.addEventListener("refused", ({ detail }) => {
  if (!detail.key.startsWith("draft.")) return;
  tellFault(detail.text, [detail.key.slice("draft.".length)]);
  setText("draft-cost", "");
});
connection.addEventListener("plan-exists", ({ detail }) => { if (window.confirm(`There is a plan ${detail.name} already. Replace it?`)) save(true); });
connection.addEventListener("plan-saved", ({ detail }) => {
  show("plan-saved", true);
  byId("plan-saved").querySelector("span").textContent = `Saved as ${detail.path}.`;
});
connection.addEventListener("state", ({ detail: { control } }) => { byId("save-plan").disabled = !control.is_mine; });
connection.addEventListener("open", check);

form.oninput = () => { show("plan-saved", false); check(); };
form.onsubmit = (event) => { event.preventDefault(); save(false); };
byId("add-target").onclick = () => {
  const last = draft().targets.at(-1) ?? { kind: "edge", bracket_exposures: 0, bracket_ratio: 8 };
  add({ ...last, target: "" }).querySelector("[name=target]").focus();
  check();
};
const given = JSON.parse(byId("plan-editor").dataset.draft);
fill(ownFields(), given);
given.targets.forEach(add);
byId("draft").disabled = false; // what was typed before would have been filled over
check();
