// The figures beside the picture: signal, focus with its course, and where to turn.
import { el, fill, setText } from "/assets/bench.js";

const at = (id) => document.getElementById(id);
const course = []; // [time_s, edge width px] of this page's life
let best = null, drawn = "";

const digits = (value, n) => (typeof value === "number" ? value.toFixed(n) : null);
const signed = (value, n) => (typeof value === "number" ? `${value > 0 ? "+" : ""}${value.toFixed(n)}` : null);
const percent = (value, n = 0) => (typeof value === "number" ? (100 * value).toFixed(n) : null);

/** Show all figures of a picture. */
export function showFigures(f) {
  table(at("signal"), [
    ["Stars", f.stars.length, ""],
    ["Event rate", typeof f.signal.events_per_s === "number" ? (f.signal.events_per_s / 1e6).toFixed(1) : null, "Mev/s"],
    ["Link load", percent(f.signal.link_share), "%"],
    ["ON share", percent(f.signal.on_share), "%"],
    ["Flicker by triggers", digits(f.signal.trigger_hz, 2), "Hz"],
    ["Flicker by events", digits(f.signal.event_hz, 1), "Hz"],
    ["Jitter of the sync", digits(f.signal.jitter_us, 1), "µs"],
    ["Jitter of the events", digits(f.signal.event_jitter_us, 1), "µs"],
    ["Hot pixels", f.hot_pixels, ""],
    ["Contrast", percent(f.contrast), "%"],
    ["Saturated", percent(f.saturation, 1), "%"],
    ["Sensor", digits(f.temperature_c, 1), "°C"],
  ]);
  showFocus(f);
  const turn = f.turn || {}, turnDigits = turn.of === "beam" ? 0 : 1, inPx = turn.unit === "px";
  setText(at("turn-of"), turn.of ? `${turn.of === "beam" ? "about, " : ""}to bring the ${turn.of} to the middle` : "");
  table(at("turn"), [
    inPx ? ["It must move right by", signed(turn.pan, 0), "px"] : ["Turn pan by", signed(turn.pan, turnDigits), "°"],
    inPx ? ["It must move up by", signed(turn.tilt, 0), "px"] : ["Turn tilt by", signed(turn.tilt, turnDigits), "°"],
    ["Roll to the pixels", signed(turn.roll_deg, 1), "°"],
    ["Roll it by", turn.roll_by_deg === 0 ? "enough" : signed(turn.roll_by_deg, 0), "°"],
    ["Frame in the beam", percent(f.beam_share), "%"],
    ["Rim of the beam", f.rim_in_view === null || f.rim_in_view === undefined ? null : f.rim_in_view ? "in view" : "not in view", ""],
  ]);
  setText(at("rim-poses"), turn.rim_poses || "");
}

function table(holder, rows) {
  if (holder.childElementCount !== rows.length) {
    fill(holder, ...rows.map(([name]) => el("div", {}, el("b", {}, el("i", { class: "value" }), el("small", {})), el("span", {}, name))));
  }
  rows.forEach(([name, value, unit], i) => {
    const cell = holder.children[i], known = value !== null && value !== undefined;
    setText(cell.querySelector(".value"), known ? value : "–");
    setText(cell.querySelector("small"), known && unit && value !== "enough" ? ` ${unit}` : "");
    setText(cell.lastChild, name);
  });
}

function showFocus(f) {
  const focus = f.focus || {}, width = focus.edge_width_px;
  if (typeof width === "number") {
    const last = course[course.length - 1];
    if (last && f.time_s < last[0]) course.length = 0; // the session began anew
    if (!last || last[0] !== f.time_s) course.push([f.time_s, width]);
    if (course.length > 2400) course.shift();
  }
  best = typeof focus.best_edge_width_px === "number" ? focus.best_edge_width_px
    : course.length ? Math.min(...course.map(([, w]) => w)) : null;
  table(at("focus-figures"), [
    ["Edge width", digits(width, 2), "px"],
    ["Best edge width", digits(best, 2), "px"],
    ["Sharpness", digits(focus.sharpness, 2), ""],
    ["Coarse detail", digits(focus.coarse_detail, 3), ""],
    ["Best coarse detail", digits(focus.best_coarse_detail, 3), ""],
  ]);
  setText(at("focus-note"), "smaller edges are sharper");
  const key = JSON.stringify([f.stars_time_s, width, best]);
  if (key === drawn) return; // stars are searched less often than pictures come
  drawn = key;
  drawCourse(f.time_s);
  drawRegions(focus.regions, focus.tilt);
}

/** Take over the course that the server has, after a reload. */
export function beginCourse(points) {
  const first = course.length ? course[0][0] : Infinity;
  course.unshift(...points.filter(([t]) => t < first));
}

/** Forget the course, as the server does. */
export function forgetCourse() { course.length = 0; best = null; drawn = ""; }

function drawCourse(nowS) {
  const svg = at("course"), [w, h, left, low] = [520, 190, 46, 164];
  const recent = course.filter(([t]) => nowS - t < 120);
  const parts = [];
  if (recent.length > 1) {
    const top = Math.max(...recent.map(([, v]) => v)) * 1.1, start = recent[0][0], span = Math.max(5, nowS - start);
    const x = (t) => left + (w - left - 10) * (t - start) / span, y = (v) => low - (low - 12) * v / top;
    for (const part of [0, 0.5, 1]) {
      const value = top * part;
      parts.push(el("line", { x1: left, x2: w - 10, y1: y(value), y2: y(value), class: "grid-line" }));
      parts.push(el("text", { x: left - 6, y: y(value) + 4, "text-anchor": "end", "font-size": 11 }, value.toFixed(1)));
    }
    if (best !== null && best <= top) {
      parts.push(el("line", { x1: left, x2: w - 10, y1: y(best), y2: y(best), stroke: "var(--good)", "stroke-dasharray": "5 4" }));
      parts.push(el("text", { x: w - 12, y: y(best) - 5, "text-anchor": "end", "font-size": 11, style: "fill: var(--good)" }, `best ${best.toFixed(2)} px`));
    }
    parts.push(el("polyline", { points: recent.map(([t, v]) => `${x(t).toFixed(1)},${y(v).toFixed(1)}`).join(" "), fill: "none", stroke: "var(--plot-1)", "stroke-width": 2 }));
    const [t, v] = recent[recent.length - 1];
    parts.push(el("circle", { cx: x(t), cy: y(v), r: 4, fill: "var(--plot-1)" }));
    parts.push(el("text", { x: left, y: h - 6, "font-size": 11 }, `${Math.round(span)} s ago`));
    parts.push(el("text", { x: w - 10, y: h - 6, "text-anchor": "end", "font-size": 11 }, "now"));
    parts.push(el("text", { x: 2, y: 10, "font-size": 11 }, "px"));
  } else parts.push(el("text", { x: w / 2, y: h / 2, "text-anchor": "middle", "font-size": 13, style: "fill: var(--muted)" }, "The course of the edge width appears here as soon as stars are found."));
  fill(svg, ...parts);
}

/** Five regions: centre and the four corners, as a list or by name. */
function drawRegions(regions, tilt) {
  const svg = at("regions"), places = { centre: [80, 50], top_left: [30, 20], top_right: [130, 20], bottom_left: [30, 80], bottom_right: [130, 80] };
  const list = regionValues(regions, places);
  svg.style.display = list.length ? "" : "none";
  const known = list.map(([, v]) => v).filter((v) => typeof v === "number");
  const worst = Math.max(...known), least = Math.min(...known);
  const parts = [el("rect", { x: 1, y: 1, width: 158, height: 98, rx: 5, fill: "none", stroke: "var(--line)" })];
  for (const [[x, y], value] of list) {
    const isWorst = known.length > 1 && value === worst && worst > 1.15 * least;
    parts.push(el("text", { x, y: y + 5, "text-anchor": "middle", "font-size": 14, "font-weight": 650, style: isWorst ? "fill: var(--warn)" : "" }, typeof value === "number" ? value.toFixed(2) : "–"));
  }
  fill(svg, ...parts);
  setText(at("tilt"), typeof tilt === "string" ? tilt : "");
}

function regionValues(regions, places) {
  if (!regions) return [];
  const number = (one) => (one && typeof one === "object" ? one.edge_width_px : one);
  if (Array.isArray(regions)) return Object.values(places).slice(0, regions.length).map((place, i) => [place, number(regions[i])]);
  const names = Object.keys(regions);
  return names.map((name) => [places[name.replace(/[ -]/g, "_")] || places.centre, number(regions[name])]);
}
