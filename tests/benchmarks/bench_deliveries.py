"""How soon a message reaches the working channels of a station while a third one misbehaves, and what becomes of that one.

    python tests/benchmarks/bench_deliveries.py

Real connections on loopback: a mail server and a webhook that work, and one channel that hangs, drips a byte each half a
second, redirects, refuses connections or answers 500. Prints seconds after the message was written.
"""

from __future__ import annotations

import socket
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))

from servers import MailServer, WebServer, serving

from bench.base.clock import BenchClock
from bench.messaging.messages import Courier
from bench.messaging.outbox import Outbox
from bench.stations.station_fields import MailConfig, MessagesConfig, WebhookConfig

MOST_S = 35.0
"""A delivery is given up after 30 s."""


class Bad:
    """A server that takes connections and then misbehaves."""

    def __init__(self, talk: Callable[[socket.socket], None]) -> None:
        self._talk = talk
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._listening.accept()
            except OSError:
                return
            threading.Thread(target=self._answer, args=(connection,), daemon=True).start()

    def _answer(self, connection: socket.socket) -> None:
        try:
            self._talk(connection)
        except OSError:
            return

    def close(self) -> None:
        """Take no more connections."""
        self._listening.close()


def hang(_connection: socket.socket) -> None:
    """Say nothing."""
    time.sleep(2 * MOST_S)


def drip_http(connection: socket.socket) -> None:
    """Send an answer byte by byte, without an end."""
    for byte in b"HTTP/1.1 200 OK\r\nX-Long: " + b"x" * 1000:
        connection.send(bytes([byte]))
        time.sleep(0.5)


def drip_mail(connection: socket.socket) -> None:
    """Send a greeting byte by byte, without an end."""
    for byte in b"220 " + b"x" * 1000:
        connection.send(bytes([byte]))
        time.sleep(0.5)


def redirect(connection: socket.socket) -> None:
    """Send the client elsewhere."""
    connection.recv(65536)
    connection.sendall(b"HTTP/1.1 302 Found\r\nLocation: http://127.0.0.1:9/\r\nContent-Length: 0\r\n\r\n")
    connection.close()


def fail(connection: socket.socket) -> None:
    """Answer that the server has failed."""
    connection.recv(65536)
    connection.sendall(b"HTTP/1.1 500 No\r\nContent-Length: 0\r\n\r\n")
    connection.close()


BAD: dict[str, tuple[str, Callable[[socket.socket], None] | None]] = {
    "all three work": ("", None),
    "webhook hangs": ("web", hang),
    "webhook drips": ("web", drip_http),
    "webhook redirects": ("web", redirect),
    "webhook answers 500": ("web", fail),
    "webhook refuses": ("web", None),
    "mail server hangs": ("mail", hang),
    "mail server drips": ("mail", drip_mail),
}


def measure(name: str, kind: str, talk: Callable[[socket.socket], None] | None) -> str:
    """Write a message to three channels; return the row."""
    bad = Bad(talk or hang)
    if talk is None:
        bad.close()
    with serving(MailServer()) as mail, serving(WebServer()) as web, serving(WebServer()) as third:
        port = mail.server_address[1]
        letter = MailConfig(host="127.0.0.1", port=port, security="none", sender="a@b.c", to=("d@e.f",))
        hooks = [WebhookConfig(url=web.url)]
        channels = {"mail": letter, "webhooks": hooks}
        if kind == "mail":
            channels["mail"] = MailConfig(
                host="127.0.0.1", port=bad.port, security="none", sender="a@b.c", to=("d@e.f",)
            )
            hooks.append(WebhookConfig(url=third.url))
            good = {"webhook 1": lambda: web.posts, "webhook 2": lambda: third.posts}
        else:
            url = f"http://127.0.0.1:{bad.port}/" if kind else third.url
            hooks.append(WebhookConfig(url=url))
            good = {"webhook": lambda: web.posts, "mail": lambda: mail.letters}
        with tempfile.TemporaryDirectory() as folder:
            outbox, said = Outbox(Path(folder)), []
            courier = Courier(MessagesConfig(**channels), outbox, BenchClock(), said.append)
            began_s = time.monotonic()
            courier.write("failure", "subject", "text", run="run", folder=Path(folder), key="a" * 64)
            arrived: dict[str, float] = {}
            told = ""
            while time.monotonic() - began_s < MOST_S:
                now_s = time.monotonic() - began_s
                arrived |= {one: now_s for one, taken in good.items() if one not in arrived and taken()}
                waiting = [one for one in outbox.deliveries() if one.last_error]
                if len(arrived) == len(good) and (waiting or not outbox.waiting()):
                    told = (
                        f"{now_s:5.1f} s: {waiting[0].last_error}"
                        if waiting
                        else f"{now_s:5.1f} s: delivered"
                    )
                    break
                time.sleep(0.01)
            courier.close(0.1)
    bad.close()
    reached = "  ".join(f"{one} {at_s:5.2f} s" for one, at_s in sorted(arrived.items()))
    return f"{name:22}{reached:40} third channel after {told}"


def main() -> None:
    """Print the table."""
    for name, (kind, talk) in BAD.items():
        print(measure(name, kind, talk), flush=True)


if __name__ == "__main__":
    main()
