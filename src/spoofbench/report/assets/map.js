// The tracks in the plane, north up, one metre the same length both ways; an SVG, coloured by the style sheet.
"use strict";

const SVG = "http://www.w3.org/2000/svg";

function shape(parent, name, attributes, text) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== undefined) element.textContent = text;
  parent.append(element);
  return element;
}

function niceStep(span, count) {
  const rough = Math.max(span / count, 1e-3), decade = 10 ** Math.floor(Math.log10(rough));
  return decade * [1, 2, 5, 10].find(factor => factor * decade >= rough);
}

// Pixels of [east, north] within width x height less the margin, and the extent in metres that they show.
function projection(all, width, height, margin) {
  const east = all.map(p => p[0]), north = all.map(p => p[1]);
  const bounds = values => values.reduce(([a, b], v) => [Math.min(a, v), Math.max(b, v)], [Infinity, -Infinity]);
  const [w, e] = bounds(east), [s, n] = bounds(north);
  const scale = Math.min((width - margin.left - margin.right) / Math.max(e - w, 20), (height - margin.top - margin.bottom) / Math.max(n - s, 20)) * 0.94;
  const middle = [(margin.left + width - margin.right) / 2, (margin.top + height - margin.bottom) / 2];
  const centre = [(w + e) / 2, (s + n) / 2];
  const pixel = ([x, y]) => [middle[0] + (x - centre[0]) * scale, middle[1] - (y - centre[1]) * scale];
  const metres = (x, y) => [centre[0] + (x - middle[0]) / scale, centre[1] - (y - middle[1]) / scale];
  return { pixel, metres, scale };
}

function line(svg, track, pixel, name) {
  let pen = "M", path = "";
  for (const point of track) {
    if (!point) { pen = "M"; continue; }
    const [x, y] = pixel(point);
    path += `${pen}${x.toFixed(1)} ${y.toFixed(1)}`;
    pen = "L";
  }
  if (path) shape(svg, "path", { d: path, class: name });
}

function grid(svg, { pixel, metres }, width, height, margin) {
  const [w, s] = metres(margin.left, height - margin.bottom), [e, n] = metres(width - margin.right, margin.top);
  const step = niceStep(Math.min(e - w, n - s), 4);
  for (let east = Math.ceil(w / step) * step; east <= e; east += step) {
    const x = pixel([east, 0])[0];
    shape(svg, "line", { x1: x, x2: x, y1: margin.top, y2: height - margin.bottom, class: "grid" });
    shape(svg, "text", { x, y: height - margin.bottom + 16, "text-anchor": "middle" }, METRES.format(Math.round(east) || 0));
  }
  for (let north = Math.ceil(s / step) * step; north <= n; north += step) {
    const y = pixel([0, north])[1];
    shape(svg, "line", { x1: margin.left, x2: width - margin.right, y1: y, y2: y, class: "grid" });
    shape(svg, "text", { x: margin.left - 6, y: y + 4, "text-anchor": "end" }, METRES.format(Math.round(north) || 0));
  }
  shape(svg, "text", { x: (margin.left + width - margin.right) / 2, y: height - 4, "text-anchor": "middle" }, "east of the start, m");
  const up = [12, (margin.top + height - margin.bottom) / 2];
  shape(svg, "text", { x: up[0], y: up[1], transform: `rotate(-90 ${up})`, "text-anchor": "middle" }, "north of the start, m");
}

// Returns a function that marks where the receiver was and where it reported to be at an epoch (-1: neither).
function drawMap(box, run, variant) {
  const { time, clean, reported, attacked } = track(variant);
  const width = box.clientWidth, height = Math.round(Math.min(Math.max(width * 0.62, 300), 520));
  const margin = { left: 84, right: 12, top: 10, bottom: 42 };
  box.replaceChildren();
  const svg = shape(box, "svg", { viewBox: `0 0 ${width} ${height}`, width, height, role: "img", "aria-label": "Map of the clean and the spoofed track" });
  const all = [...clean, ...attacked.flat()].filter(Boolean);
  if (!all.length) {
    box.replaceChildren(time.length ? "There are no positions to draw." : "This variant was not made.");
    return () => {};
  }
  const view = projection(all, width, height, margin);
  grid(svg, view, width, height, margin);
  line(svg, clean, view.pixel, "clean-track");
  for (const part of attacked) line(svg, part, view.pixel, "spoofed-track");
  const decisions = trace(run);
  if (decisions) {
    const spots = new Set(decisions.time.filter((_, i) => decisions.alert[i]).map(t => latest(time, t)));
    for (const i of spots) {
      if (i < 0 || !reported[i]) continue;
      const [x, y] = view.pixel(reported[i]);
      shape(svg, "circle", { cx: x.toFixed(1), cy: y.toFixed(1), r: 2, class: "alert-spot" });
    }
  }
  const start = clean.find(Boolean) ?? all[0];
  const [x, y] = view.pixel(start);
  shape(svg, "path", { d: `M${x - 6} ${y + 5}L${x + 6} ${y + 5}L${x} ${y - 7}Z`, class: "start-mark" });
  const side = x > width - 60 ? -1 : 1;
  shape(svg, "text", { x: x + 9 * side, y: y - 7, "text-anchor": side < 0 ? "end" : "start", class: "start-text" }, "start");
  const trueMark = shape(svg, "circle", { r: 6, class: "true-position", visibility: "hidden" });
  const reportedMark = shape(svg, "circle", { r: 6, class: "reported-position", visibility: "hidden" });
  const put = (mark, point) => {
    mark.setAttribute("visibility", point ? "visible" : "hidden");
    if (!point) return;
    const [cx, cy] = view.pixel(point);
    mark.setAttribute("cx", cx);
    mark.setAttribute("cy", cy);
  };
  return i => { put(trueMark, clean[i]); put(reportedMark, reported[i] === clean[i] ? null : reported[i]); };
}
