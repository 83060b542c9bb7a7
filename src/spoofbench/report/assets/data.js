// The data island: base64 arrays, decoded when a run is looked at.
"use strict";

const DATA = JSON.parse(document.getElementById("data").textContent);
const ABSENT = -(2 ** 31), UNAVAILABLE = -(2 ** 15), INFINITE = 2 ** 15 - 1;

const decoded = new Map();

function array(index, Kind) {
  if (!decoded.has(index)) {
    const text = atob(DATA.arrays[index]);
    const bytes = Uint8Array.from(text, letter => letter.charCodeAt(0));
    const view = new DataView(bytes.buffer), size = Kind.BYTES_PER_ELEMENT;
    const get = size === 2 ? i => view.getInt16(2 * i, true) : i => view.getInt32(4 * i, true);
    decoded.set(index, Kind.from({ length: bytes.length / size }, (_, i) => get(i)));
  }
  return decoded.get(index);
}

const seconds = index => Array.from(array(index, Int32Array), ms => ms / 1000);

// A point is [east, north] in metres, or null.
function points(index) {
  const values = array(index, Int32Array), n = values.length / 2;
  return Array.from({ length: n }, (_, i) => values[i] === ABSENT ? null : [values[i] / 10, values[n + i] / 10]);
}

// The axis of scores: linear up to 1, logarithmic above.
const fromAxis = y => Math.abs(y) <= 1 ? y : Math.sign(y) * 10 ** (Math.abs(y) - 1);
const toAxis = s => Math.abs(s) <= 1 ? s : Math.sign(s) * (1 + Math.log10(Math.abs(s)));

function track(variant) {
  if (variant.track) return variant.track;
  const time = seconds(variant.epochs), clean = points(variant.clean), reported = clean.slice();
  const attacked = variant.attacked.map(part => {
    const moved = points(part.track);
    moved.forEach((point, i) => { reported[part.first + i] = point; });
    return moved;
  });
  return variant.track = { time, clean, reported, attacked };
}

function trace(run) {
  if (run.decoded || !run.trace) return run.decoded;
  const steps = array(run.trace.score, Int16Array);
  const time = seconds(run.trace.time);
  const finite = steps.reduce((top, s) => s < INFINITE ? Math.max(top, s) : top, DATA.steps);
  const height = s => s === UNAVAILABLE ? null : (s === INFINITE ? finite / DATA.steps + 0.5 : s / DATA.steps);
  const y = Array.from(steps, height);
  const alert = Array.from(steps, s => s > DATA.steps);
  return run.decoded = { time, y, alert, infinite: Array.from(steps, s => s === INFINITE) };
}

// The last index whose time is at or before t, -1 where there is none.
function latest(time, t) {
  let low = 0, high = time.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (time[middle] <= t) low = middle + 1; else high = middle;
  }
  return low - 1;
}

const NUMBER = new Intl.NumberFormat("en", { maximumSignificantDigits: 3 });
const METRES = new Intl.NumberFormat("en", { maximumFractionDigits: 0 });
