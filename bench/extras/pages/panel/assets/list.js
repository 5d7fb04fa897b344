// The list of runs and batches: those in progress, failures, the others.
import { clockText, durationText, el, fill, get, setText } from "/assets/bench.js";
import { STATE_WORDS, follow, plural, verdictPill, withCommands } from "/assets/own/panel.js";

const MOST_ROWS = 200, MOST_FAILURES = 20;
const groups = document.getElementById("groups"), filter = document.getElementById("filter");
let shown = null, all = new Set();
const rowsOf = { runs: new Map(), batches: new Map() };

const address = (kind, key) => `/${kind}/${key.split("/").map(encodeURIComponent).join("/")}`;
const matches = (row) => {
  const words = filter.value.trim().toLowerCase().split(/\s+/).filter(Boolean);
  const text = [row.id, row.key, row.queue, row.sequence, row.station, row.camera, row.operator, row.verdict].filter(Boolean).join(" ").toLowerCase();
  return words.every((word) => text.includes(word));
};

function runState(run) {
  if (run.fault) return [el("div", { class: "why bad" }, withCommands(run.fault))];
  const lines = [];
  if (run.running && run.question) lines.push(`Asks: ${run.question.text}`);
  else if (run.holder) lines.push(`Held by ${run.holder}.`);
  else if (run.interlock) lines.push(`Held by the ${run.interlock} interlock.`);
  else if (run.running) lines.push(`${(STATE_WORDS[run.state] || run.state)}${run.pose ? `, pose ${run.pose}` : ""}`);
  else lines.push(...[run.headline, run.why].filter(Boolean));
  if (run.running && !run.leave.safe && !run.question && !run.holder && !run.interlock) lines.push(run.leave.text);
  if (run.deviation_count) lines.push(plural(run.deviation_count, "deviation"));
  return [...run.unsafe.map((line) => el("div", { class: "bad" }, line)), ...lines.map((line) => el("div", {}, withCommands(line)))];
}

function endCell(one) {
  const end = one.running && one.end_utc ? `about ${clockText(one.end_utc)}` : one.ended_utc ? clockText(one.ended_utc) : "–";
  const took = one.started_utc && one.ended_utc ? durationText((new Date(one.ended_utc) - new Date(one.started_utc)) / 1000) : "";
  return el("td", { "data-label": "End", class: "nowrap" }, end, took ? el("div", { class: "note" }, `after ${took}`) : null);
}

function runRow(run) {
  const most = run.most_poses;
  return el("tr", {},
    el("td", { class: "name" }, el("a", { href: address("run", run.key) }, run.id), run.id !== run.key ? el("div", { class: "note" }, run.key) : null,
      el("div", { class: "note" }, [run.sequence, run.camera && `camera ${run.camera}`].filter(Boolean).join(" · ")),
      run.simulated ? el("span", { class: "simulated" }, run.rehearsal ? "REHEARSAL" : "SIMULATED") : null),
    el("td", { "data-label": "State" }, verdictPill(run.verdict, run.tone)),
    el("td", { "data-label": "Poses", class: "n" }, `${run.accepted} of ${run.poses_text}`, run.running ? el("div", { class: "bar" }, el("i", { style: `width: ${most ? (100 * run.accepted) / most : 0}%` })) : null),
    el("td", { "data-label": "Began", class: "nowrap" }, run.started_utc ? clockText(run.started_utc) : "–"),
    endCell(run),
    el("td", { class: "why" }, runState(run)));
}

function batchRow(batch) {
  return el("tr", {},
    el("td", { class: "name" }, el("a", { href: address("batch", batch.key) }, batch.queue), el("div", { class: "note" }, `batch ${batch.key}`), batch.rehearsal || batch.simulated ? el("span", { class: "simulated" }, batch.rehearsal ? "REHEARSAL" : "SIMULATED") : null),
    el("td", { "data-label": "State" }, verdictPill(batch.verdict, batch.tone)),
    el("td", { "data-label": "Runs", class: "n" }, `${batch.done} / ${batch.done + batch.coming}`),
    el("td", { "data-label": "Began", class: "nowrap" }, batch.started_utc ? clockText(batch.started_utc) : "–"),
    endCell(batch),
    el("td", { class: "why" }, batch.current_run ? el("div", {}, batch.current_run) : null,
      batch.failed.length ? el("div", { class: "bad" }, `Without a result: ${batch.failed.slice(0, 6).join(", ")}${batch.failed.length > 6 ? " …" : ""}`) : null,
      !batch.running && batch.why && !batch.failed.length ? el("div", {}, batch.why) : null));
}

function group(name, title, rows, tone, most) {
  if (!rows.length) return null;
  const cut = all.has(name) ? rows : rows.slice(0, most);
  return el("section", { class: "card group" }, el("header", {}, el("h2", { class: tone }, title), el("span", { class: "note" }, String(rows.length))),
    el("div", { class: "scroll" }, el("table", { class: "cards list" },
      el("thead", {}, el("tr", {}, ["Name", "State", "Poses or runs", "Began", "End", "Now, or why"].map((word, i) => el("th", { class: i === 2 ? "n" : null }, word)))),
      el("tbody", {}, cut))),
    cut.length < rows.length ? el("p", { class: "screen" }, el("button", { onclick: () => { all.add(name); draw(); } }, `Show all ${rows.length}`)) : null);
}

function draw() {
  const { faults, root, exists, unread } = shown;
  const runs = [...rowsOf.runs.values()], batches = [...rowsOf.batches.values()];
  setText(document.getElementById("root"), root);
  fill(document.getElementById("faults"), faults.map((fault) => el("p", { class: "banner bad" }, fault)));
  const rows = [...batches.filter(matches).map((b) => ({ ...b, make: batchRow, bad: b.tone === "bad" })), ...runs.filter(matches).map((r) => ({ ...r, make: runRow, bad: r.tone === "bad" || Boolean(r.fault) }))];
  rows.sort((a, b) => (b.started_utc || "").localeCompare(a.started_utc || ""));
  const attention = (row) => (row.tone === "warn" ? 0 : 1);
  const now = rows.filter((row) => row.running).sort((a, b) => attention(a) - attention(b));
  const failed = rows.filter((row) => !row.running && row.bad), rest = rows.filter((row) => !row.running && !row.bad);
  const waiting = document.getElementById("waiting");
  waiting.hidden = rows.length > 0 && !unread;
  setText(waiting, unread ? `${runs.length} of ${runs.length + unread} runs are read.` : filter.value && runs.length + batches.length ? "Nothing has this text." : !exists ? `There is no folder ${root} yet. It appears with the first run.` : faults.length ? "" : "This folder has no runs yet. A run appears here as soon as it begins.");
  const made = (list) => list.map((row) => row.make(row));
  fill(groups, group("now", "In progress", made(now), "", MOST_ROWS), group("failed", "Failed or interrupted", made(failed), "bad", MOST_FAILURES), group("rest", "Ended", made(rest), "", MOST_ROWS));
  document.title = `${now.length ? `${now.length} in progress` : "Runs"}${failed.length ? `, ${failed.length} failed` : ""} – Starbench`;
}

filter.addEventListener("input", () => shown && draw());
// A message has the rows that changed since a version. The whole list is asked for where one is missing in between.
function take(message) {
  if (!message.reset && (!shown || message.version <= shown.version)) return;
  if (!message.reset && message.since > shown.version) return void join();
  for (const [kind, rows] of Object.entries(rowsOf)) {
    if (message.reset) rows.clear();
    for (const key of message.gone) rows.delete(key);
    for (const row of message[kind]) rows.set(row.key, row);
  }
  shown = message;
  draw();
}
async function join() {
  const whole = await get("/api/list/state");
  if (!shown || whole.version >= shown.version) take(whole);
}
follow("/api/list", take, join);
