// The align page: shows state and pictures as the server sends them, and sends what a person asks for.
// Nothing is sent to the devices when the page opens, reloads or reconnects.
import { el, fill, listen, post, setText, showLink } from "/assets/bench.js";
import { draw } from "/assets/own/overlay.js";
import { showFigures } from "/assets/own/figures.js";

const at = (id) => document.getElementById(id);
const page = ownId();
let state = null, picture = null, fetching = false, shownNumber = 0;
/** Number of pictures shown, for tests. */
window.alignStats = { images: 0 };

/** The page's own id: kept over a reload of this tab, new in every other tab. */
function ownId() {
  let id = null;
  const entry = performance.getEntriesByType("navigation")[0];
  try { if (entry && entry.type !== "navigate") id = sessionStorage.getItem("starbench-page"); } catch { /* private */ }
  if (!id) {
    const bytes = crypto.getRandomValues(new Uint8Array(12));
    id = Array.from(bytes, (b) => b.toString(16).padStart(2, "0")).join("");
  }
  try { sessionStorage.setItem("starbench-page", id); } catch { /* private window: a reload is a new page */ }
  return id;
}

// ---------------------------------------------------------------- asking

let toastTimer = 0;
function toast(text, bad = false) {
  const box = at("toast");
  setText(box, text);
  box.className = bad ? "shown bad" : "shown";
  clearTimeout(toastTimer);
  toastTimer = setTimeout(() => { box.className = ""; }, bad ? 9000 : 3500);
}

async function ask(what, body = {}) {
  try {
    return (await post(`/do/${what}`, { page, ...body })).result;
  } catch (error) {
    toast(error.message, true);
    return undefined;
  }
}

function number(input) {
  const value = Number(input.value.replace(",", "."));
  return input.value.trim() === "" ? NaN : value;
}

// ---------------------------------------------------------------- showing the state

const holds = () => state !== null && (state.holder === page || state.holder === "");

function showState(next) {
  state = next;
  setText(at("station"), state.station.name);
  document.title = `Align: ${state.station.name}`;
  at("simulated").hidden = !state.station.simulated;
  showHolder();
  showTrouble();
  showStage();
  showLight();
  showBiases();
  showHands();
  showLines();
  showOldPicture();
  if (picture && picture.number) showTurn(picture.figures.turn); // the stage may not be homed any more
  for (const input of document.querySelectorAll(".controls button, .controls input, .controls select")) {
    if (input.closest("[data-free]")) continue;
    input.dataset.barred = state.devices.state === "open" && holds() ? "" : "1";
    input.disabled = input.dataset.barred === "1" || input.dataset.off === "1";
  }
  showWhole();
}

/** Say in one line what is not ready for a run; the figures themselves say by how much. */
function showWhole() {
  const waiting = { opening: "Opening the devices. Nothing is moved.", failed: "The devices are not open. See above.", closed: "The devices are closed." };
  const off = state.not_ready || [];
  at("whole").className = `banner ${state.devices.state !== "open" ? "busy" : off.length ? "warn" : "good"}`;
  setText(at("whole"), waiting[state.devices.state] || (off.length ? `Not ready: ${off.join(", ")}.` : "Ready: every figure is as a run expects it."));
}

/** Show what a device does. */
function showDevice(pill, row) {
  setText(pill, row.value);
  pill.className = `pill ${row.good ? "good" : "warn"}`;
}

function showHolder() {
  setText(at("holder"), state.holder === page ? "This page has the controls" : state.holder ? "Another page has the controls" : "Nobody has the controls");
  at("take").hidden = state.holder === page;
}

function showTrouble() {
  const lines = [];
  const { failure } = state.devices;
  if (failure) lines.push(["The devices could not be opened", failure]);
  for (const name of ["stage", "light", "camera"]) {
    if (state[name] && state[name].failure) lines.push([name[0].toUpperCase() + name.slice(1), state[name].failure]);
  }
  const box = at("trouble");
  box.hidden = lines.length === 0;
  const key = JSON.stringify(lines);
  if (box.dataset.key === key) return;
  box.dataset.key = key;
  fill(box, ...lines.map(([name, f]) => el("p", {}, el("b", {}, `${name}: `), `${f.where ? f.where + ": " : ""}${f.what} ${f.remedy}`)),
    lines.length ? el("button", { id: "reopen", onclick: () => ask("open") }, "Try again") : null);
}

function showStage() {
  const stage = state.stage, moving = Boolean(stage && stage.work);
  at("stop").classList.toggle("moving", moving);
  if (!stage) { fill(at("axes")); setText(at("stage-state"), ""); return; }
  showDevice(at("stage-state"), state.rows.Stage);
  const holder = at("axes");
  if (holder.childElementCount !== stage.axes.length) fill(holder, ...stage.axes.map(axisRow));
  stage.axes.forEach((axis, i) => {
    const row = holder.children[i], span = axis.highest_deg - axis.lowest_deg;
    const place = axis.position_deg === null ? null : 100 * (axis.position_deg - axis.lowest_deg) / span;
    setText(row.querySelector(".deg"), axis.position_deg === null ? "unknown" : `${axis.position_deg.toFixed(3)}°${stage.answers ? "" : " before"}`);
    const goal = axis.goal_deg !== null && moving ? ` to ${axis.goal_deg.toFixed(2)}°` : "";
    setText(row.querySelector("small"), goal);
    row.querySelector("i").style.left = `calc(${Math.min(100, Math.max(0, place ?? 0))}% - 1px)`;
    row.querySelector("i").hidden = place === null;
    row.querySelector("b").style.left = `${100 * -axis.lowest_deg / span}%`;
  });
  at("home").dataset.off = moving ? "1" : "";
  at("home").classList.toggle("main", stage.homed === false);
}

function axisRow(axis) {
  const jog = (sign) => () => ask("jog", { steps_deg: { [axis.name]: sign * Number(at("step").value) } });
  return el("div", { class: "axis", "data-axis": axis.name },
    el("b", {}, axis.name),
    el("span", { class: "where" }, el("span", { class: "deg" }), el("small", {})),
    el("span", { class: "jog" },
      el("button", { class: "minus", title: `Turn ${axis.name} by one step in the negative direction`, onclick: jog(-1) }, "−"),
      el("button", { class: "plus", title: `Turn ${axis.name} by one step in the positive direction`, onclick: jog(1) }, "+")),
    el("span", { class: "range" }, el("b", {}), el("i", {})),
    el("span", { class: "ends" }, el("span", {}, `${axis.lowest_deg}°`), el("span", {}, `${axis.highest_deg}°`)));
}

function showLight() {
  const light = state.light;
  if (!light) { setText(at("light-state"), ""); return; }
  showDevice(at("light-state"), state.rows.Light);
  keep(at("frequency"), light.frequency_hz);
  keep(at("level"), light.level_percent);
  keep(at("duty"), light.duty_percent);
  at("frequency").closest("label").hidden = light.steady_only;
  at("duty").closest("label").hidden = light.steady_only;
  const r = light.read_back;
  const [low, high] = light.frequency_range_hz;
  const kind = !r ? "" : r.waveform === "steady" ? `steady, ${r.high_v.toFixed(3)} V`
    : `${r.waveform}, ${r.frequency_hz} Hz, duty ${r.duty_percent} %, ${r.low_v.toFixed(3)} V to ${r.high_v.toFixed(3)} V, sync ${r.sync_output ? "on" : "off"}`;
  setText(at("light-read"), `${r ? `Read back: ${kind}.` : ""} ${light.steady_only ? "" : `This lamp follows ${low} Hz to ${high} Hz.`}`);
}

/** Show a value in a field, unless a person is changing it. */
function keep(input, value) {
  if (document.activeElement === input || input.dataset.dirty === "1") return;
  const text = value === null || value === undefined ? "" : String(value);
  if (input.value !== text) input.value = text;
}

/** Biases of an event camera, or exposure and gain of a frame camera. */
function showBiases() {
  const frame = state.camera && state.camera.kind === "frame", settings = state.camera ? state.camera.settings : [];
  at("bias-card").hidden = settings.length === 0;
  setText(at("bias-title"), frame ? "Exposure and gain" : "Biases");
  setText(at("bias-note"), frame ? "in the units of the camera's driver, as read back" : "offsets from the factory values, as read back");
  const holder = at("biases");
  if (holder.childElementCount !== settings.length) fill(holder, ...settings.map(settingRow));
  settings.forEach((setting, i) => {
    const row = holder.children[i];
    for (const input of row.querySelectorAll("input")) keep(input, setting.value);
    row.classList.toggle("off", setting.changed);
    setText(row.querySelector(".note"), `${setting.range ? `${setting.range.join(" to ")}; ` : ""}${setting.expected === null ? "" : `expected: ${setting.expected}, as in the station file`}`);
  });
}

function settingRow({ name, range }) {
  const send = async (event) => {
    const value = number(event.target);
    if (Number.isFinite(value)) await ask("camera", { name, value });
    event.target.dataset.dirty = "";
    event.target.blur();
    if (state) showBiases();
  };
  const limits = { ...(range ? { min: range[0], max: range[1], step: 1 } : { step: "any" }), onchange: send, "aria-label": name };
  return el("div", { class: "bias" }, el("code", {}, name), range ? el("input", { type: "range", ...limits }) : el("span", {}),
    el("input", { type: "number", ...limits }), el("span", { class: "note" }));
}

function showHands() {
  at("hands-card").hidden = !state.hands;
  const seen = state.hands && state.hands.seen;
  if (!seen) return;
  const focus = seen.focus_distance_m === "infinity" ? "infinity" : `${Number(seen.focus_distance_m).toPrecision(3)} m`;
  setText(at("hands-seen"), `Ring at ${Number(seen.ring_deg).toFixed(1)}°, focused at ${focus}, f/${seen.f_number}, camera turned by ${seen.turn_deg.map((a) => `${Number(a).toFixed(1)}°`).join(", ")} (pan, tilt, roll).`);
}

/** A picture that is not new any more must not look as if it were. */
function showOldPicture() {
  const failure = state.camera ? state.camera.failure : state.devices.failure, gone = Boolean(failure) || state.devices.state !== "open";
  at("picture").classList.toggle("old", gone && shownNumber > 0);
  at("dark").hidden = !gone && shownNumber > 0;
  setText(at("dark"), shownNumber > 0 ? "No new picture" : "No picture yet");
}

function showLines() {
  const lines = state.station_lines || [];
  at("station-card").hidden = lines.length === 0;
  setText(at("station-lines"), lines.join("\n"));
}

// ---------------------------------------------------------------- showing pictures

function showPicture(next) {
  picture = next;
  if (next.number === 0) { shownNumber = 0; return; }
  if (next.number < shownNumber) shownNumber = 0; // the devices were opened again
  showFigures(next);
  showTurn(next.figures.turn);
  fetchImage();
}

/** Fetch the newest image; while one is on its way, later ones are left out. */
async function fetchImage() {
  if (fetching || !picture || picture.number === shownNumber || document.hidden) return;
  fetching = true;
  const wanted = picture;
  try {
    const answer = await fetch(`/image?number=${wanted.number}`);
    if (answer.status === 200) {
      const blob = await answer.blob(), image = at("image"), url = URL.createObjectURL(blob), old = image.src;
      image.src = url;
      await image.decode().catch(() => {});
      if (old) URL.revokeObjectURL(old);
      shownNumber = wanted.number;
      if (state) showOldPicture();
      document.documentElement.style.setProperty("--aspect", (wanted.figures.width_px || 16) / (wanted.figures.height_px || 9));
      window.alignStats.images += 1;
      redraw(wanted.figures);
    }
  } catch { /* the link is down: the bar says so */ }
  fetching = false;
  if (picture && picture.number !== wanted.number) fetchImage();
}

function redraw(figures) {
  if (!figures) return;
  const shows = Object.fromEntries(["stars", "tag", "disc", "grid"].map((name) => [name, at(`show-${name}`).checked]));
  draw(at("over"), figures, shows);
}

function showTurn(turn) {
  const steps = {};
  for (const axis of state && state.stage && state.stage.homed !== false && turn.unit === "°" ? state.stage.axes : []) {
    const step = turn[axis.name];
    if (typeof step === "number" && Math.abs(step) >= 0.05) steps[axis.name] = Math.max(-5, Math.min(5, Math.round(step * 100) / 100));
  }
  const button = at("turn-there");
  button.dataset.steps = JSON.stringify(steps);
  button.dataset.off = Object.keys(steps).length ? "" : "1";
  button.disabled = button.dataset.barred !== "" || button.dataset.off === "1";
}

/** What the devices may still do when the link is lost, by what was known last. */
function mayBeOn() {
  if (!state || state.devices.state !== "open") return "";
  const light = state.light && state.light.on !== false ? "The light may still be on. " : "";
  const stage = state.stage && state.stage.work ? "The stage was turning: it stops within a second if Starbench still runs. " : "";
  return `${light}${stage}${light || stage ? "If the program has ended, look at the bench and switch off by hand. " : ""}`;
}

// ---------------------------------------------------------------- what a person does

at("stop").addEventListener("pointerdown", () => ask("stop")); // not click: a click comes when the button is released
at("stop").addEventListener("keydown", (event) => { if (event.key === "Enter" || event.key === " ") ask("stop"); });
document.addEventListener("keydown", (event) => {
  if (event.key !== "Escape") return;
  ask("stop");
  for (const dialog of document.querySelectorAll("dialog[open]")) dialog.close();
});
at("take").addEventListener("click", () => ask("take"));
at("home").addEventListener("click", () => { at("sure").show(); at("sure").scrollIntoView({ block: "nearest" }); }); // on a phone it lies at the end of the page
at("home-now").addEventListener("click", () => { at("sure").close(); ask("home"); });
at("home-not").addEventListener("click", () => at("sure").close());
at("turn-there").addEventListener("click", () => ask("jog", { steps_deg: JSON.parse(at("turn-there").dataset.steps) }));
at("light-on").addEventListener("click", () => sendLight({ on: true }));
at("light-off").addEventListener("click", () => ask("light", { on: false }));
at("light-form").addEventListener("submit", (event) => { event.preventDefault(); sendLight({}); });
at("forget").addEventListener("click", () => ask("forget"));
for (const name of ["stars", "tag", "disc", "grid"]) {
  at(`show-${name}`).addEventListener("change", () => redraw(picture && picture.figures));
}
for (const id of ["frequency", "level", "duty"]) at(id).addEventListener("input", (event) => { event.target.dataset.dirty = "1"; });

async function sendLight(body) {
  const wanted = { ...body };
  const fields = { frequency_hz: at("frequency"), level_percent: at("level"), duty_percent: at("duty") };
  for (const [name, input] of Object.entries(fields)) {
    if (input.closest("label").hidden) continue;
    const value = number(input);
    if (!Number.isFinite(value)) { toast(`${input.closest("label").firstChild.textContent.trim()} is not a number. Nothing was sent.`, true); return; }
    if (state && state.light && state.light[name] !== value) wanted[name] = value;
  }
  if (body.on && state.light) for (const [name, input] of Object.entries(fields)) {
    if (!input.closest("label").hidden) wanted[name] = number(input);
  }
  const done = await ask("light", wanted);
  if (done !== undefined) for (const input of Object.values(fields)) input.dataset.dirty = "";
}

for (const holder of document.querySelectorAll("[data-action]")) {
  const { action, name } = holder.dataset;
  for (const step of [-20, -5, -1, 1, 5, 20]) {
    holder.append(el("button", { "data-step": step, onclick: () => ask("hands", { action, [name]: step }) }, `${step > 0 ? "+" : "−"}${Math.abs(step)}°`));
  }
}
for (const f of [1.4, 2, 2.8, 4, 5.6, 8]) {
  at("apertures").append(el("button", { onclick: () => ask("hands", { action: "lens aperture", f_number: f }) }, `f/${f}`));
}

addEventListener("visibilitychange", fetchImage);
for (const [name, selector] of [["--top", ".top"], ["--whole", "#whole"], ["--view", ".view"]]) {
  new ResizeObserver(([part]) => document.documentElement.style.setProperty(name, `${part.target.offsetHeight}px`)).observe(document.querySelector(selector));
}
addEventListener("resize", () => redraw(picture && picture.figures));

// The stop button must work whatever else the page waits for; so nothing above awaits before the stream is open.
const beat = new Worker("/assets/own/beat.js");
beat.postMessage(page);
listen(`/stream?page=${page}`, { state: showState, picture: showPicture }, {
  onlink: (isUp, lastMs) => showLink(isUp, lastMs, "Starbench", isUp ? "" : mayBeOn()),
});
