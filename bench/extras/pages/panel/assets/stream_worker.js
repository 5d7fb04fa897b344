// One stream for all pages of a browser: a browser opens at most six connections to a server, and each stream keeps one.
// Pages ask for a stream by its address; what comes is passed to all pages that asked for it.
import { listen } from "/assets/bench.js";

const streams = new Map(); // address: {ports, listener, link}

function tell(stream, message) {
  for (const port of stream.ports) port.postMessage(message);
}

function open(port, url) {
  let stream = streams.get(url);
  if (stream) {
    stream.ports.add(port);
    port.postMessage({ kind: "joined" });
    port.postMessage(stream.link);
    return;
  }
  stream = { ports: new Set([port]), listener: null, link: { kind: "link", up: true, lastMs: null } };
  streams.set(url, stream);
  stream.listener = listen(url, { update: (data) => tell(stream, { kind: "update", data }) }, {
    onlink: (up, lastMs) => {
      const changed = stream.link.up !== up || !up;
      stream.link = { kind: "link", up, lastMs };
      if (changed) tell(stream, stream.link);
    },
  });
}

function leave(port, url) {
  const stream = streams.get(url);
  if (!stream) return;
  stream.ports.delete(port);
  if (stream.ports.size === 0) { stream.listener.close(); streams.delete(url); }
}

self.addEventListener("connect", (event) => {
  const port = event.ports[0];
  port.addEventListener("message", ({ data }) => (data.open ? open(port, data.open) : leave(port, data.leave)));
  port.start();
});
