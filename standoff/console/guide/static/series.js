// The photographs of a reference over time: how many changes each one shows, by when it arrived.

const WIDTH = 400;
const HEIGHT = 200;
const [LEFT, RIGHT, TOP, BOTTOM] = [34, 14, 14, 44];
const KIND = { go: "go", unsure: "unsure", "no go": "no" };

// When a still arrived, from the name of its session, in ms; NaN where it does not tell.
export function arrivedMs(name) {
  const [, year, month, day, hour, minute, second] = /^(\d{4})(\d\d)(\d\d)-(\d\d)(\d\d)(\d\d)/.exec(name) ?? [];
  return Date.UTC(year, month - 1, day, hour, minute, second);
}

function drawn(tag, facts, text = "") {
  const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(facts)) made.setAttribute(name, value);
  made.textContent = text;
  return made;
}

const shortDate = (ms, isLong) => new Date(ms).toISOString().slice(...(isLong ? [0, 10] : [5, 16])).replace("T", " ");

// At most four steps of 1, 2 or 5 times a power of ten, whole numbers.
function stepOf(most) {
  const power = 10 ** Math.floor(Math.log10(Math.max(most / 4, 1)));
  return [1, 2, 5, 10].map((factor) => factor * power).find((step) => 4 * step >= most);
}

// Draw the stills that were compared into an SVG element; false where fewer than two were.
export function drawSeries(svg, stills) {
  const points = stills
    .filter(({ state, name }) => state === "done" && Number.isFinite(arrivedMs(name)))
    .map(({ name, count, pose }) => ({ ms: arrivedMs(name), count, kind: KIND[pose?.verdict] ?? "" }))
    .sort((one, other) => one.ms - other.ms);
  if (points.length < 2) return false;
  const [first, last] = [points[0].ms, points.at(-1).ms];
  const step = stepOf(Math.max(...points.map(({ count }) => count), 1));
  const top = step * Math.ceil(Math.max(...points.map(({ count }) => count), 1) / step);
  const x = (ms) => LEFT + (WIDTH - LEFT - RIGHT) * (last > first ? (ms - first) / (last - first) : 0.5);
  const y = (count) => HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * (count / top);
  const parts = [];
  for (let count = 0; count <= top; count += step) {
    parts.push(drawn("line", { x1: LEFT, x2: WIDTH - RIGHT, y1: y(count), y2: y(count), class: "grid" }));
    parts.push(drawn("text", { x: LEFT - 8, y: y(count) + 5, "text-anchor": "end" }, String(count)));
  }
  const isLong = last - first > 3 * 24 * 3600e3;
  parts.push(drawn("text", { x: LEFT, y: HEIGHT - BOTTOM + 22 }, shortDate(first, isLong)));
  parts.push(drawn("text", { x: WIDTH - RIGHT, y: HEIGHT - BOTTOM + 22, "text-anchor": "end" }, shortDate(last, isLong)));
  parts.push(drawn("text", { x: (LEFT + WIDTH - RIGHT) / 2, y: HEIGHT - 4, "text-anchor": "middle" }, "arrived, UTC"));
  parts.push(drawn("polyline", { points: points.map(({ ms, count }) => `${x(ms)},${y(count)}`).join(" ") }));
  for (const { ms, count, kind } of points) parts.push(drawn("circle", { cx: x(ms), cy: y(count), r: 6, class: kind }));
  svg.setAttribute("viewBox", `0 0 ${WIDTH} ${HEIGHT}`);
  svg.setAttribute("aria-label", `Changes found in ${points.length} photographs, in order of time: ${points.map(({ count }) => count).join(", ")}`);
  svg.replaceChildren(...parts);
  return true;
}
