// Score over time on a canvas by uPlot; shading, ticks and colours are ours.
"use strict";

const colour = name => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

const TICKS = [-5, -2, -1, -0.5, 0, 0.5, 1, 2, 5];
for (let decade = 10; decade <= 1e15; decade *= 10) {
  TICKS.push(decade);
  TICKS.unshift(-decade);
}

function scoreTicks(u, axis, low, high) {
  let ticks = TICKS.filter(s => toAxis(s) >= low && toAxis(s) <= high);
  if (high > 3) ticks = ticks.filter(s => ![2, 5, 0.5, -0.5, -2, -5].includes(s));
  const every = Math.ceil(ticks.length / 9);
  return ticks.filter((s, i) => every === 1 || s === 1 || i % every === 0).map(toAxis);
}

function tickText(y) {
  const s = fromAxis(y);
  const exponent = Math.round(Math.log10(Math.abs(s)));
  return Math.abs(s) > 9999 ? `${s < 0 ? "-" : ""}1e${exponent}` : `${Math.round(s * 10) / 10}`;
}

function band(u, from, to, fill) {
  const left = Math.max(u.valToPos(from, "x", true), u.bbox.left);
  const right = Math.min(u.valToPos(to, "x", true), u.bbox.left + u.bbox.width);
  if (right < left) return;
  u.ctx.fillStyle = fill;
  u.ctx.fillRect(left, u.bbox.top, Math.max(right - left, 1), u.bbox.height);
}

// Stretches in which the detector could not tell, from the first such row to the next usable one.
function unavailable(time, y) {
  const stretches = [];
  for (let i = 0; i < y.length; i++) {
    if (y[i] !== null) continue;
    const start = time[i];
    while (i + 1 < y.length && y[i + 1] === null) i++;
    stretches.push([start, time[Math.min(i + 1, y.length - 1)]]);
  }
  return stretches;
}

function hatching(u, fill) {
  const tile = document.createElement("canvas");
  const size = tile.width = tile.height = Math.round(8 * devicePixelRatio);
  const pen = tile.getContext("2d");
  pen.strokeStyle = fill;
  pen.lineWidth = devicePixelRatio;
  pen.beginPath();
  for (const shift of [-size, 0, size]) { pen.moveTo(shift, size); pen.lineTo(shift + size, 0); }
  pen.stroke();
  return u.ctx.createPattern(tile, "repeat");
}

function shade(u, run, variant, absent) {
  u.ctx.save();
  for (const [from, to] of absent) band(u, from, to, colour("absent"));
  const hatch = hatching(u, colour("guard"));
  for (const [, end] of variant.intervals) band(u, end, end + run.guard_s, hatch);
  for (const [from, to] of variant.intervals) band(u, from, to, colour("attack"));
  u.ctx.restore();
}

function threshold(u) {
  const y = Math.round(u.valToPos(1, "y", true));
  u.ctx.save();
  u.ctx.strokeStyle = colour("ink");
  u.ctx.lineWidth = devicePixelRatio;
  u.ctx.setLineDash([5 * devicePixelRatio, 4 * devicePixelRatio]);
  u.ctx.beginPath();
  u.ctx.moveTo(u.bbox.left, y);
  u.ctx.lineTo(u.bbox.left + u.bbox.width, y);
  u.ctx.stroke();
  u.ctx.restore();
}

function axis(more) {
  return { stroke: () => colour("soft"), grid: { stroke: () => colour("rule"), width: 1 }, ticks: { show: false }, font: "12px system-ui, sans-serif", ...more };
}

// Returns the plot; `look(time)` is called with the time under the cursor, or null.
function drawTimeline(box, run, variant, look) {
  const { time, y, alert } = trace(run);
  const absent = unavailable(time, y);
  const lone = y.map((v, i) => v !== null && (y[i - 1] ?? null) === null && (y[i + 1] ?? null) === null ? i : -1).filter(i => i >= 0);
  const alerts = y.map((v, i) => alert[i] ? v : null);
  const known = y.filter(v => v !== null);
  const low = known.reduce((a, b) => Math.min(a, b), 0), high = known.reduce((a, b) => Math.max(a, b), 1.4);
  const options = {
    width: box.clientWidth, height: 300, legend: { show: false },
    padding: [12, 22, 0, 0],
    scales: { x: { time: false }, y: { range: [low - 0.06 * (high - low), high + 0.06 * (high - low)] } },
    axes: [
      axis({ label: `seconds from the start, ${variant.start} UTC`, labelSize: 18, labelGap: 0, size: 34, labelFont: "12px system-ui, sans-serif", space: 64 }),
      axis({ label: "score / threshold", labelSize: 22, labelFont: "12px system-ui, sans-serif", size: 46, splits: scoreTicks, values: (u, ticks) => ticks.map(tickText) }),
    ],
    series: [
      {},
      { stroke: () => colour("score"), width: 1.25, points: { size: 3, fill: () => colour("score"), filter: () => lone } },
      { paths: () => null, points: { show: true, size: 4.5, width: 0, fill: () => colour("alert") } },
    ],
    cursor: { y: false, drag: { x: true, y: false }, points: { size: 8 } },
    hooks: {
      drawClear: [u => shade(u, run, variant, absent)],
      draw: [threshold],
      setCursor: [u => look(u.cursor.idx === null || u.cursor.left < 0 ? null : u.cursor.idx)],
    },
  };
  box.replaceChildren();
  const plot = new uPlot(options, [time, y, alerts], box);
  plot.over.addEventListener("mouseleave", () => look(null));
  return plot;
}

function stepCursor(plot, step) {
  const n = plot.data[0].length;
  const now = plot.cursor.idx ?? (step > 0 ? -1 : n);
  const idx = Math.min(Math.max(now + step, 0), n - 1);
  plot.setCursor({ left: plot.valToPos(plot.data[0][idx], "x"), top: plot.over.clientHeight / 2 });
}
