// Shared by all pages of Starbench: the stream of events, the sign that the link is down, requests, small helpers.
// No global state but the element #link, which is made here.

const SILENT_MS = 6000; // the server sends something every 2 s
const AGAIN_MS = 700;

/** Make an element: el("p", {class: "note", onclick: f}, "text", child). Text is never read as markup. */
export function el(name, attributes = {}, ...children) {
  const svg = ["svg", "g", "path", "circle", "line", "rect", "text", "polyline", "polygon", "title", "tspan"].includes(name);
  const made = svg && name !== "title"
    ? document.createElementNS("http://www.w3.org/2000/svg", name)
    : document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else made.setAttribute(key, value === true ? "" : String(value));
  }
  made.append(...children.flat().filter((child) => child !== null && child !== undefined && child !== false));
  return made;
}

/** Set the text of an element only where it differs, so that a selection survives. */
export function setText(element, text) {
  const shown = text === null || text === undefined ? "" : String(text);
  if (element && element.textContent !== shown) element.textContent = shown;
}

/** Replace the children of an element. */
export function fill(element, ...children) {
  element.replaceChildren(...children.flat().filter((child) => child !== null && child !== undefined && child !== false));
}

/** Send one JSON object; returns the answer's object. Throws an Error whose message says what is wrong and what to do. */
export async function post(url, body) {
  return request(url, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) });
}

/** Ask for one JSON object. Throws as `post`. */
export async function get(url) {
  return request(url, {});
}

async function request(url, options) {
  let answer;
  try {
    answer = await fetch(url, { ...options, headers: { Accept: "application/json", ...options.headers }, credentials: "same-origin" });
  } catch {
    throw new Error("The server does not answer. Check that its command still runs in its terminal.");
  }
  let found = {};
  try { found = await answer.json(); } catch { /* an answer without JSON is an error below */ }
  if (answer.status === 401) location.assign("/sign-in?next=" + encodeURIComponent(location.pathname));
  if (!answer.ok || found.error) {
    const error = found.error || {};
    const message = error.what ? `${error.what} ${error.remedy || ""}`.trim() : `The server answered with status ${answer.status}.`;
    throw Object.assign(new Error(message), { error });
  }
  return found;
}

/** The bar that says that the link is down; `lastMs` is when the last data came, `more` what else to say. */
export function showLink(isUp, lastMs = null, server = "Starbench", more = "") {
  document.body.classList.toggle("stale", !isUp);
  let bar = document.getElementById("link");
  if (isUp) { if (bar) bar.hidden = true; return; }
  if (!bar) {
    bar = el("div", { id: "link", role: "alert" });
    const top = document.querySelector(".top"); // below the header, so that it covers nothing of it
    if (top) top.after(bar); else document.body.prepend(bar);
  }
  const age = lastMs === null ? "" : ` What you see is ${Math.round((Date.now() - lastMs) / 1000)} s old.`;
  setText(bar, `No link to ${server}.${age} ${more}The page tries again by itself.`);
  bar.hidden = false;
}

/**
 * Listen to a stream of events. Reconnects by itself and names the last id, so that nothing is lost.
 *   handlers: an object {eventName: (data, id) => ...}; data is the parsed JSON.
 *   options.after: id from which to begin; options.onlink: (isUp, lastMs) => ..., by default the bar.
 * Returns {close(), lastId()}.
 */
export function listen(url, handlers, options = {}) {
  let source = null, lastId = options.after ?? "", lastMs = null, timer = null, closed = false;
  const onlink = options.onlink || showLink;
  const heard = () => { lastMs = Date.now(); onlink(true, lastMs); };
  const open = () => {
    if (closed) return;
    if (source) source.close();
    const full = new URL(url, location.href);
    if (lastId !== "") full.searchParams.set("after", lastId);
    source = new EventSource(full);
    source.addEventListener("open", heard);
    source.addEventListener("beat", heard);
    for (const [name, handler] of Object.entries(handlers)) {
      source.addEventListener(name, (event) => {
        if (event.lastEventId) lastId = event.lastEventId;
        heard();
        handler(event.data ? JSON.parse(event.data) : null, event.lastEventId);
      });
    }
    source.addEventListener("error", () => {
      onlink(false, lastMs);
      if (source.readyState === EventSource.CLOSED) setTimeout(open, AGAIN_MS); // refused for good: ask anew
    });
  };
  const watch = () => {
    if (lastMs !== null && Date.now() - lastMs > SILENT_MS) { onlink(false, lastMs); open(); }
  };
  open();
  timer = setInterval(watch, SILENT_MS / 2);
  return {
    close() { closed = true; clearInterval(timer); if (source) source.close(); },
    lastId: () => lastId,
  };
}

/** "12 s", "3 min", "2 h 5 min". */
export function durationText(seconds) {
  const s = Math.max(0, Math.round(seconds));
  if (s < 60) return `${s} s`;
  if (s < 3600) return s < 600 ? `${Math.floor(s / 60)} min ${s % 60} s` : `${Math.round(s / 60)} min`;
  const minutes = Math.round(s / 60);
  return `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
}

const format = (options) => new Intl.DateTimeFormat("en-GB", options); // making one is slow, using it is quick
const MINUTES = format({ hour: "2-digit", minute: "2-digit" }), SECONDS = format({ hour: "2-digit", minute: "2-digit", second: "2-digit" });
const DAY = format({ weekday: "short", day: "numeric", month: "short" }), WHOLE_DAY = format({ day: "numeric", month: "short", year: "numeric" });

/** Time of day of an ISO time, by the clock of this computer; with the day if it is another one, or with the year. */
export function clockText(iso, withSeconds = false) {
  const moment = new Date(iso), now = new Date();
  if (Number.isNaN(moment.getTime())) return "";
  const time = (withSeconds ? SECONDS : MINUTES).format(moment);
  if (moment.toDateString() === now.toDateString()) return time;
  const near = Math.abs(now - moment) < 200 * 24 * 3600 * 1000;
  return `${(near ? DAY : WHOLE_DAY).format(moment)} ${time}`;
}

/** Name of the person at this browser, kept in the browser. */
export const person = {
  get() { try { return localStorage.getItem("starbench-person") || ""; } catch { return ""; } },
  set(name) { try { localStorage.setItem("starbench-person", name.trim()); } catch { /* private window: not kept */ } },
};
