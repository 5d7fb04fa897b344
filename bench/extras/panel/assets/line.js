// The line: a field for the scanner, one button, and PASS or FAIL to be read from afar.
import { durationText, el, fill, get, post, setText, showLink } from "/assets/bench.js";

const LOOK_MS = 500;
const [line, scan, serial, go, word, of, lines, details, simulated] = ["line", "scan", "serial", "go", "word", "of", "lines", "details", "simulated"].map((id) => document.getElementById(id));
let phase = "ready", lastMs = Date.now();

function show(state) {
  const ended = phase === "running" && state.phase !== "running";
  phase = state.phase;
  line.dataset.phase = phase;
  setText(word, state.word);
  setText(of, state.serial && `Camera ${state.serial}`);
  const left = state.left_s ? [`about ${durationText(state.left_s)} left`] : [];
  fill(lines, [...state.lines, ...left].map((text) => el("p", {}, text)));
  details.hidden = !state.run;
  simulated.hidden = !state.simulated;
  if (state.run) details.href = `/run/${encodeURIComponent(state.run)}`;
  const running = phase === "running";
  setText(go, running ? "STOP" : "START");
  go.className = running ? "danger main" : "main";
  serial.disabled = running;
  document.title = `${state.word} – Line – Starbench`;
  if (ended) { serial.value = ""; serial.focus(); }
}

function fault(error) {
  fill(lines, el("p", { class: "banner bad" }, error.message));
  serial.select();
}

scan.addEventListener("submit", async (event) => {
  event.preventDefault();
  go.disabled = true;
  try {
    show(await post(phase === "running" ? "/api/line/stop" : "/api/line/begin", phase === "running" ? {} : { serial: serial.value }));
  } catch (error) {
    fault(error);
  } finally {
    go.disabled = false;
  }
});

async function look() {
  try {
    const state = await get("/api/line");
    if (state.phase !== phase || state.phase === "running") show(state);
    lastMs = Date.now();
    showLink(true);
  } catch {
    showLink(false, lastMs);
  }
  setTimeout(look, LOOK_MS);
}

get("/api/line").then(show).catch(fault).finally(() => setTimeout(look, LOOK_MS));
