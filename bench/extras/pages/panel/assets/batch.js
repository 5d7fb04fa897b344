// A batch: failures first, the queue, the time of each run, and the trend of each parameter.
import { clockText, durationText, el, fill, get, setText } from "/assets/bench.js";
import { follow, legend, number, plot, plural, ticks, verdictPill, withCommands, withUncertainty } from "/assets/own/panel.js";

const at = (id) => document.getElementById(id);
const key = location.pathname.replace(/^\/batch\//, ""), api = `/api/batch/${key}`;
const ENDS = { finished: "var(--plot-1)", failed: "var(--plot-2)", died: "var(--plot-2)", hung: "var(--plot-2)", aborted: "var(--plot-5)", "cut off": "var(--plot-5)", "in progress": "var(--plot-6)", planned: "var(--line)" };
const TONES = { finished: "good", "in progress": "busy", failed: "bad", died: "bad", hung: "bad", aborted: "warn", "cut off": "bad" };
const FAILURES = new Set(["failed", "died", "hung", "cut off"]), NOT_ENDED = new Set(["in progress", "not begun"]), MOST_DONE = 200, MOST_COMING = 60;

const link = (item) => `/run/${key === "." ? "" : `${key}/`}runs/${encodeURIComponent(item)}`;
const name = (item, begun) => (begun ? el("a", { href: link(item) }, item) : item);

function take(batch) {
  fill(at("faults"), batch.fault ? el("p", { class: "banner bad" }, batch.fault) : null);
  if (batch.fault) return;
  const { status, items, totals } = batch, running = status.running;
  setText(at("name"), batch.queue);
  at("simulated").hidden = !batch.simulated;
  at("rehearsal").hidden = !batch.rehearsal;
  const ended = status.ended || "interrupted", failed = items.filter((item) => FAILURES.has(item.how)), working = items.find((item) => item.how === "in progress");
  fill(at("verdict"), verdictPill(running ? "running" : ended, running ? "busy" : failed.length || ended === "interrupted" ? "bad" : "good"));
  setText(at("lead"), [`Batch, begun ${clockText(batch.begun_utc)}`, running && status.end_utc ? `expected to end about ${clockText(status.end_utc)}` : batch.ended_utc && !running ? `last run ended ${clockText(batch.ended_utc)}` : "", !running && status.why].filter(Boolean).join(" · "));
  document.title = `${failed.length ? `${failed.length} failed – ` : ""}${batch.queue} – Starbench`;
  const coming = status.coming.filter((run) => !working || run.item !== working.item);
  const ends = totals.by_end, done = items.filter((item) => item.how === "finished");
  fill(at("figures"), figure(String(ends.finished || 0), "runs with a result", `of ${totals.runs}`), figure(String(failed.length), "runs without a result"), figure(String(coming.length + (working ? 1 : 0)), "in progress or to come"),
    figure(String(totals.poses), `poses, in ${plural(totals.recordings, "recording")}`), figure(String(totals.deviations), "deviations"), figure(durationText(3600 * totals.hours), `so far, ${durationText(3600 * totals.working_hours)} in runs`));
  at("now-card").hidden = !working;
  if (working) fill(at("now"), el("a", { href: link(working.item) }, status.at_work || working.item));
  drawTimeline(items, status, working);
  at("failed-card").hidden = !failed.length;
  fill(at("failed"), failed.map((item) => el("tr", {}, el("td", { class: "name" }, name(item.item, item.begun_utc)), el("td", { "data-label": "End" }, el("span", { class: `pill ${TONES[item.how] || "bad"}` }, item.how)), el("td", { "data-label": "Began", class: "nowrap" }, clockText(item.begun_utc)),
    el("td", { class: "n", "data-label": "Poses" }, poses(item)), el("td", { class: "why" }, withCommands(remarks(item) || "no reason is known")))));
  at("queue-card").hidden = !coming.length && !status.withdrawn.length;
  fill(at("queue"), coming.slice(0, MOST_COMING).map((run) => el("tr", {}, el("td", { class: "name" }, run.item), el("td", { "data-label": "Begins" }, run.begin_utc ? clockText(run.begin_utc) : el("span", { class: "bad" }, "no time left for it")), el("td", { "data-label": "Ends" }, run.end_utc ? clockText(run.end_utc) : ""))));
  setText(at("queue-note"), [coming.length > MOST_COMING ? `the first ${MOST_COMING} of ${coming.length}` : "", status.withdrawn.length ? `withdrawn: ${status.withdrawn.join(", ")}` : ""].filter(Boolean).join("; "));
  drawCameras(batch.cameras, done);
  const others = items.filter((item) => item.begun_utc && !failed.includes(item) && !NOT_ENDED.has(item.how)).reverse();
  fill(at("done"), others.slice(0, MOST_DONE).map(doneRow));
  setText(at("done-note"), others.length > MOST_DONE ? `The newest ${MOST_DONE} of ${others.length}.` : done.length ? "The newest first. ± U, k = 2." : "No run has ended yet.");
}

function figure(value, meaning, note) { return el("div", {}, el("b", {}, value, note ? el("small", {}, ` ${note}`) : null), el("span", {}, meaning)); }
function poses(item) { return item.poses === null ? String(item.accepted) : `${item.accepted} / ${item.poses}`; }

function remarks(item) { return [item.why, item.conformity === "FAIL" ? "FAIL by the limits." : "", ...(item.causes || []), ...item.goals_missed].filter(Boolean).join(" "); }

function doneRow(item) {
  const fx = item.parameters.fx;
  return el("tr", {}, el("td", { class: "name" }, name(item.item, true), item.report ? el("div", { class: "note screen" }, el("a", { href: link(item.item).replace("/run/", "/report/") }, "report")) : null),
    el("td", { "data-label": "End" }, el("span", { class: `pill ${item.how === "finished" && remarks(item) ? "warn" : TONES[item.how] || ""}` }, item.how)), el("td", { "data-label": "Began", class: "nowrap" }, clockText(item.begun_utc)), el("td", { class: "n", "data-label": "Poses" }, poses(item)),
    el("td", { class: "n", "data-label": "RMS, px" }, item.rms_px === null ? "" : number(item.rms_px)), el("td", { class: "n", "data-label": "fx, px" }, fx ? withUncertainty(fx.value, fx.sigma, fx.coverage_factor) : ""), el("td", { class: "why" }, withCommands(remarks(item))));
}

function drawTimeline(items, status, working) {
  const bars = items.flatMap((item) => item.tries.map((one) => ({ job: item.job, item: item.item, begun: Date.parse(one.begun_utc), ended: Date.parse(one.ended_utc), how: one.how })));
  for (const run of status.coming) {
    if (!run.begin_utc) continue;
    const item = items.find((one) => one.item === run.item), now = working && run.item === working.item;
    bars.push({ job: item ? item.job : run.item, item: run.item, begun: Date.parse(run.begin_utc), ended: Date.parse(run.end_utc), how: now ? "in progress" : "planned" });
  }
  if (!bars.length) { fill(at("timeline"), el("p", { class: "note" }, "No run has begun yet.")); return; }
  const jobs = [...new Set(bars.map((bar) => bar.job))], first = Math.min(...bars.map((bar) => bar.begun)), last = Math.max(...bars.map((bar) => bar.ended), first + 1000);
  const width = 1200, each = 26, left = Math.min(220, 24 + 7.2 * Math.max(...jobs.map((job) => job.length))), height = each * jobs.length + 26;
  const across = (ms) => left + ((ms - first) / (last - first)) * (width - left - 12);
  const svg = el("svg", { viewBox: `0 0 ${width} ${height}`, class: "plot timeline", role: "img", "aria-label": "Time of each run", style: "min-width: 620px" });
  for (const [ms, text] of timeTicks(first, last)) svg.append(el("line", { x1: across(ms), x2: across(ms), y1: 0, y2: height - 20, stroke: "var(--line)" }), el("text", { x: across(ms), y: height - 5, "text-anchor": "middle", class: "tick" }, text));
  if (status.running) svg.append(el("line", { x1: across(Date.now()), x2: across(Date.now()), y1: 0, y2: height - 20, stroke: "var(--bad)", "stroke-width": 1.5 }));
  jobs.forEach((job, i) => svg.append(el("text", { x: left - 8, y: i * each + 17, "text-anchor": "end", style: "font-size: 12.5px" }, job)));
  for (const bar of bars) {
    const x = across(bar.begun), rect = el("rect", { x, y: jobs.indexOf(bar.job) * each + 4, width: Math.max(2, across(bar.ended) - x - 0.6), height: each - 8, fill: ENDS[bar.how] || "var(--muted)" });
    const title = document.createElementNS("http://www.w3.org/2000/svg", "title");
    title.textContent = `${bar.item}: ${bar.how}, ${clockText(new Date(bar.begun).toISOString())} to ${clockText(new Date(bar.ended).toISOString())}`;
    rect.append(title);
    svg.append(rect);
  }
  fill(at("timeline"), svg);
  const shown = Object.entries(ENDS).filter(([how]) => bars.some((bar) => bar.how === how));
  fill(at("timeline-legend"), [...legend(shown.map(([how, colour]) => [colour, how])).childNodes]);
}

/** Round times of day, or days, between two moments. */
function timeTicks(first, last) {
  const minute = 60_000, steps = [1, 2, 5, 10, 15, 30, 60, 120, 180, 360, 720, 1440, 2880].map((m) => m * minute), day = 1440 * minute;
  const step = steps.find((one) => (last - first) / one <= 9) || day * Math.ceil((last - first) / (9 * day));
  const form = step >= day ? { day: "numeric", month: "short" } : { hour: "2-digit", minute: "2-digit" };
  const offset = new Date(first).getTimezoneOffset() * minute, found = [];
  for (let ms = Math.ceil((first - offset) / step) * step + offset; ms <= last; ms += step) found.push([ms, new Date(ms).toLocaleString("en-GB", form)]);
  return found;
}

function drawCameras(cameras, done) {
  fill(at("cameras"), cameras.map((camera) => {
    const runs = done.filter((run) => (run.camera || "") === camera.camera && run.model === camera.model);
    if (!camera.parameters.length || !runs.length) return null;
    const begin = Math.min(...runs.map((run) => Date.parse(run.begun_utc)));
    return el("section", { class: "card" }, el("header", {}, el("h2", {}, `Camera ${camera.camera || "without a number"}, ${camera.model}`), el("span", { class: "note" }, `${plural(camera.runs, "run")}; each ± its U; band: weighted mean ± U; hours since the first run`)),
      el("div", { class: "trends" }, camera.parameters.map((trend) => {
        const points = runs.filter((run) => run.parameters[trend.name]).map((run) => [(Date.parse(run.begun_utc) - begin) / 3_600_000, run.parameters[trend.name].value, run.parameters[trend.name].expanded]);
        const scatters = camera.runs > 1 && trend.birge > 1 + 3 / Math.sqrt(2 * (camera.runs - 1));
        const verdict = scatters ? "scatters more than its U" : "agrees within its U";
        return el("div", {}, el("h3", {}, trend.name, " ", el("span", { class: `pill ${scatters ? "warn" : "good"}` }, verdict)), el("p", { class: "note" }, `mean ${withUncertainty(trend.mean, trend.sigma, trend.coverage_factor)}`),
          plot([{ kind: "dots", colour: "var(--plot-1)", points }], { width: 340, height: 150, bands: [[trend.mean - trend.expanded, trend.mean + trend.expanded]], levels: [{ y: trend.mean, colour: "var(--muted)" }], xticks: (a, b) => ticks(a, b, 5).map((h) => [h, `${number(h)} h`]), label: `${trend.name} of each run` }));
      })));
  }));
}

follow(`${api}/events`, take, async () => take(await get(`${api}/state`)));
get(`${api}/state`).catch((error) => { if (error.error) { setText(at("lead"), ""); fill(at("faults"), el("p", { class: "banner bad" }, error.message)); } });
