// The align page: shows state and pictures as the server sends them, and sends what a person asks for.
// Nothing is sent to the devices when the page opens, reloads or reconnects.
import { el, fill, get, listen, post, setText, showLink } from "/assets/bench.js";
import { draw } from "/assets/own/overlay.js";
import { beginCurve, forgetCurve, showFigures } from "/assets/own/figures.js";

const at = (id) => document.getElementById(id);
const page = ownId();
let state = null, picture = null, fetching = false, shownNumber = 0, files = null, proposal = null;
/** Numbers for tests: when pictures came, and how late. */
window.alignStats = { openedMs: performance.timeOrigin, firstImageMs: null, images: 0, searches: 0, starsTimeS: null, latenciesMs: [] };

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

const holds = () => state !== null && (state.controls.holder === page || state.controls.holder === "");

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
  showLog();
  showOldPicture();
  for (const input of document.querySelectorAll(".controls button, .controls input, .controls select")) {
    if (input.closest("[data-free]")) continue;
    input.dataset.barred = state.devices.state === "open" && holds() ? "" : "1";
    input.disabled = input.dataset.barred === "1" || input.dataset.off === "1";
  }
  showWhole();
}

/** Say in one line which figures are not as expected; the figures themselves say by how much. */
function showWhole() {
  const waiting = { opening: "Opening the devices. Nothing is moved.", failed: "The devices are not open. See above.", closed: "The devices are closed." };
  if (state.devices.state !== "open") { setText(at("whole"), waiting[state.devices.state]); return; }
  if (state.camera.failure) { setText(at("whole"), "No new pictures come. See above."); return; }
  if (!picture || !picture.rows.length) { setText(at("whole"), "No picture yet."); return; }
  const off = [...picture.rows.filter((row) => row.good === false).map((row) => row.name), ...cameraSettings().filter(isChanged).map((setting) => setting.name)];
  at("whole").className = `banner ${off.length ? "warn" : "good"}`;
  setText(at("whole"), picture.figures.moving ? "The stage turns." : off.length ? `Not as expected: ${off.join(", ")}.` : "Every figure is as expected. \"Ready for a run?\" makes the checks of a run.");
}

/** Biases of an event camera, or exposure and gain of a frame camera. */
function cameraSettings() {
  const camera = state.camera;
  return !camera ? [] : camera.kind === "frame" ? camera.frame : camera.biases;
}

const isChanged = (setting) => setting.expected !== null && setting.value !== setting.expected;

function showHolder() {
  const { holder, pages } = state.controls;
  const mine = pages[page] ? `page ${pages[page].number}` : "this page";
  const text = holder === page ? `This page (${mine}) has the controls`
    : holder ? `${pages[holder] ? pages[holder].name : "Another page"} has the controls` : "Nobody has the controls";
  setText(at("holder"), text);
  at("take").hidden = holder === page;
}

function showTrouble() {
  const lines = [];
  const { failure } = state.devices;
  if (failure) lines.push(["The devices could not be opened", failure]);
  for (const name of ["stage", "light", "camera"]) {
    if (state[name] && state[name].failure && state[name].failure.kind !== "StillOpening") lines.push([name[0].toUpperCase() + name.slice(1), state[name].failure]);
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
  const pill = at("stage-state");
  const opening = Boolean(stage.failure && stage.failure.kind === "StillOpening");
  setText(pill, opening ? "opening" : !stage.answers ? "does not answer" : stage.work === "home" ? "homing" : moving ? "turning" : stage.homed === false ? "not homed" : "at rest");
  pill.className = `pill ${opening ? "busy" : !stage.answers ? "bad" : moving ? "busy" : stage.homed === false ? "warn" : "good"}`;
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
  setText(at("stage-fault"), stage.faults.join("; "));
  at("home").dataset.off = moving || opening ? "1" : "";
  // What is written down or turned by angles needs a reference.
  const unguarded = stage.homed === false, zero = document.querySelector("[name=what][value=zero]");
  for (const input of [zero, at("propose-pose")]) { input.dataset.off = unguarded ? "1" : ""; input.title = unguarded ? "Press Home first" : ""; }
  if (unguarded) zero.checked = false;
  at("home").classList.toggle("main", unguarded);
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
  const light = state.light, pill = at("light-state");
  if (!light) { setText(pill, ""); return; }
  const opening = Boolean(light.failure && light.failure.kind === "StillOpening");
  setText(pill, opening ? "opening" : light.on === null ? "unknown" : light.on ? "on" : "off");
  pill.className = `pill ${opening ? "busy" : light.on === null ? "bad" : light.on ? "warn" : ""}`;
  keep(at("frequency"), light.frequency_hz);
  keep(at("level"), light.level_percent);
  keep(at("duty"), light.duty_percent);
  at("frequency").closest("label").hidden = light.steady_only;
  at("duty").closest("label").hidden = light.steady_only;
  const r = light.read_back;
  const [low, high] = light.frequency_range_hz;
  const kind = !r ? "" : r.waveform === "steady" ? `steady, ${r.high_v.toFixed(3)} V`
    : `${r.waveform}, ${r.frequency_hz} Hz, duty ${r.duty_percent} %, ${r.low_v.toFixed(3)} V to ${r.high_v.toFixed(3)} V, sync ${r.sync_output ? "on" : "off"}`;
  setText(at("light-read"), `${r ? `Read back: ${kind}.` : ""} ${light.steady_only ? "" : `This lamp follows ${low} Hz to ${high} Hz.`} ${light.faults.join("; ")}`);
}

/** Show a value in a field, unless a person is changing it. */
function keep(input, value) {
  if (document.activeElement === input || input.dataset.dirty === "1") return;
  const text = value === null || value === undefined ? "" : String(value);
  if (input.value !== text) input.value = text;
}

function showBiases() {
  const camera = state.camera, frame = camera && camera.kind === "frame";
  const settings = cameraSettings();
  at("bias-card").hidden = settings.length === 0;
  setText(at("bias-title"), frame ? "Exposure and gain" : "Biases");
  setText(at("bias-note"), frame ? "in the units of the camera's driver, as read back" : "offsets from the factory values, as read back");
  setText(at("bias-what"), frame ? "Exposure, gain" : "Biases");
  const holder = at("biases");
  if (holder.childElementCount !== settings.length) fill(holder, ...settings.map(frame ? frameRow : biasRow));
  settings.forEach((setting, i) => {
    const row = holder.children[i];
    for (const input of row.querySelectorAll("input")) keep(input, setting.value);
    row.classList.toggle("off", isChanged(setting));
    setText(row.querySelector(".note"), `${setting.lowest === undefined ? "" : `${setting.lowest} to ${setting.highest}; `}${setting.expected === null ? "" : `expected: ${setting.expected}, as in the station file`}`);
  });
}

function frameRow(setting) {
  const send = async (event) => {
    const value = number(event.target);
    if (Number.isFinite(value)) await ask("frame", { name: setting.name, value });
    event.target.blur();
    if (state) showBiases();
  };
  return el("div", { class: "bias" }, el("code", {}, setting.name), el("span", {}),
    el("input", { type: "number", step: "any", onchange: send, "aria-label": setting.name }), el("span", { class: "note" }));
}

function biasRow(bias) {
  const send = async (event) => {
    const value = number(event.target);
    if (Number.isFinite(value)) await ask("bias", { name: bias.name, value });
    event.target.dataset.dirty = "";
    event.target.blur();
    if (state) showBiases();
  };
  const range = { min: bias.lowest, max: bias.highest, step: 1, onchange: send, "aria-label": bias.name };
  return el("div", { class: "bias" }, el("code", {}, bias.name), el("input", { type: "range", ...range }),
    el("input", { type: "number", ...range }), el("span", { class: "note" }));
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

function showLog() {
  const holder = at("log"), key = JSON.stringify(state.messages.map((m) => m.number));
  if (holder.dataset.key === key) return;
  holder.dataset.key = key;
  fill(holder, ...state.messages.slice().reverse().map((m) => el("li", {},
    el("time", {}, `${new Date(m.time_s * 1000).toISOString().slice(11, 19)} UTC`), m.text)));
}

// ---------------------------------------------------------------- showing pictures

function showPicture(next) {
  picture = next;
  window.alignStats.latenciesMs.push(Date.now() - next.made_s * 1000);
  if (window.alignStats.latenciesMs.length > 500) window.alignStats.latenciesMs.shift();
  if (next.number === 0) { shownNumber = 0; return; }
  if (next.number < shownNumber) shownNumber = 0; // the devices were opened again
  const f = next.figures;
  if (f.stars_time_s !== window.alignStats.starsTimeS) { window.alignStats.searches += 1; window.alignStats.starsTimeS = f.stars_time_s; }
  if (state) showWhole();
  setText(at("rates"), `Picture ${next.number}${f.image_kind === "none" ? "" : ` (${f.image_kind})`}: ${next.images_per_s.toFixed(1)} pictures/s, stars ${next.stars_per_s.toFixed(1)} times/s; recorded in ${Math.round(next.record_ms)} ms, measured in ${Math.round(next.measure_ms)} ms`);
  showFigures(f, next.rows);
  showTurn(f);
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
      window.alignStats.firstImageMs ??= performance.now();
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

function showTurn(f) {
  const turn = f.turn || {}, wanted = {}, beyond = turn.beyond || {};
  for (const axis of state && state.stage ? state.stage.axes : []) {
    const step = turn.unit === "°" ? turn[axis.name] : null;
    if (axis.name !== "roll" && !(axis.name in beyond) && typeof step === "number" && Math.abs(step) >= 0.05) wanted[axis.name] = Math.round(step * 100) / 100;
  }
  const hand = Object.entries(beyond).map(([axis, angle]) => ` ${axis} would be at ${angle.toFixed(1)}°, beyond its limit: turn the camera in its mount.`).join("");
  const large = Object.values(wanted).some((step) => Math.abs(step) > 5);
  for (const name of Object.keys(wanted)) wanted[name] = Math.max(-5, Math.min(5, wanted[name]));
  const button = at("turn-there"), homed = !(state && state.stage && state.stage.homed === false);
  button.dataset.steps = JSON.stringify(wanted);
  button.dataset.off = homed && Object.keys(wanted).length ? "" : "1";
  button.disabled = button.dataset.barred !== "" || button.dataset.off === "1";
  setText(at("turn-note"), !homed ? "Press Home first: the angles of the stage are not known." : Object.keys(wanted).length
    ? `Turns ${Object.entries(wanted).map(([n, s]) => `${n} by ${s > 0 ? "+" : ""}${s.toFixed(turn.of === "beam" ? 0 : 1)}°`).join(", ")}${large ? "; at most 5° at a time" : ""}.${hand}` : hand);
}

/** What the devices may still do when the link is lost, by what was known last. */
function mayBeOn() {
  if (!state || state.devices.state !== "open") return "";
  const light = state.light && state.light.on !== false ? "The light may still be on. " : "";
  const stage = state.stage && state.stage.work ? "The stage was turning: it stops within a second if Starbench still runs. " : "";
  return `${light}${stage}${light || stage ? "If the program has ended, look at the bench and switch off by hand. " : ""}`;
}

// ---------------------------------------------------------------- checks and files

async function check() {
  setText(at("check-note"), "Checking...");
  const found = await ask("check", { sequence: at("check-sequence").value });
  setText(at("check-note"), "");
  if (!found) return;
  const marks = { good: "✓", bad: "✗", open: "?" }, colours = { good: "good", bad: "bad", open: "warn" };
  fill(at("checks"), ...found.map((c) => el("li", { "data-verdict": c.verdict },
    el("span", { class: `mark ${colours[c.verdict]}`, title: c.verdict }, marks[c.verdict]),
    el("span", {}, el("b", {}, `${c.name}: `), c.found),
    c.remedy ? el("span", { class: "remedy" }, c.remedy) : null)));
  const named = (verdict) => found.filter((c) => c.verdict === verdict).map((c) => c.name).join(", ");
  const bad = named("bad"), open = named("open");
  setText(at("check-note"), [bad && `Not ready: ${bad}.`, open && `Not checked yet: ${open}.`].filter(Boolean).join(" ") || "All passed: ready for a run");
  at("check-note").className = `note ${bad ? "bad" : open ? "warn" : "good"}`;
}

async function loadFiles() {
  files = await get("/files").catch(() => null);
  if (!files) return;
  setText(at("file-note"), files.copy_needed ? `${files.copy_needed} A copy is written to ${files.folder}.` : `Into ${files.station}. Leave the copy's name empty to change the file itself.`);
  const names = [...files.sequences, ...files.shipped];
  fill(at("sequences"), ...names.map((name) => el("option", { value: name })));
  fill(at("check-sequence"), el("option", { value: "" }, "none"), ...names.map((name) => el("option", { value: name }, name)));
}

/** Open a dialog; on a phone it lies at the end of the page. */
function show(dialog) {
  at(dialog).show();
  at(dialog).scrollIntoView({ block: "nearest" });
}

async function propose(body) {
  const found = await ask("propose", body);
  if (!found) return;
  proposal = { ...body, mark: found.mark };
  setText(at("change-title"), found.is_copy ? `New file ${found.file}` : `Change of ${found.file}`);
  fill(at("change-notes"), ...found.notes.map((note) => el("li", {}, note)));
  const lines = found.difference ? found.difference.split("\n") : ["Nothing changes."];
  fill(at("difference"), ...lines.map((line) => el("div", {
    class: /^(\+\+\+|---|@@)/.test(line) ? "place" : line.startsWith("+") ? "plus" : line.startsWith("-") ? "minus" : "",
  }, line || " ")));
  setText(at("change-error"), "");
  at("write").disabled = !found.difference && !found.is_copy;
  show("change");
}

async function write() {
  try {
    const done = (await post("/do/write", { page, ...proposal })).result;
    at("change").close();
    toast(`Written: ${done.file}`);
    loadFiles();
  } catch (error) { setText(at("change-error"), error.message); }
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
at("home").addEventListener("click", () => show("sure"));
at("home-now").addEventListener("click", () => { at("sure").close(); ask("home"); });
at("home-not").addEventListener("click", () => at("sure").close());
at("turn-there").addEventListener("click", () => ask("jog", { steps_deg: JSON.parse(at("turn-there").dataset.steps) }));
at("light-on").addEventListener("click", () => sendLight({ on: true }));
at("light-off").addEventListener("click", () => ask("light", { on: false }));
at("light-form").addEventListener("submit", (event) => { event.preventDefault(); sendLight({}); });
at("forget").addEventListener("click", () => { forgetCurve(); ask("forget"); });
at("check").addEventListener("click", check);
at("propose").addEventListener("click", () => propose({
  kind: "station", copy: at("copy").value.trim(),
  what: [...document.querySelectorAll("[name=what]:checked")].map((box) => box.value),
}));
at("propose-pose").addEventListener("click", () => propose({
  kind: "pose", sequence: at("sequence").value.trim(), name: at("pose-name").value.trim(), copy: at("sequence-copy").value.trim(), light: at("pose-light").checked,
}));
at("write").addEventListener("click", write);
at("cancel").addEventListener("click", () => at("change").close());
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

addEventListener("pagehide", () => navigator.sendBeacon("/do/leave", JSON.stringify({ page })));
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
loadFiles();
get("/focus").then((found) => beginCurve(found.edge_width_px)).catch(() => {});
