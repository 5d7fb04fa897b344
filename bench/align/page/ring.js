// The next turn of the focus ring: an arrow over the ring, beside the turn before.
import { el, fill } from "/assets/bench.js";

const CENTRE = [60, 66], RADIUS = 46, LAST_DEG = 38, MOST_DEG = 78;
const WORDS = { on: "same way", back: "back", other: "other way", either: "either way", wait: "wait" };

/** Show a turn: `way` of WORDS, and `times` the last turn, or null. The top of the ring is where it stands. */
export function showRing(svg, { way, times }) {
  const parts = [el("path", { d: arc(-85, 85), fill: "none", stroke: "var(--line)", "stroke-width": 9 })];
  const back = way === "back" || way === "other", sharp = Math.min(MOST_DEG, Math.max(14, LAST_DEG * (times ?? 1)));
  if (way === "on" || way === "back") parts.push(el("path", { d: arc(-LAST_DEG, 0), fill: "none", stroke: "var(--muted)", "stroke-width": 9, opacity: 0.45 }));
  if (way === "on" || way === "either") parts.push(...arrow(sharp));
  if (back || way === "either") parts.push(...arrow(-sharp));
  parts.push(el("line", { x1: 60, x2: 60, y1: 12, y2: 29, stroke: "currentColor", "stroke-width": 2 }));
  parts.push(el("text", { x: 60, y: 46, "text-anchor": "middle", "font-size": 14, "font-weight": 700 }, times === null ? "" : `${times.toFixed(1)} ×`));
  parts.push(el("text", { x: 60, y: 59, "text-anchor": "middle", "font-size": 11.5 }, WORDS[way]));
  svg.setAttribute("aria-label", `Focus ring: ${WORDS[way]}${times === null ? "" : `, ${times.toFixed(1)} times the last turn`}`);
  fill(svg, ...parts);
}

function place(deg, radius = RADIUS) {
  const angle = (deg - 90) * Math.PI / 180;
  return [CENTRE[0] + radius * Math.cos(angle), CENTRE[1] + radius * Math.sin(angle)];
}

function arc(from, to) { return `M${place(from).join(",")} A${RADIUS},${RADIUS} 0 0 ${to > from ? 1 : 0} ${place(to).join(",")}`; }

function arrow(deg) {
  const side = Math.sign(deg), foot = deg - 9 * side;
  const head = [place(deg + 5 * side), place(foot, RADIUS + 9), place(foot, RADIUS - 9)];
  return [el("path", { d: arc(0, foot), fill: "none", stroke: "var(--accent)", "stroke-width": 5 }),
    el("polygon", { points: head.map((one) => one.join(",")).join(" "), fill: "var(--accent)" })];
}
