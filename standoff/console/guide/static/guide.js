// The page: the reference, the camera with its guidance, and the photographs with their changes.

import { Camera } from "./camera.js";
import { drawSeries } from "./series.js";
import { forget, keep, refusedOnes, sendAgain, sendWaiting } from "./uploads.js";

const OF = `of=${encodeURIComponent(document.body.dataset.of)}`;
const $ = (id) => document.getElementById(id);
const SIGNS = {
  nearer: "⊕", further: "⊖", left: "←", right: "→", up: "↑", down: "↓",
  "turn clockwise": "↻", "turn anticlockwise": "↺",
  "tilt left": "⇠", "tilt right": "⇢", "tilt up": "⇡", "tilt down": "⇣",
};
const WORDS = { go: "Good: take the photograph", unsure: "Nearly", "no go": "Not yet" };
const KIND = { go: "go", unsure: "unsure", "no go": "no" };
const SPEAK_MS = 2500;
const POLL_MS = 1500;
const LIST_MS = 30000;
const GONE_MS = 2000;

function fault(text) {
  $("fault").textContent = text ?? "";
  $("fault").hidden = !text;
}

// ---- The camera

const picture = new Image();
picture.src = `reference.jpg?${OF}`;
let camera = null;
let spokenMs = 0;
let spoken = "";
let wasGood = false;
let isUnknown = true;

function say(found) {
  const good = found.verdict === "go";
  if ($("vibration").checked && good && !wasGood) navigator.vibrate?.([80, 60, 80]);
  const text = good ? "Good. Take the photograph." : found.spoken;
  const now = performance.now();
  if ($("voice").checked && (good !== wasGood || (now - spokenMs > SPEAK_MS && (text !== spoken || now - spokenMs > 3 * SPEAK_MS)))) {
    speechSynthesis.cancel();
    speechSynthesis.speak(new SpeechSynthesisUtterance(text.replace("°", " degrees")));
    [spoken, spokenMs] = [text, now];
  }
  wasGood = good;
}

function show({ found, fault: text, lost }) {
  if (text !== undefined) fault(text);
  if (lost) fault("The link to the computer is lost; this page keeps trying.");
  if (!found) {
    unknown("Waiting for the computer.");
    return;
  }
  // A green that could not last would flicker.
  if (found.verdict === "go" && (wasGood ? camera.isLate : !camera.isFresh)) {
    unknown("It was good a moment ago, but the computer answers late: hold still.");
    return;
  }
  fault("");
  isUnknown = false;
  $("verdict").className = `verdict ${KIND[found.verdict]}`;
  $("verdict-word").textContent = WORDS[found.verdict];
  $("verdict-words").textContent = found.words;
  $("remedy").textContent = found.arrows.length ? found.faults.join("; ") : found.remedy;
  if (found.judged_by) $("judged-by").textContent = found.judged_by;
  const wanted = found.verdict === "go" ? [] : found.arrows;
  $("arrows").replaceChildren(...wanted.map(({ name, words }) => {
    const item = document.createElement("li");
    const sign = document.createElement("span");
    [sign.className, sign.textContent] = ["sign", SIGNS[name]];
    sign.setAttribute("aria-hidden", "true");
    item.append(sign, words.replace(" %", "\u00a0%"));
    return item;
  }));
  say(found);
}

// Nothing is known of where the camera stands now: nothing that was said of it stays.
function unknown(words) {
  if (isUnknown && $("verdict-words").textContent === words) return;
  isUnknown = true;
  wasGood = false;
  $("verdict").className = "verdict no";
  $("verdict-word").textContent = "…";
  $("verdict-words").textContent = words;
  $("remedy").textContent = "";
  $("arrows").replaceChildren();
}

function draw() {
  if (!camera) return;
  // An arrow of a second ago still points the right way; green is for now alone.
  if ((wasGood && camera.isLate) || camera.ageMs > GONE_MS) unknown("Waiting for the computer.");
  const [canvas, video] = [$("overlay"), $("video")];
  const { clientWidth, clientHeight } = canvas;
  const scale = window.devicePixelRatio || 1;
  canvas.width = clientWidth * scale;
  canvas.height = clientHeight * scale;
  const drawing = canvas.getContext("2d");
  drawing.setTransform(scale, 0, 0, scale, 0, 0);
  // The picture within the element, which it need not fill.
  const fit = Math.min(clientWidth / (video.videoWidth || 1), clientHeight / (video.videoHeight || 1));
  const [width, height] = [fit * video.videoWidth, fit * video.videoHeight];
  drawing.translate((clientWidth - width) / 2, (clientHeight - height) / 2);
  frameOf(drawing, width, height);
  const found = camera.guidance;
  if ($("ghost").checked && picture.complete) {
    drawing.globalAlpha = 0.35;
    const [x, y, w, h] = target(width, height);
    drawing.drawImage(picture, x, y, w, h);
    drawing.globalAlpha = 1;
  }
  if (found?.outline.length) {
    drawing.beginPath();
    for (const [x, y] of found.outline) drawing.lineTo(x * width, y * height);
    drawing.closePath();
    drawing.lineWidth = 4;
    drawing.strokeStyle = camera.isLate ? "#9aa4ae" : found.verdict === "go" ? "#3ddc84" : found.verdict === "unsure" ? "#ffc94d" : "#ff6b6b";
    drawing.stroke();
  }
  camera.drawn = (camera.drawn ?? 0) + 1;
  requestAnimationFrame(draw);
}

// Where the reference lies in the picture once the camera is back: middle on middle, same field.
function target(width, height) {
  const [w, h] = [Number(document.body.dataset.width), Number(document.body.dataset.height)];
  const factor = Math.max(width, height) / Math.max(w, h);
  return [(width - factor * w) / 2, (height - factor * h) / 2, factor * w, factor * h];
}

function frameOf(drawing, width, height) {
  const [x, y, w, h] = target(width, height);
  drawing.lineWidth = 2;
  drawing.setLineDash([8, 6]);
  drawing.strokeStyle = "#ffffffcc";
  drawing.strokeRect(x + 2, y + 2, w - 4, h - 4);
  drawing.setLineDash([]);
}

async function openCamera() {
  fault("");
  if (!navigator.mediaDevices?.getUserMedia) {
    fault("This browser gives pages no camera. Take a photograph with the button below instead.");
    return;
  }
  const opening = new Camera($("video"), show, `frames?${OF}`);
  camera = opening;
  window.guide = camera;
  isUnknown = false;
  unknown("Looking for the scene.");
  $("live").hidden = false;
  $("start").hidden = true;
  try {
    await opening.open();
  } catch (error) {
    if (opening.isClosed) return;
    closeCamera();
    fault(`The camera cannot be used: ${error.message}. Allow it for this page in the browser's settings, or take a photograph with the button below.`);
    return;
  }
  if (!opening.isClosed) draw();
}

function closeCamera() {
  camera?.close();
  camera = null;
  $("live").hidden = true;
  $("start").hidden = false;
}

// ---- Photographs

function sent({ share, words, refused, done }) {
  $("sending").hidden = Boolean(done);
  if (share !== undefined) $("sending-share").value = share;
  if (words) $("sending-words").textContent = words;
  if (refused) listRefused();
  if (done) list();
}

function sendAll() {
  sendWaiting(sent).catch((error) => fault(`The photographs in this phone cannot be sent: ${error.message}`));
}

function action(text, work) {
  const made = element("button", text);
  made.type = "button";
  made.addEventListener("click", async () => {
    await work();
    await listRefused();
  });
  return made;
}

async function listRefused() {
  const all = await refusedOnes();
  $("refused").hidden = !all.length;
  for (const link of $("refused-list").querySelectorAll("a")) URL.revokeObjectURL(link.href);
  $("refused-list").replaceChildren(...all.map((one) => {
    const item = element("li", one.refused);
    const save = element("a", "Save it in the phone", "button");
    save.href = URL.createObjectURL(new Blob([one.bytes], { type: "image/jpeg" }));
    save.download = `${one.sha256.slice(0, 8)}.jpg`;
    const buttons = element("div", "", "buttons");
    buttons.append(
      save,
      action("Send it again", () => sendAgain(one).then(sendAll)),
      action("Throw it away", () => forget(one.sha256)),
    );
    item.append(buttons);
    return item;
  }));
}

async function send(blob) {
  $("sending").hidden = false;
  const location = $("remove-location").checked ? "remove" : "keep";
  await keep(blob, { location, of: document.body.dataset.of });
  sendAll(); // not waited for: the next one can be taken
}

async function shoot() {
  $("shutter").disabled = true;
  try {
    await send(await camera.still());
  } catch (error) {
    fault(`No photograph was taken: ${error.message}`);
  } finally {
    $("shutter").disabled = false;
  }
}

const cards = new Map();

function element(tag, text, className) {
  const made = document.createElement(tag);
  made.textContent = text;
  if (className) made.className = className;
  return made;
}

function cardOf(name) {
  if (cards.has(name)) return cards.get(name);
  const card = $("still").content.firstElementChild.cloneNode(true);
  const pair = card.querySelector(".pair");
  const hold = card.querySelector(".hold");
  const past = (is) => {
    pair.classList.toggle("past", is);
    pair.querySelector(".which").textContent = is ? "before" : "after";
    hold.setAttribute("aria-pressed", String(is));
  };
  for (const touched of [pair, hold]) {
    touched.addEventListener("pointerdown", (event) => { past(true); event.preventDefault(); });
    for (const end of ["pointerup", "pointercancel", "pointerleave"]) touched.addEventListener(end, () => past(false));
    touched.addEventListener("contextmenu", (event) => event.preventDefault());
  }
  hold.addEventListener("keydown", (event) => { if (event.key === " " || event.key === "Enter") past(true); });
  hold.addEventListener("keyup", () => past(false));
  const ringed = card.querySelector(".ringed");
  ringed.addEventListener("click", () => ringed.setAttribute("aria-pressed", String(!pair.classList.toggle("plain"))));
  card.querySelector(".again").addEventListener("click", () => {
    window.scrollTo({ top: 0 });
    if (!camera) openCamera();
  });
  cards.set(name, card);
  return card;
}

function fill(card, still) {
  if (still.state === "done") blinkOf(card, still.name);
  if (card.dataset.state === `${still.state} ${still.words}`) return;
  card.dataset.state = `${still.state} ${still.words}`;
  const [, date, time] = /^(\d{8})-(\d{6})/.exec(still.name) ?? [];
  const shown = date ? `${date.slice(0, 4)}-${date.slice(4, 6)}-${date.slice(6)}, ${time.slice(0, 2)}:${time.slice(2, 4)} UTC` : still.name;
  card.querySelector("h3").textContent = shown;
  const tag = card.querySelector(".tag");
  tag.textContent = still.pose?.verdict ?? "";
  tag.className = `tag ${KIND[still.pose?.verdict] ?? ""}`;
  card.querySelector(".pose").textContent = still.pose?.words ?? "";
  card.querySelector(".words").textContent = still.words;
  card.querySelector(".better").replaceChildren(...still.better.map((text) => element("li", text)));
}

// The changes of a still, which are asked for once.
async function blinkOf(card, name) {
  const blink = card.querySelector(".blink");
  if (!blink.hidden || card.isAsked) return;
  card.isAsked = true;
  const still = await answered(`stills/${name}?${OF}`);
  card.isAsked = false;
  if (!still) return; // asked for again with the next list
  blink.hidden = false;
  const after = blink.querySelector(".after");
  after.addEventListener("load", () => ring(blink.querySelector(".marks"), still.changes, after.naturalWidth / after.naturalHeight), { once: true });
  after.src = `stills/${name}/after.jpg?${OF}`;
  blink.querySelector(".before").src = `stills/${name}/before.jpg?${OF}`;
  listChanges(blink, still.changes);
}

const FIRST = 5;

function listChanges(blink, changes) {
  const [first, rest] = blink.querySelectorAll(".changes");
  const items = changes.map((change) => element("li", said(change)));
  first.append(...items.slice(0, FIRST));
  rest.append(...items.slice(FIRST));
  rest.start = FIRST + 1;
  const more = blink.querySelector(".more");
  more.hidden = changes.length <= FIRST;
  more.querySelector("summary").textContent = `${changes.length - FIRST} more`;
  blink.querySelector(".numbers").append(...changes.slice(0, 30).map(({ x, y, radius }, at) => {
    const number = element("span", String(at + 1));
    // Above its ring, or below it near the upper border.
    const rise = y > 0.12 ? -1 : 1;
    Object.assign(number.style, { left: `${100 * x}%`, top: `calc(${100 * y}% + ${rise} * (${100 * radius}cqw + .6rem))` });
    return number;
  }));
}

function said({ what, side, amplitude_dn: amplitude, delta_e: deltaE, area_px: area, x, y }) {
  const where = `${Math.round(100 * x)} % from the left, ${Math.round(100 * y)} % from the top`;
  const named = what && what !== side ? `${what}, ${side}` : side;
  const amount = what === "colour" && deltaE ? `another colour, ΔE ${deltaE.toPrecision(2)}` : `${named} by ${Math.abs(amplitude).toPrecision(2)} DN`;
  return `${amount}, ${Math.max(1, Math.round(area))} px, ${where}`;
}

function ring(marks, changes, aspect) {
  marks.replaceChildren(...changes.map((change) => {
    const made = document.createElementNS("http://www.w3.org/2000/svg", "ellipse");
    const facts = { cx: change.x, cy: change.y, rx: change.radius, ry: change.radius * aspect, class: change.side };
    for (const [name, value] of Object.entries(facts)) made.setAttribute(name, value);
    return made;
  }));
}

// What a path answers; null where it does not.
async function answered(path) {
  try {
    const answer = await fetch(path, { signal: AbortSignal.timeout(LIST_MS) });
    return answer.ok ? await answer.json() : null;
  } catch {
    return null;
  }
}

let isListing = false;

async function list() {
  if (isListing || document.hidden) return;
  isListing = true;
  const stills = await answered(`stills?${OF}`);
  isListing = false;
  if (!stills) return;
  $("no-stills").hidden = stills.length > 0;
  $("series").hidden = !drawSeries($("series-plot"), stills);
  for (const still of stills) fill(cardOf(still.name), still);
  const wanted = stills.map((still) => cards.get(still.name));
  if (wanted.some((card, at) => $("stills").children[at] !== card)) $("stills").replaceChildren(...wanted);
}

function told() {
  if (!camera) return;
  const late = camera.ages.length ? Math.round(camera.ages.at(-1)) : 0;
  $("rates").textContent = `${camera.posesPerS.toFixed(1)} poses a second, ${late} ms old when they arrive, ${camera.longest} px`;
}

$("use-camera").addEventListener("click", openCamera);
for (const id of ["use-camera", "photograph"]) $(id).disabled = false;
$("end-camera").addEventListener("click", closeCamera);
$("shutter").addEventListener("click", shoot);
$("photograph").addEventListener("change", async ({ target: input }) => {
  const [file] = input.files;
  if (file) await send(file).catch((error) => fault(`The photograph cannot be sent: ${error.message}`));
  input.value = "";
});
setInterval(list, POLL_MS);
setInterval(told, 1000);
document.addEventListener("visibilitychange", () => { if (!document.hidden) sendAll(); });
window.addEventListener("online", sendAll);
list();
listRefused();
sendAll();
