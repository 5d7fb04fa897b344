// One run: its state, its last recording, its poses, its uncertainty, its log, and the buttons.
import { clockText, durationText, el, fill, get, person, post, setText } from "/assets/bench.js";
import { STATE_WORDS, follow, legend, number, plot, plural, setUpPerson, verdictPill, withCommands, withUncertainty } from "/assets/own/panel.js";

const at = (id) => document.getElementById(id);
const key = location.pathname.replace(/^\/run\//, ""), api = `/api/run/${key}`;
const COLOURS = { accepted: "var(--plot-3)", "at work": "var(--plot-6)", rejected: "var(--plot-2)", lost: "var(--plot-2)", skipped: "var(--plot-5)", planned: "var(--line)" };
const TONES = { accepted: "good", "at work": "busy", rejected: "bad", lost: "bad", skipped: "warn", planned: "" };
const MOST_ROWS = 60, MOST_LOG = 1000, MOST_DOTS = 400;

let line = -1, head = null, coverage = null, forecast = [], final = {}, chosen = null, pictureKey = "", joining = false;
const rows = new Map(), log = [];

// ---------------------------------------------------------------- messages
function take(message) {
  if (message.reset) { rows.clear(); log.length = 0; line = -1; fill(at("log")); }
  else if (line < 0 || message.since > line || message.line < line) { join(); return; }
  for (const row of message.rows) rows.set(row.number, row);
  for (const entry of message.log) if (entry.line > line) log.push(entry);
  if (log.length > MOST_LOG) log.splice(0, log.length - MOST_LOG);
  line = message.line;
  head = message.head;
  coverage = message.coverage ?? coverage;
  forecast = message.forecast ?? forecast;
  final = message.final ?? {};
  draw(message);
}

async function join() {
  if (joining) return;
  joining = true;
  try { take(await get(`${api}/state`)); } catch (error) { fault(error.message); } finally { joining = false; }
}

function fault(text) { fill(at("faults"), el("p", { class: "banner bad" }, text)); }

// ---------------------------------------------------------------- drawing
const seen = {}, drawnAt = {}, waiting = new Set();
const HEAVY_MS = 500;

/** Whether a part of the state is another one than when it was drawn last. */
function changed(part, value) {
  const text = JSON.stringify(value);
  if (seen[part] === text) return false;
  seen[part] = text;
  return true;
}

/** Draw a part at once if it was not drawn lately, else a little later; a hidden page draws when it is looked at. */
function drawSoon(part, work) {
  if (waiting.has(part)) return;
  waiting.add(part);
  setTimeout(() => requestAnimationFrame(() => {
    waiting.delete(part);
    drawnAt[part] = performance.now();
    work();
  }), Math.max(0, HEAVY_MS - (performance.now() - (drawnAt[part] ?? -HEAVY_MS))));
}

function draw(message) {
  const { last, target_deg: target, camera, deviations, decisions, solved, gate_failures: failures, ...rest } = head;
  if (changed("head", [rest, final])) { drawHead(); drawFigures(); drawButtons(); }
  if (message.log.length || message.reset) drawLog();
  if (changed("uncertainty", [decisions, forecast, final, solved, head.ended, head.sealed])) drawSoon("uncertainty", drawUncertainty);
  if (changed("coverage", [coverage?.poses, coverage?.share, head.accepted > 0])) drawSoon("coverage", drawCoverage);
  if (changed("gates", [last, failures])) drawSoon("gates", drawGates);
  if (changed("devices", [target, camera, last, deviations])) drawSoon("devices", drawDevices);
  if (message.rows.length || message.reset) drawSoon("poses", drawPoses);
  if (changed("picture", [last, solved !== null, head.running])) drawSoon("picture", showPicture);
}

// ---------------------------------------------------------------- upper part
function drawHead() {
  setText(at("name"), head.id);
  fill(at("verdict"), verdictPill(head.verdict, head.tone));
  at("simulated").hidden = !head.simulated;
  at("rehearsal").hidden = !head.rehearsal;
  const camera = [head.camera.maker, head.camera.model, head.camera.serial].filter(Boolean).join(" ");
  setText(at("lead"), [head.sequence, head.station, camera && `camera ${camera}`, head.operator && `operator ${head.operator}`].filter(Boolean).join(" · "));
  document.title = `${head.running ? `${head.accepted} of ${head.poses_text} ` : ""}${head.id} – ${head.verdict} – Starbench`;
  const faults = [...head.faults];
  if (head.incomplete) faults.push("The journal ends within a line: the process was killed while it wrote. Nothing that counts is lost; `starbench resume` removes the rest of the line.");
  fill(at("faults"), faults.map((text) => el("p", { class: "banner bad" }, text)),
    head.read_share < 1 ? el("p", { class: "banner busy", id: "reading" }, `Reading the journal: ${Math.floor(100 * head.read_share)} %`) : null,
    head.headline || head.causes.length ? el("div", { class: `banner ${head.causes.length && head.tone === "good" ? "warn" : head.tone}`, id: "calibrated" }, withCommands(head.headline), head.causes.map((text) => el("p", {}, withCommands(text)))) : null,
    head.ended === "failed" || (head.why && !head.running) ? el("div", { class: `banner ${head.tone}` }, withCommands(head.why), head.remedy ? el("p", {}, withCommands(head.remedy)) : null) : null);
  const leave = at("leave"), safe = head.leave.safe;
  leave.hidden = !head.running && safe && (head.tone === "good" || head.ended === "finished");
  leave.className = `banner ${safe ? "good" : head.leave.until_utc ? "warn" : "bad"}`;
  let text = head.leave.text;
  if (head.leave.until_utc) text = `You may leave until about ${clockText(head.leave.until_utc)}: then the run asks a question.`;
  else if (head.running && safe) text = `You may leave. ${text}${head.end_utc ? ` Its end is expected at ${clockText(head.end_utc)}.` : ""}`;
  else if (head.running) text = `Do not leave. ${text}`;
  setText(leave, text);
  const ask = head.question;
  at("ask").hidden = !ask || !head.can.answer;
  if (ask) {
    setText(at("ask-text"), ask.text);
    setText(at("ask-until"), ask.until_utc ? `Without an answer by ${clockText(ask.until_utc, true)} the answer is: ${ask.default}.` : "");
  }
}

function figure(value, meaning, note) {
  return el("div", {}, el("b", {}, value, note ? el("small", {}, ` ${note}`) : null), el("span", {}, meaning));
}

function drawFigures() {
  const most = head.poses_text;
  const left = head.end_utc ? (new Date(head.end_utc) - Date.now()) / 1000 : head.left_s;
  const since = head.state_utc && head.running ? ` for ${durationText((Date.now() - new Date(head.state_utc)) / 1000)}` : "";
  const lastNow = head.decisions.length ? head.decisions[head.decisions.length - 1].now : {};
  const corner = final.worst_corner_px ?? lastNow.worst_corner_px;
  fill(at("figures"),
    figure(STATE_WORDS[head.state] || head.state, head.running || head.ended ? `state${since}` : "its last state"),
    figure(head.pose ? `${head.pose}` : "–", head.pose ? `${head.running ? "pose at work" : "pose that was at work"} (${head.pose_name})` : "no pose at work", `of ${most}`),
    figure(String(head.accepted), `poses recorded${head.skipped ? `, ${head.skipped} skipped` : ""}`, `of ${most}`),
    head.running ? figure(left === null ? "–" : durationText(left), left === null ? "time left" : head.end_utc ? `left; ends about ${clockText(head.end_utc)}` : "of work left; the clock stands") : figure(head.ended_utc ? clockText(head.ended_utc) : "–", "end", head.ended_utc && head.started_utc ? `after ${durationText((new Date(head.ended_utc) - new Date(head.started_utc)) / 1000)}` : ""),
    figure(String(head.recordings), [`recordings`, head.retries ? plural(head.retries, "retry").replace("retrys", "retries") : "no retries", head.resumed ? `resumed ${head.resumed}×` : ""].filter(Boolean).join(", ")),
    corner !== undefined ? figure(`${number(corner)} px`, final.worst_corner_px === undefined ? "U at the worst corner, so far" : "U at the worst corner") : null);
  const share = head.most_poses ? (100 * (head.accepted + head.skipped)) / head.most_poses : 0;
  const bar = at("progress");
  bar.setAttribute("aria-valuenow", String(Math.round(share)));
  bar.firstElementChild.style.width = `${share}%`;
}

// ---------------------------------------------------------------- buttons
function drawButtons() {
  at("controls").hidden = !head.running;
  for (const word of ["hold", "release", "skip", "abort"]) at(word).disabled = !head.can[word];
  at("release").hidden = !head.holder;
  at("hold").hidden = Boolean(head.holder);
  for (const id of ["answer-yes", "answer-no"]) at(id).disabled = !head.can.answer;
}

async function send(command) {
  const told = at("told");
  told.className = "note";
  setText(told, "Sent. The run decides within a moment …");
  try {
    const answer = await post(`${api}/command`, { by: person.get(), ...command });
    told.className = answer.taken ? "good" : "bad";
    fill(told, answer.text.replace(/`starbench tell FOLDER release`/, "it is released").replace(/; --take-over makes you its owner/, ""), !answer.taken && head.holder && head.holder !== person.get() && !command.take_over && command.word !== "abort"
      ? el("button", { style: "margin-left: 10px", onclick: () => send({ ...command, take_over: true }) }, `Take over from ${head.holder}`) : null);
    return answer;
  } catch (error) {
    told.className = "bad";
    setText(told, error.message);
    return null;
  }
}

/** A dialog; resolves to the values of its fields, or to null. Asks for the name where it is missing. */
function ask({ title, text, action, danger, fields = [] }) {
  const dialog = at("dialog"), needsName = !person.get();
  const name = needsName ? el("input", { name: "by", required: true, maxlength: 200, placeholder: "your name" }) : null;
  setText(at("dialog-title"), title);
  setText(at("dialog-text"), text);
  setText(at("dialog-fault"), "");
  fill(at("dialog-fields"), fields, name ? el("label", {}, "Your name", name) : null);
  const button = at("dialog-do");
  setText(button, action);
  button.className = danger ? "danger main" : "main";
  dialog.returnValue = "";
  dialog.showModal();
  (name || (danger ? at("dialog-cancel") : button)).focus();
  return new Promise((resolve) => {
    dialog.addEventListener("close", () => {
      if (dialog.returnValue !== "do") { resolve(null); return; }
      if (name) { person.set(name.value); at("person").value = person.get(); }
      resolve(Object.fromEntries(new FormData(dialog.querySelector("form"))));
    }, { once: true });
  });
}

async function withName(command, title, action) {
  if (!person.get() && !(await ask({ title, text: "The journal keeps who gave a command.", action }))) return;
  await send(command);
}

at("hold").addEventListener("click", () => withName({ word: "hold" }, "Hold the run", "Hold"));
at("release").addEventListener("click", () => withName({ word: "release" }, "Release the run", "Release"));
at("answer-yes").addEventListener("click", () => withName({ word: "answer", answer: "continue" }, "Answer yes", "Yes, continue"));
at("answer-no").addEventListener("click", async () => {
  if (await ask({ title: "Answer no and stop the run?", text: head.question?.text || "", action: "No, stop the run", danger: true })) await send({ word: "answer", answer: "abort" });
});
at("skip").addEventListener("click", async () => {
  const open = [...rows.values()].filter((row) => row.state !== "accepted" && row.state !== "skipped").slice(0, 2000);
  const choice = el("select", { name: "pose" }, open.map((row) => el("option", { value: row.number, selected: row.number === head.pose }, `${row.number}: ${row.name}`)));
  if (!open.length) { setText(at("told"), "No pose is left to skip."); return; }
  const given = await ask({ title: "Skip a pose", text: "It will not be recorded any more. Its recordings are kept, and the report states that it was skipped.", action: "Skip it", fields: [el("label", {}, "Pose", choice)] });
  if (given) await send({ word: "skip", pose: Number(given.pose) });
});
at("abort").addEventListener("click", async () => {
  const given = await ask({ title: `Abort ${head.id}?`, text: `The run ends now: the stage stops, the light goes off, the files are closed. ${head.accepted} recorded poses are kept. It can be resumed in a terminal.`, action: "Abort the run now", danger: true });
  if (given) await send({ word: "abort", confirm: "abort" });
});

// ---------------------------------------------------------------- picture
async function showPicture() {
  const last = head.last;
  // While the run works, the picture of a recording comes with its verdict; until then the one before is shown.
  const shown = chosen || (head.running ? last?.checked ?? last?.before : last?.stored);
  at("picture-last").hidden = !chosen;
  if (!shown) { if (!pictureKey) fill(at("picture"), el("div", { class: "none" }, "No recording yet.")); return; }
  if (head.rehearsal) { fill(at("picture"), el("div", { class: "none" }, "A rehearsal makes no recordings.")); return; }
  const isLast = isOfLast(shown);
  const row = rows.get(shown.pose), solved = Boolean(head.solved);
  const wanted = `${shown.pose}/${shown.attempt}/${solved}/${head.running}`;
  if (wanted === pictureKey) return;
  pictureKey = wanted;
  setText(at("picture-title"), `${chosen ? "P" : isLast ? "Last recording: p" : "Recording before: p"}ose ${shown.pose}${row ? ` (${row.name})` : ""}, attempt ${shown.attempt}`);
  const accepted = row && row.state === "accepted" && row.last === shown.attempt;
  fill(at("picture-verdict"), isLast && last.checked ? el("span", { class: `pill ${last.checked.accepted ? "good" : "bad"}` }, last.checked.accepted ? "accepted" : "rejected") : accepted ? el("span", { class: "pill good" }, "accepted") : null);
  if (!at("picture").firstElementChild) fill(at("picture"), el("div", { class: "none" }, "Making the picture …"));
  await loadPicture(shown, wanted, !head.running);
}

function isOfLast(shown) {
  const last = head.last?.stored;
  return Boolean(last) && shown.pose === last.pose && shown.attempt === last.attempt;
}

async function loadPicture(shown, wanted, measure) {
  const url = `${api}/picture/${shown.pose}/${shown.attempt}`, query = measure ? "measure" : "";
  let found;
  try { found = await get(`${url}?${query}`); } catch (error) { found = { fault: error.message }; }
  if (wanted !== pictureKey) return;
  const box = at("picture"), note = at("picture-note");
  if (!found.size) {
    box.className = "picture empty";
    fill(box, el("div", { class: "none" }, found.absent
      ? [el("div", {}, "The run keeps no picture of this recording while it works."), el("button", { onclick: (event) => { event.target.disabled = true; setText(event.target, "Making it …"); loadPicture(shown, wanted, true); } }, "Make it from the recording")]
      : found.fault || "There is no picture."));
    setText(note, found.absent ? "Making it takes some seconds of this computer at the lowest priority." : "");
    return;
  }
  const [width, height] = found.size;
  const image = el("img", { src: `${url}?png&${query}`, width, height, alt: `Image of pose ${shown.pose}` });
  const over = el("svg", { viewBox: `-0.5 -0.5 ${width} ${height}`, class: "over", "aria-hidden": "true" });
  const scale = found.rms_px ? niceScale((0.02 * width) / found.rms_px) : 0;
  const radius = Math.max(4, width / 160);
  found.stars.forEach(([x, y], i) => {
    over.append(el("circle", { cx: x, cy: y, r: radius, class: "star", "vector-effect": "non-scaling-stroke" }));
    if (found.residuals) {
      const [dx, dy] = found.residuals[i];
      over.append(el("line", { x1: x, y1: y, x2: x + scale * dx, y2: y + scale * dy, class: "residual", "vector-effect": "non-scaling-stroke" }));
    }
  });
  fill(box, image, over);
  drawMarks();
  const parts = [plural(found.stars.length, "star")];
  if (found.residuals) parts.push(`residuals against ${found.residuals_of}, drawn ${scale} times larger, RMS ${number(found.rms_px)} px`);
  if (found.fault) parts.push(found.fault);
  if (isOfLast(shown)) {
    const { checked, utc } = head.last;
    if (checked?.reasons.length) parts.push(`rejected: ${checked.reasons.join("; ")}`);
    if (checked?.measured.edge_width_px) parts.push(`edges of the stars ${number(checked.measured.edge_width_px)} px wide`);
    parts.push(`recorded at ${clockText(utc, true)}`);
  }
  setText(note, `${parts.join("; ")}.`);
}

/** Show or hide the stars over the picture. */
function drawMarks() {
  const box = at("picture"), over = box.querySelector(".over");
  if (!over) return;
  box.className = at("marks").checked ? "picture marked" : "picture";
  over.style.display = at("marks").checked ? "" : "none";
}
at("marks").addEventListener("change", drawMarks);

function niceScale(scale) {
  const power = 10 ** Math.floor(Math.log10(scale));
  return [5, 2, 1].map((m) => m * power).find((s) => s <= scale) || 1;
}

at("picture-last").addEventListener("click", () => { chosen = null; showPicture(); drawPoses(); });

// ---------------------------------------------------------------- poses
function drawPoses() {
  const list = [...rows.values()].sort((a, b) => a.number - b.number);
  const counts = {};
  for (const row of list) counts[row.state] = (counts[row.state] || 0) + 1;
  setText(at("poses-note"), head.most_poses > list.length ? `${list.length} so far, at most ${head.most_poses}` : String(list.length));
  drawStrip(list);
  drawMap(list);
  fill(at("pose-legend"), Object.entries(COLOURS).filter(([state]) => counts[state]).map(([state, colour]) => el("span", {}, el("b", { class: "dot", style: `background: ${colour}` }), `${state} ${counts[state]}`)));
  const bad = list.filter((row) => ["rejected", "lost", "skipped"].includes(row.state) || (row.state === "at work" && row.why));
  const others = list.filter((row) => !bad.includes(row) && row.state !== "planned").reverse();
  const next = list.filter((row) => row.state === "planned");
  const chosenRows = [...bad, ...others, ...next].slice(0, MOST_ROWS);
  fill(at("rows"), chosenRows.map(poseRow));
  setText(at("rows-note"), list.length > MOST_ROWS ? `Failures first, then the newest: ${MOST_ROWS} of ${list.length} poses.` : list.length ? "Failures first, then the newest. A click shows the picture." : "No poses yet.");
}

function poseRow(row) {
  const angles = Object.entries(row.angles_deg).map(([axis, deg]) => `${axis} ${number(deg, 4)}°`).join(", ");
  const pick = row.last ? { class: `pick${chosen?.pose === row.number ? " chosen" : ""}`, tabindex: 0, onclick: () => choose(row), onkeydown: (event) => event.key === "Enter" && choose(row) } : {};
  return el("tr", pick, el("td", { class: "n" }, String(row.number)),
    el("td", { class: "name" }, row.name, angles && angles.replace(/[,°]/g, "") !== row.name ? el("div", { class: "note" }, angles) : null, row.why ? el("div", { class: "why" }, withCommands(row.why)) : null),
    el("td", { "data-label": "State" }, row.state === "at work" && !head.running ? el("span", { class: "pill bad" }, "interrupted") : el("span", { class: `pill ${TONES[row.state]}` }, row.state)),
    el("td", { class: "n", "data-label": "Attempts" }, row.attempts ? String(row.attempts) : ""),
    el("td", { class: "n", "data-label": "Stars" }, row.stars === null ? "" : String(row.stars)));
}

function choose(row) { chosen = { pose: row.number, attempt: row.last }; showPicture(); drawPoses(); }

/** Width of a box, px: a plot that is drawn for it has readable text. */
function widthOf(id) { return Math.max(280, at(id).clientWidth || 420); }

function colourOf(name) { return getComputedStyle(document.documentElement).getPropertyValue(name.slice(4, -1)).trim() || "#888"; }

function drawStrip(list) {
  const canvas = at("strip"), ratio = devicePixelRatio || 1;
  canvas.hidden = list.length < 2;
  if (canvas.hidden || !canvas.clientWidth) return;
  canvas.width = canvas.clientWidth * ratio;
  canvas.height = 18 * ratio;
  const context = canvas.getContext("2d"), each = canvas.width / list.length, gap = each > 6 ? ratio : 0;
  const rank = { planned: 0, accepted: 1, "at work": 2, skipped: 3, rejected: 4, lost: 4 };
  const cells = new Map(); // several poses may share a pixel: the worst one shows
  list.forEach((row, i) => { const x = Math.floor(i * each); if (!cells.has(x) || rank[row.state] > rank[cells.get(x)]) cells.set(x, row.state); });
  const colours = Object.fromEntries(Object.entries(COLOURS).map(([state, name]) => [state, colourOf(name)]));
  for (const [x, state] of cells) { context.fillStyle = colours[state]; context.fillRect(x, 0, Math.max(1, each - gap), canvas.height); }
}

function drawMap(list) {
  const axes = [...new Set(list.flatMap((row) => Object.keys(row.angles_deg)))];
  const [across, up] = axes.includes("pan") && axes.includes("tilt") ? ["pan", "tilt"] : axes;
  if (!across || !up || list.length < 2) { fill(at("map")); return; }
  const step = Math.max(1, Math.ceil(list.length / MOST_DOTS));
  const dots = list.filter((row, i) => i % step === 0 || !["planned", "accepted"].includes(row.state)).slice(0, 2 * MOST_DOTS).filter((row) => across in row.angles_deg && up in row.angles_deg);
  const series = Object.entries(COLOURS).map(([state, colour]) => ({ kind: "dots", colour: state === "planned" ? "var(--muted)" : colour, points: dots.filter((row) => row.state === state).map((row) => [row.angles_deg[across], row.angles_deg[up]]) })).filter((one) => one.points.length);
  fill(at("map"), plot(series, { width: widthOf("map"), height: 210, xlabel: `${across}, deg (up: ${up}, deg)${step > 1 ? `; one dot for ${step} poses` : ""}`, label: "Angles of the poses" }));
}

// ---------------------------------------------------------------- plots and tables
function drawUncertainty() {
  const parts = [];
  const goals = head.decisions.length ? head.decisions[head.decisions.length - 1].wanted : {};
  const names = [["worst_corner_px", "U at the worst corner, px"], ["expanded_fx_px", "U(fx), px"]];
  for (const [name, title] of names) {
    const reached = head.decisions.filter((one) => Number.isFinite(one.now[name])).map((one) => [one.poses, one.now[name]]);
    const expected = forecast.filter((one) => Number.isFinite(one.now[name])).map((one) => [one.poses, one.now[name]]);
    const chosenNext = head.decisions.filter((one) => Number.isFinite(one.chosen?.expected[name])).map((one) => [one.poses + 1, one.chosen.expected[name]]);
    if (!reached.length && !expected.length) {
      if (final[name] !== undefined) parts.push(el("p", {}, `${title.replace(", px", "")}: `, el("b", {}, `${number(final[name])} px`)));
      continue;
    }
    const levels = goals[name] ? [{ y: goals[name], label: `goal ${number(goals[name])} px`, dashed: true }] : [];
    if (final[name] !== undefined) levels.push({ y: final[name], label: `result ${number(final[name])} px`, colour: "var(--plot-1)" });
    parts.push(el("div", {}, el("h3", {}, title), plot([
      { kind: "dashed", colour: "var(--muted)", points: expected }, { kind: "dots", colour: "var(--plot-5)", points: chosenNext }, { kind: "line", colour: "var(--plot-1)", points: reached },
    ], { width: widthOf("uncertainty"), log: true, height: 170, whole: true, xlabel: "poses in the calibration", label: title, levels })));
  }
  const solved = head.solved, k = final.coverage_factor ?? 2;
  setText(at("uncertainty-note"), `U, k = ${number(k)}, pose by pose`);
  if (parts.length) parts.push(legend([["var(--muted)", "expected by the plan", true], ...(head.decisions.length ? [["var(--plot-1)", "reached"], ["var(--plot-5)", "expected with the next pose"]] : [])]));
  if (solved) parts.push(el("div", { class: "scroll" }, el("table", {}, el("thead", {}, el("tr", {}, el("th", {}, `Result (${solved.model}, RMS ${number(solved.rms_px)} px)`), el("th", { class: "n" }, "value ± U"))),
    el("tbody", {}, Object.entries(solved.values).filter(([name]) => name in solved.sigma).slice(0, 12).map(([name, value]) => el("tr", {}, el("td", {}, name), el("td", { class: "n" }, withUncertainty(value, solved.sigma[name], solved.coverage_factors?.[name] ?? k))))))));
  if (head.ended === "finished" && head.sealed) parts.push(el("p", { class: "screen" }, el("a", { class: "button", href: `/report/${key}` }, "Open the report")));
  if (head.evidence) parts.push(el("p", { class: "note" }, head.evidence));
  const decided = head.decisions.at(-1), why = decided?.chosen?.why || decided?.why || decided?.problem;
  if (why) parts.push(el("p", { class: "note" }, withCommands(why)));
  if (!parts.length) parts.push(el("p", { class: "note" }, "Nothing is known before the calibration: the station file states nothing to expect, or the forecast is not made yet."));
  fill(at("uncertainty"), parts);
}

function drawCoverage() {
  const box = at("coverage");
  if (!coverage) { fill(box, el("p", { class: "note" }, head.rehearsal ? "A rehearsal makes no recordings." : head.accepted ? "The coverage is being counted …" : "No accepted pose yet.")); return; }
  const [columns, lines] = coverage.cells, [width, height] = coverage.size;
  setText(at("coverage-note"), `${Math.round(100 * coverage.share)} % of the image has stars of accepted poses`);
  const most = Math.max(...coverage.counts, 1);
  const svg = el("svg", { viewBox: `0 0 ${width} ${height}`, class: "coverage", role: "img", "aria-label": "Stars of accepted poses over the image" });
  coverage.counts.forEach((count, i) => {
    if (!count) return;
    const opacity = 0.25 + 0.75 * (Math.log(1 + count) / Math.log(1 + most));
    svg.append(el("rect", { x: ((i % columns) * width) / columns, y: (Math.floor(i / columns) * height) / lines, width: width / columns + 0.5, height: height / lines + 0.5, fill: "var(--plot-1)", "fill-opacity": opacity.toFixed(3) }));
  });
  fill(box, svg, el("p", { class: "note" }, `Number of stars in each of ${columns} x ${lines} cells, at most ${most}, from ${plural(coverage.poses, "accepted pose")}. Their places follow from the grid of each pose, without the distortion of the lens.`));
}

function drawGates() {
  const last = head.last, gates = (last?.checked ?? last?.before)?.gates || [];
  setText(at("gates-note"), !last ? "" : last.checked ? `pose ${last.stored.pose}, attempt ${last.stored.attempt}` : "of the recording before");
  const order = { fail: 0, marginal: 1, pass: 2 };
  fill(at("gates"), [...gates].sort((a, b) => order[a.verdict] - order[b.verdict]).map((gate) => el("tr", {}, el("td", { class: "name" }, gate.name, head.gate_failures[gate.name] ? el("div", { class: "why" }, `rejected ${plural(head.gate_failures[gate.name], "recording")}`) : null),
    el("td", { class: "n" }, `${number(gate.value)} ${gate.unit}`), el("td", { class: "n", "data-label": "limit" }, gate.limit), el("td", {}, el("span", { class: `pill ${{ pass: "good", marginal: "warn", fail: "bad" }[gate.verdict] || ""}` }, gate.verdict)))),
    gates.length ? null : el("tr", {}, el("td", { colspan: 4, class: "note" }, "No recording was judged yet.")));
}

function drawDevices() {
  const facts = [], { utc, stored, checked } = head.last || {};
  if (Object.keys(stored?.light || {}).length) {
    const s = stored.light;
    facts.push(["Light", [s.waveform, s.frequency_hz && `${number(s.frequency_hz, 6)} Hz`, s.duty_percent && `${number(s.duty_percent)} % duty`, s.high_v !== undefined && s.low_v !== undefined ? `${number(s.low_v)} to ${number(s.high_v)} V` : null].filter(Boolean).join(", ") + ` (read back at ${clockText(utc, true)})`]);
  }
  const degrees = (angles) => Object.entries(angles).filter(([axis]) => !axis.endsWith("_encoder")).map(([axis, deg]) => `${axis} ${Number(deg).toFixed(4)}°`).join(", ");
  if (Object.keys(head.target_deg).length) facts.push(["Stage, target", degrees(head.target_deg)]);
  if (Object.keys(stored?.measured_deg || {}).length) facts.push(["Stage, read back", `${degrees(stored.measured_deg)} (${clockText(utc, true)})`]);
  const camera = head.camera, recorded = stored?.facts || {};
  if (camera.serial) facts.push(["Camera", [camera.maker, camera.model, camera.sensor, `serial ${camera.serial}`, camera.lens].filter(Boolean).join(", ")]);
  if (Number.isFinite(recorded.temperature_c)) facts.push(["Temperature", `${number(recorded.temperature_c)} °C`]);
  if (Number.isFinite(recorded.events) && recorded.duration_s) facts.push(["Event rate", `${number(recorded.events / recorded.duration_s / 1e6)} million events/s`]);
  if (checked?.measured.flicker_hz) facts.push(["Flicker", `${number(checked.measured.flicker_hz, 7)} Hz, measured`]);
  if (!facts.length) facts.push(["Devices", "not seen yet"]);
  fill(at("devices"), facts.flatMap(([name, text]) => [el("dt", {}, name), el("dd", {}, text)]));
  at("deviations-card").hidden = !head.deviation_count;
  fill(at("deviations"), head.deviation_count > head.deviations.length ? el("li", { class: "note" }, `The last ${head.deviations.length} of ${head.deviation_count}`) : null, head.deviations.map((text) => el("li", {}, text)));
}

// ---------------------------------------------------------------- log
function drawLog() {
  const list = at("log"), atEnd = list.scrollHeight - list.scrollTop - list.clientHeight < 40;
  const first = log.length ? log[0].line : 0, last = list.lastElementChild ? Number(list.lastElementChild.dataset.line) : 0;
  const make = (entry) => el("li", { "data-line": entry.line, class: entry.tone }, el("time", { datetime: entry.utc, title: entry.utc }, clockText(entry.utc, true)), entry.text);
  while (list.firstElementChild && Number(list.firstElementChild.dataset.line) < first) list.firstElementChild.remove();
  const earlier = list.firstElementChild ? Number(list.firstElementChild.dataset.line) : Infinity;
  if (!log.length) fill(list);
  else if (first < earlier) fill(list, log.map(make)); // older lines were asked for, or there is nothing yet
  else {
    let begin = log.length;
    while (begin > 0 && log[begin - 1].line > last) begin -= 1;
    list.append(...log.slice(begin).map(make));
  }
  at("earlier").hidden = !log.length || log[0].line <= 1 || log.length >= MOST_LOG;
  if (atEnd || !last) list.scrollTop = list.scrollHeight;
}

at("earlier").addEventListener("click", async () => {
  try {
    const found = await get(`${api}/log?before=${log[0].line}`);
    if (!found.log.length) { at("earlier").hidden = true; return; }
    log.unshift(...found.log);
    drawLog();
    at("log").scrollTop = 0;
  } catch (error) { fault(error.message); }
});

// ---------------------------------------------------------------- begin
setUpPerson(at("person"));
setInterval(() => head && head.running && drawFigures(), 1000);
addEventListener("resize", () => { if (!head) return; drawSoon("poses", drawPoses); drawSoon("uncertainty", drawUncertainty); });
follow(`${api}/events`, take, join);
get(`${api}/log?before=1`).catch((error) => { if (error.error) { setText(at("lead"), ""); fault(error.message); } }); // an address of no run: say so
