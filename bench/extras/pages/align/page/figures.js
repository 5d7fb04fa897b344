// The figures beside the picture, each with what is expected, and the curve of the focus over the last minute.
import { el, fill, setText } from "/assets/bench.js";

const at = (id) => document.getElementById(id);
const KEPT_S = 60; // as the server keeps the curve
let drawn = "";

/** Show all figures of a picture: its rows, and the curve. */
export function showFigures({ figures, rows, focus_curve: curve }) {
  for (const group of ["signal", "focus", "turn"]) table(at(`${group}-figures`), rows.filter((row) => row.group === group));
  const { of } = figures.turn;
  setText(at("turn-of"), of ? `${of === "beam" ? "about, " : ""}to bring the ${of} to the middle` : "");
  const best = Number(rows.find((row) => row.name === "Best so far")?.value || NaN), key = JSON.stringify([curve, best]);
  if (key !== drawn) draw(curve, figures.time_s, best);
  drawn = key;
}

function table(holder, rows) {
  if (holder.childElementCount !== rows.length) {
    fill(holder, ...rows.map(() => el("div", {}, el("b", {}, el("i", { class: "value" }), el("small", {})), el("span", { class: "name" }), el("span", { class: "note" }))));
  }
  rows.forEach((row, i) => {
    const cell = holder.children[i];
    cell.classList.toggle("off", row.good === false);
    setText(cell.querySelector(".value"), row.value || "–");
    setText(cell.querySelector("small"), row.value && row.unit ? ` ${row.unit}` : "");
    setText(cell.querySelector(".name"), row.name);
    setText(cell.querySelector(".note"), row.expected ? `expected: ${row.expected}` : "");
  });
}

function draw(curve, nowS, best) {
  const svg = at("curve"), [w, h, left, low] = [520, 190, 46, 164];
  if (curve.length < 2) {
    const lines = ["No stars and no tag are found.", "Far out of focus, a level of 10 % shows the tag."];
    fill(svg, ...lines.map((line, i) => el("text", { x: w / 2, y: h / 2 + 20 * i, "text-anchor": "middle", "font-size": 14, style: "fill: var(--muted)" }, line)));
    return;
  }
  const top = Math.max(...curve.map(([, v]) => v)) * 1.1, parts = [];
  const x = (t) => left + (w - left - 10) * (1 - (nowS - t) / KEPT_S), y = (v) => low - (low - 12) * v / top;
  for (const value of [0, 0.5 * top, top]) {
    parts.push(el("line", { x1: left, x2: w - 10, y1: y(value), y2: y(value), class: "grid-line" }));
    parts.push(el("text", { x: left - 6, y: y(value) + 4, "text-anchor": "end", "font-size": 11 }, value.toFixed(1)));
  }
  if (best <= top) parts.push(el("line", { x1: left, x2: w - 10, y1: y(best), y2: y(best), stroke: "var(--good)", "stroke-dasharray": "5 4" }));
  parts.push(el("polyline", { points: curve.map(([t, v]) => `${x(t).toFixed(1)},${y(v).toFixed(1)}`).join(" "), fill: "none", stroke: "var(--plot-1)", "stroke-width": 2 }));
  const [t, v] = curve[curve.length - 1];
  parts.push(el("circle", { cx: x(t), cy: y(v), r: 4, fill: "var(--plot-1)" }));
  parts.push(el("text", { x: left, y: h - 6, "font-size": 11 }, `${KEPT_S} s ago`));
  parts.push(el("text", { x: w - 10, y: h - 6, "text-anchor": "end", "font-size": 11 }, "now"));
  parts.push(el("text", { x: 2, y: 10, "font-size": 11 }, "px"));
  fill(svg, ...parts);
}
