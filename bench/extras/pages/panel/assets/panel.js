// Shared by the pages of the panel: the stream, the name of the person, words, numbers and plots.
import { el, get, listen, person, setText, showLink } from "/assets/bench.js";

/**
 * Follow a stream. onupdate gets each message; onjoin is called instead of the first message where another page of this
 * browser has opened the stream before: the page must then ask for the whole state.
 */
export function follow(url, onupdate, onjoin) {
  if (typeof SharedWorker === "undefined") {
    let stream = listen(url, { update: onupdate });
    // Without a shared worker a hidden page gives its connection back; the stream then continues where it stopped.
    document.addEventListener("visibilitychange", () => {
      if (document.hidden) stream.close();
      else stream = listen(url, { update: onupdate }, { after: stream.lastId() });
    });
    return;
  }
  const { port } = new SharedWorker("/assets/own/stream_worker.js", { type: "module", name: "starbench-panel" });
  port.onmessage = ({ data }) => {
    if (data.kind === "update") onupdate(data.data);
    else if (data.kind === "joined") onjoin();
    else {
      showLink(data.up, data.lastMs, "the panel");
      if (!data.up) askForSignIn();
    }
  };
  port.postMessage({ open: url });
  addEventListener("pagehide", () => port.postMessage({ leave: url }));
  addEventListener("pageshow", (event) => { if (event.persisted) location.reload(); });
}

let askedMs = 0;

/** The link is down: if that is because this browser is not signed in any more, go to the sign-in. */
function askForSignIn() {
  if (Date.now() - askedMs < 2000) return;
  askedMs = Date.now();
  get("/api/here").catch(() => {}); // `get` itself leads to the sign-in
}

/** The name of the person, asked for once and kept in this browser. */
export function setUpPerson(field) {
  field.value = person.get();
  field.addEventListener("input", () => person.set(field.value));
}

export const STATE_WORDS = {
  idle: "not begun", preflight: "checks the devices", homing: "homes the stage", lighting: "sets the light",
  slewing: "moves the stage", settling: "waits until nothing moves", recording: "records", checking: "checks the recording",
  choosing: "chooses the next pose", backing_off: "waits before it tries again", waiting: "waits", holding: "holds",
  recovering: "recovers after a restart", parking: "parks the stage", solving: "calibrates", reporting: "writes the report",
  aborting: "makes the bench safe", finished: "finished", aborted: "stopped", failed: "failed",
};
export const VERDICT_WORDS = { aborted: "stopped", asks: "asks a question", "not sealed": "finished, not sealed" };

export function verdictPill(verdict, tone) {
  return el("span", { class: `pill ${tone}` }, VERDICT_WORDS[verdict] || verdict);
}

/** A message as the parts of an element, with what stands between backticks as code, as a terminal shows it. */
export function withCommands(message) {
  return message ? message.split("`").map((part, i) => i % 2 ? el("code", {}, part) : part) : [];
}

/** A number with three or more significant digits, without an exponent for the usual sizes. */
export function number(value, digits = 3) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size < 1e-4 || size >= 1e7) return value.toExponential(digits - 1);
  if (size >= 10 ** digits) return String(Math.round(value));
  return String(Number(value.toPrecision(digits)));
}

/** Value and expanded uncertainty with the same decimals, U rounded as `round_expanded` of the report does. */
export function withUncertainty(value, sigma, k = 2) {
  const expanded = k * sigma;
  if (!(expanded > 0)) return number(value, 6);
  const step = 10 ** (Math.floor(Math.log10(expanded)) - 1), near = Math.round(expanded / step);
  const rounded = step * (near * step < 0.99 * expanded ? near + 1 : near);
  const decimals = Math.min(9, Math.max(0, 1 - Math.floor(Math.log10(rounded))));
  const stated = value.toFixed(decimals);
  return `${Number(stated) === 0 ? stated.replace("-", "") : stated} ± ${rounded.toFixed(decimals)}`;
}

export function plural(count, noun) {
  return `${count} ${noun}${count === 1 ? "" : "s"}`;
}

function niceStep(span, most) {
  const raw = span / Math.max(1, most), power = 10 ** Math.floor(Math.log10(raw));
  return [1, 2, 5, 10].map((m) => m * power).find((step) => step >= raw * 0.999);
}

/** Round values for an axis, at most `most` of them. */
export function ticks(low, high, most = 5) {
  if (!(high > low)) return [low];
  const step = niceStep(high - low, most), found = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i += 1) found.push(Number((i * step).toPrecision(12)));
  return found;
}

function logTicks(low, high) {
  const found = [];
  for (let power = Math.floor(Math.log10(low)); power <= Math.ceil(Math.log10(high)); power += 1)
    for (const m of [1, 2, 5]) { const v = m * 10 ** power; if (v >= low * 0.999 && v <= high * 1.001) found.push(v); }
  if (found.length > 6) return found.filter((v) => Math.abs(Math.log10(v) - Math.round(Math.log10(v))) < 1e-9);
  return found.length ? found : [low];
}

/**
 * A small plot. series: [{points: [[x, y, error?]], kind: "line"|"dots"|"dashed", colour, label}]; bands: [[low, high]];
 * levels: [{y, label, colour}]. options: {width, height, log, xlabel, xticks(low, high) -> [[value, text]], label}.
 */
export function plot(series, options = {}) {
  const width = options.width || 420, height = options.height || 200, left = 48, right = 10, top = 8, bottom = options.xlabel ? 36 : 24;
  const all = series.flatMap((one) => one.points);
  if (!all.length) return el("p", { class: "note" }, options.empty || "Nothing yet.");
  const ys = [...all.flatMap(([, y, e]) => (e ? [y - e, y + e] : [y])), ...(options.levels || []).map((l) => l.y), ...(options.bands || []).flat()].filter((y) => Number.isFinite(y) && (!options.log || y > 0));
  const xs = all.map(([x]) => x);
  let [x0, x1] = [Math.min(...xs), Math.max(...xs)], [y0, y1] = [Math.min(...ys), Math.max(...ys)];
  if (options.xmax) x1 = Math.max(x1, options.xmax);
  if (x0 === x1) { x0 -= 0.5; x1 += 0.5; }
  if (options.log) { y0 /= 1.25; y1 *= 1.25; } else { const pad = (y1 - y0 || Math.abs(y1) || 1) * 0.08; y0 -= pad; y1 += pad; }
  const across = (x) => left + ((x - x0) / (x1 - x0)) * (width - left - right);
  const share = options.log ? (y) => Math.log(y / y0) / Math.log(y1 / y0) : (y) => (y - y0) / (y1 - y0);
  const up = (y) => height - bottom - share(y) * (height - top - bottom);
  const svg = el("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": options.label || "", class: "plot" });
  for (const [low, high] of options.bands || []) svg.append(el("rect", { x: left, width: width - left - right, y: up(high), height: Math.max(1, up(low) - up(high)), fill: "var(--accent-tint)" }));
  for (const y of options.log ? logTicks(y0, y1) : ticks(y0, y1, 4)) {
    svg.append(el("line", { x1: left, x2: width - right, y1: up(y), y2: up(y), stroke: "var(--line)", "stroke-width": 0.8 }));
    svg.append(el("text", { x: left - 5, y: up(y) + 4, "text-anchor": "end", class: "tick" }, options.ytext ? options.ytext(y) : number(y, 6)));
  }
  const xt = options.xticks ? options.xticks(x0, x1) : ticks(x0, x1, 6).filter((x) => !options.whole || Number.isInteger(x)).map((x) => [x, number(x, 6)]);
  for (const [x, text] of xt) svg.append(el("text", { x: across(x), y: height - bottom + 15, "text-anchor": "middle", class: "tick" }, text));
  if (options.xlabel) svg.append(el("text", { x: (left + width - right) / 2, y: height - 4, "text-anchor": "middle", class: "tick" }, options.xlabel));
  for (const level of options.levels || []) {
    svg.append(el("line", { x1: left, x2: width - right, y1: up(level.y), y2: up(level.y), stroke: level.colour || "var(--good)", "stroke-width": 1.4, "stroke-dasharray": level.dashed ? "5 4" : null }));
    if (level.label) svg.append(el("text", { x: width - right, y: up(level.y) - 4, "text-anchor": "end", class: "tick", style: `fill: ${level.colour || "var(--good)"}` }, level.label));
  }
  for (const one of series) {
    const points = one.points.filter(([, y]) => Number.isFinite(y) && (!options.log || y > 0));
    if (one.kind !== "dots" && points.length > 1)
      svg.append(el("polyline", { points: points.map(([x, y]) => `${across(x).toFixed(1)},${up(y).toFixed(1)}`).join(" "), fill: "none", stroke: one.colour, "stroke-width": 1.8, "stroke-dasharray": one.kind === "dashed" ? "5 4" : null, "stroke-linejoin": "round" }));
    for (const [x, y, error] of points) {
      if (error) svg.append(el("line", { x1: across(x), x2: across(x), y1: up(y - error), y2: up(y + error), stroke: one.colour, "stroke-width": 1.1 }));
      const dot = el("circle", { cx: across(x), cy: up(y), r: one.kind === "dashed" ? 2.2 : 3.2, fill: one.colour });
      svg.append(dot);
    }
  }
  return svg;
}

export function legend(entries) {
  return el("div", { class: "legend" }, entries.map(([colour, text, dashed]) =>
    el("span", {}, el("i", { style: `border-top: ${dashed ? "2px dashed" : "3px solid"} ${colour}` }), text)));
}

export { el, get, setText };
