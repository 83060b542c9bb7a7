// The drill-down: choose a run, or come with one in the address, and see its figures, timeline and map.
"use strict";

const byId = id => document.getElementById(id);
const KEYS = ["detector", "recording", "attack", "window"];
const keyOf = (run, key) => key === "detector" ? run.detector : DATA.variants[run.variant][key];
const selects = Object.fromEntries(KEYS.map(key => [key, byId(`choose-${key}`)]));

let chosen = null, plot = null, around = false;

// The run that has as many of the wanted labels as can be had, in the order of KEYS.
function find(wanted) {
  let left = DATA.runs;
  for (const key of KEYS) {
    const match = left.filter(run => keyOf(run, key) === wanted[key]);
    if (match.length) left = match;
  }
  return left[0];
}

function fill() {
  let left = DATA.runs;
  for (const key of KEYS) {
    const labels = [...new Set((key === "detector" ? DATA.runs : left).map(run => keyOf(run, key)))];
    selects[key].replaceChildren(...labels.map(label => new Option(label, label, false, label === keyOf(chosen, key))));
    selects[key].closest("label").hidden = key === "recording" && labels.length === 1;
    left = left.filter(run => keyOf(run, key) === keyOf(chosen, key));
  }
}

function facts(run) {
  byId("facts").replaceChildren(...run.facts.flatMap(([name, text]) => {
    const term = document.createElement("dt"), value = document.createElement("dd");
    term.textContent = name;
    value.textContent = text;
    return [term, value];
  }));
  const note = byId("status");
  note.hidden = run.status === "ok";
  note.textContent = run.status.replaceAll("_", " ") + (run.reason ? `: ${run.reason}` : "");
}

function readout(run, variant, mark, idx) {
  const out = byId("readout");
  if (idx === null) {
    mark(-1);
    out.textContent = "Point at the timeline, or focus it and press the arrow keys, to read values; drag to zoom, double-click to see all.";
    return;
  }
  const { time, y, alert, infinite } = trace(run), path = track(variant);
  const epoch = latest(path.time, time[idx]);
  mark(epoch);
  const score = y[idx] === null ? "unavailable" : `score ${infinite[idx] ? "infinite" : NUMBER.format(fromAxis(y[idx]))}${alert[idx] ? ", alert" : ""}`;
  const [a, b] = [path.clean[epoch], path.reported[epoch]];
  const apart = a && b && a !== b ? `, ${METRES.format(Math.hypot(a[0] - b[0], a[1] - b[1]))} m from the clean position` : "";
  out.textContent = `${time[idx].toFixed(1)} s: ${score}${apart}`;
}

function zoom() {
  const parts = DATA.variants[chosen.variant].intervals, time = plot.data[0];
  const from = time[0], to = time[time.length - 1];
  const length = parts.length ? parts[parts.length - 1][1] - parts[0][0] : 0;
  const window = around && parts.length
    ? { min: Math.max(from, parts[0][0] - 0.3 * length - 10), max: Math.min(to, parts[parts.length - 1][1] + 0.3 * length + 20) }
    : { min: from, max: to };
  plot.setScale("x", window);
}

function draw() {
  const run = chosen, variant = DATA.variants[run.variant];
  const mark = drawMap(byId("map"), run, variant);
  plot?.destroy();
  plot = null;
  byId("around").hidden = !variant.intervals.length || !run.trace;
  byId("decimation").textContent = run.trace && run.trace.rows > trace(run).time.length
    ? `Drawn from ${trace(run).time.length} of ${run.trace.rows} decisions: of every stretch its lowest and highest score and its first and last unavailable row.`
    : "";
  byId("timeline").setAttribute("aria-label", run.summary);
  if (!run.trace || !trace(run).time.length) {
    byId("timeline").replaceChildren(run.trace ? "The detector made no decision." : "There are no decisions to draw.");
    byId("readout").textContent = "";
    return;
  }
  plot = drawTimeline(byId("timeline"), run, variant, idx => readout(run, variant, mark, idx));
  if (around) zoom();
  readout(run, variant, mark, null);
}

function show(run, remember) {
  chosen = run;
  fill();
  facts(run);
  byId("run-title").textContent = `${run.detector} on ${keyOf(run, "attack")}${keyOf(run, "window") === "-" ? "" : `, window ${keyOf(run, "window")}`}`;
  draw();
  if (remember) {
    history.replaceState(null, "", `#${new URLSearchParams(Object.fromEntries(KEYS.map(key => [key, keyOf(run, key)])))}`);
  }
}

function fromAddress() {
  const wanted = Object.fromEntries(new URLSearchParams(location.hash.slice(1)));
  if (!wanted.detector) return false;
  show(find(wanted), false);
  byId("run").scrollIntoView({ behavior: "instant" });
  return true;
}

if (DATA.runs.length) {
  for (const key of KEYS) {
    selects[key].addEventListener("change", () => {
      const wanted = Object.fromEntries(KEYS.map(other => [other, selects[other].value]));
      show(find(wanted), true);
    });
  }
  byId("around").addEventListener("click", () => {
    around = !around;
    byId("around").setAttribute("aria-pressed", around);
    zoom();
  });
  byId("timeline").addEventListener("keydown", event => {
    const step = { ArrowRight: 1, ArrowLeft: -1, PageDown: 60, PageUp: -60 }[event.key];
    if (!step || !plot) return;
    event.preventDefault();
    stepCursor(plot, step);
  });
  window.addEventListener("hashchange", fromAddress);
  document.addEventListener("click", event => {
    if (event.target.closest(".heat a")?.getAttribute("href") === location.hash) fromAddress();
  });
  if (!fromAddress()) show(DATA.runs[DATA.first], false);
  let width = byId("timeline").clientWidth;
  new ResizeObserver(() => {
    if (byId("timeline").clientWidth !== width) { width = byId("timeline").clientWidth; draw(); }
  }).observe(byId("timeline"));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => plot?.redraw());
  window.addEventListener("beforeprint", () => { document.documentElement.classList.add("paper"); plot?.redraw(); });
  window.addEventListener("afterprint", () => { document.documentElement.classList.remove("paper"); plot?.redraw(); });
}
