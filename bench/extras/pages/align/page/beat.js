// Heartbeat of the page, in a worker: a browser slows down the timers of a page that is not in front, but not these.
// The server stops the stage when the heartbeat of the page that moved it ends.
const PERIOD_MS = 200;
let page = "";
onmessage = (event) => { page = event.data; };
setInterval(() => {
  if (!page) return;
  fetch("/do/beat", { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify({ page }) })
    .catch(() => { /* the page itself shows that the link is down */ });
}, PERIOD_MS);
