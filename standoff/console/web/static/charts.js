// Small charts with axes: histogram, line profile, and focus over the last half minute.

const TEXT_PX = 11;
const TRACE_S = 30;
const [LEFT, RIGHT, TOP, BOTTOM] = [50, 8, 16, 17]; // of the axes, in CSS pixels
const LEAST_COUNT = 0.5; // below a single pixel, where the logarithm begins

// The canvas in pixels of the screen, cleared.
export function begin(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const width = Math.round(canvas.clientWidth * ratio);
  const height = Math.round(canvas.clientHeight * ratio);
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const context = canvas.getContext("2d");
  context.clearRect(0, 0, width, height);
  return { context, width, height, ratio, style: getComputedStyle(document.documentElement) };
}

// Round numbers from low to high, about as many as asked for.
function ticks(low, high, wanted) {
  const rough = (high - low) / Math.max(wanted, 1);
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((factor) => factor * power >= rough * 0.999);
  const first = Math.ceil(low / step - 1e-6);
  const count = Math.floor(high / step + 1e-6) - first + 1;
  return Array.from({ length: Math.max(count, 0) }, (_, index) => Number(((first + index) * step).toPrecision(9)));
}

function short(value) {
  const size = Math.abs(value);
  if (size >= 1e6) return `${Number((value / 1e6).toPrecision(3))}M`;
  if (size >= 1e4) return `${Number((value / 1e3).toPrecision(3))}k`;
  return size !== 0 && size < 1e-3 ? value.toExponential(1).replace("-", "−") : String(value).replace("-", "−");
}

// Axes from `x` = [low, high] and `y`; returns where a value lies. `isLog` concerns y alone.
function axes(canvas, { x, y, names, isLog = false }) {
  const begun = begin(canvas);
  const { context, width, height, ratio, style } = begun;
  const [left, top] = [LEFT * ratio, TOP * ratio];
  const [across, tall] = [width - left - RIGHT * ratio, height - top - BOTTOM * ratio];
  const scaled = isLog ? Math.log10 : Number;
  const [low, high] = y.map(scaled);
  const right = (value) => left + (value - x[0]) / (x[1] - x[0]) * across;
  const down = (value) => top + (1 - (scaled(value) - low) / (high - low)) * tall;
  const line = style.getPropertyValue("--line");
  context.font = `${TEXT_PX * ratio}px system-ui, sans-serif`;
  context.fillStyle = style.getPropertyValue("--muted");
  context.textAlign = "left";
  context.textBaseline = "top";
  context.fillText(names[1], 0, 0);
  context.textAlign = "right";
  context.fillText(names[0], width, height - (TEXT_PX + 1) * ratio);
  const nameWidth = context.measureText(names[0]).width + 10 * ratio;
  context.textAlign = "center";
  for (const value of ticks(...x, across / (70 * ratio))) {
    const [at, text] = [right(value), short(value)];
    const half = context.measureText(text).width / 2;
    if (at + half < width - nameWidth) context.fillText(text, Math.max(at, half), height - (TEXT_PX + 1) * ratio);
    context.fillRect(at, top + tall, ratio, 4 * ratio);
  }
  context.textAlign = "right";
  context.textBaseline = "middle";
  const powers = isLog && ticks(Math.ceil(low), Math.floor(high), Math.min(high - low, tall / (20 * ratio)));
  for (const value of isLog ? powers.filter(Number.isInteger).map((power) => 10 ** power) : ticks(...y, tall / (26 * ratio))) {
    context.fillText(short(value), left - 4 * ratio, down(value));
    context.fillStyle = line;
    context.fillRect(left, Math.round(down(value)), across, 1);
    context.fillStyle = style.getPropertyValue("--muted");
  }
  context.fillRect(left, top, ratio, tall);
  context.fillRect(left, top + tall, across, ratio);
  return { ...begun, right, down, bottom: top + tall };
}

function curve({ context, ratio, style, right, down }, points, colour) {
  context.beginPath();
  for (const [x, y] of points) context.lineTo(right(x), down(y));
  context.strokeStyle = style.getPropertyValue(colour);
  context.lineWidth = 1.5 * ratio;
  context.lineJoin = "round";
  context.stroke();
}

export function drawHistogram(canvas, counts, largestDn, { isSaturated, isLog }) {
  const most = Math.max(1, ...counts);
  const y = isLog ? [LEAST_COUNT, 1.5 * most] : [0, 1.05 * most];
  const chart = axes(canvas, { x: [0, largestDn], y, names: ["level / DN", "pixels"], isLog });
  const { context, style, right, down, bottom } = chart;
  const step = right(largestDn / counts.length) - right(0);
  context.fillStyle = style.getPropertyValue("--trace");
  counts.forEach((count, bin) => {
    if (!count) return;
    if (bin === counts.length - 1 && isSaturated) context.fillStyle = style.getPropertyValue("--fail");
    const top = Math.min(down(count), bottom - 1);
    context.fillRect(right(0) + bin * step, top, Math.max(step - 0.5, 1), bottom - top);
  });
}

export function drawProfile(canvas, levels, lengthPx) {
  const [low, high] = levels.length ? [Math.min(...levels), Math.max(...levels)] : [0, 1];
  const room = Math.max(0.06 * (high - low), 4);
  const y = [Math.max(low - room, Math.min(low, 0)), high + room];
  const chart = axes(canvas, { x: [0, Math.max(lengthPx, 1)], y, names: ["distance / px", "level / DN"] });
  curve(chart, levels.map((level, index) => [index / (levels.length - 1) * lengthPx, level]), "--trace");
}

// Values at times in seconds before the newest, which are negative; the line is the peak.
export function drawTrace(canvas, values, timesS, peak, isPast) {
  if (!values.length) { begin(canvas); return; } // no axes of nothing
  const highest = Math.max(peak, ...values) || 1;
  const lowest = Math.min(...values, highest);
  const span = Math.max(highest - lowest, 0.02 * highest);
  const lengthS = Math.max(TRACE_S, -(timesS[0] ?? 0));
  const chart = axes(canvas, { x: [-lengthS, 0], y: [highest - 1.05 * span, highest + 0.05 * span], names: ["s", "value"] });
  const { context, style, right, down } = chart;
  context.fillStyle = style.getPropertyValue("--muted");
  context.fillRect(right(-lengthS), down(peak), right(0) - right(-lengthS), 1);
  if (values.length > 1) curve(chart, values.map((value, index) => [timesS[index], value]), isPast ? "--past" : "--trace");
}

// Levels from 0 (dark) to 1 over the distance from an edge.
export function drawEdge(canvas, distances, levels) {
  if (!distances.length) return;
  const reach = Math.max(...distances.map(Math.abs), 1);
  const chart = axes(canvas, { x: [-reach, reach], y: [-0.1, 1.1], names: ["distance / px", "level across the edge"] });
  curve(chart, distances.map((distance, index) => [distance, levels[index]]), "--trace");
}

// Focus values with their errors over the height, the fitted curve and its peak.
export function drawSweep(canvas, points, fitted, peakMm) {
  const heights = points.map(([height]) => height);
  const values = points.map(([, value]) => value);
  const [low, high] = [Math.min(...heights), Math.max(...heights)];
  const room = 0.04 * (high - low) || 1;
  const most = Math.max(...values, ...fitted.map(([, value]) => value), 1e-12);
  const least = Math.min(...values);
  const [bottomValue, topValue] = [least - 0.08 * (most - least || most), most + 0.08 * (most - least || most)];
  const chart = axes(canvas, { x: [low - room, high + room], y: [bottomValue, topValue], names: ["height / mm", "focus value"] });
  const { context, ratio, style, right, down, bottom } = chart;
  if (fitted.length) curve(chart, fitted, "--muted");
  context.fillStyle = style.getPropertyValue("--trace");
  for (const [height, value, err] of points) {
    context.fillRect(right(height) - ratio / 2, down(value + err), ratio, Math.max(down(value - err) - down(value + err), ratio));
    context.beginPath();
    context.arc(right(height), down(value), 2.5 * ratio, 0, 2 * Math.PI);
    context.fill();
  }
  if (peakMm === null) return;
  context.fillStyle = style.getPropertyValue("--ok");
  context.fillRect(right(peakMm), down(topValue), ratio, bottom - down(topValue));
}
