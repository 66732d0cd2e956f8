// The two small charts: histogram, and focus over the last half minute.

const TRACE_VALUES = 300;

function begin(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const width = Math.round(canvas.clientWidth * ratio);
  const height = Math.round(canvas.clientHeight * ratio);
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const context = canvas.getContext("2d");
  context.clearRect(0, 0, width, height);
  return { context, width, height, ratio, style: getComputedStyle(document.documentElement) };
}

// Square roots of the counts, so that a few bright pixels show beside many dark ones.
export function drawHistogram(canvas, counts, isSaturated) {
  const { context, width, height, style } = begin(canvas);
  const highest = Math.sqrt(Math.max(1, ...counts));
  const step = width / counts.length;
  context.fillStyle = style.getPropertyValue("--trace");
  counts.forEach((count, bin) => {
    const size = Math.sqrt(count) / highest * (height - 4);
    if (bin === counts.length - 1 && isSaturated) context.fillStyle = style.getPropertyValue("--fail");
    context.fillRect(bin * step, height - size, Math.max(step - 0.5, 0.5), size);
  });
  context.fillStyle = style.getPropertyValue("--line");
  context.fillRect(0, height - 1, width, 1);
}

export function drawTrace(canvas, values, peak, isPast) {
  const { context, width, height, ratio, style } = begin(canvas);
  context.fillStyle = style.getPropertyValue("--line");
  const highest = Math.max(peak, ...values, 1e-12);
  const lowest = Math.min(...values, highest);
  const span = Math.max(highest - lowest, 0.02 * highest);
  const down = (value) => 3 * ratio + (highest - value) / span * (height - 6 * ratio);
  context.fillRect(0, down(peak), width, ratio);
  if (values.length < 2) return;
  const right = (index) => width * (1 - (values.length - 1 - index) / (TRACE_VALUES - 1));
  context.beginPath();
  values.forEach((value, index) => context.lineTo(right(index), down(value)));
  context.strokeStyle = style.getPropertyValue(isPast ? "--past" : "--trace");
  context.lineWidth = 2 * ratio;
  context.lineJoin = "round";
  context.stroke();
}
