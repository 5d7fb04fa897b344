"""Serve a set of pages until Ctrl-C: bind, print the URL as the first line, open a browser, end quietly.

No URL is ever logged. A token made for this start stands behind the ``#`` of the address, which browsers keep.
"""

from __future__ import annotations

import asyncio
import html
import os
import signal
import socket
import sys
import tempfile
import threading
import webbrowser
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol

from bench.base.clock import stopping_signals
from bench.base.errors import UsageError
from bench.extras.pages.web.guard import SIGN_IN, SIGNED_IN, Guard
from bench.extras.pages.web.server_sent import CLOSING
from bench.extras.pages.web.token import PageToken, address_of, is_loopback, require_token

LOOPBACK = "127.0.0.1"
_CLOSE_S = 2  # Streams never end by themselves
REQUEST_S = 10.0  # A request of the pages arrives at once; a slow sender holds a connection
_WAITING = 1024  # Connections that the system keeps until they are accepted; it delays others by a second
ACCEPTED = 64  # Most that one turn of the loop accepts
MOST_CONNECTIONS = 512
"""Half of the 1024 files that a process may often have. Its own limit, uvicorn applies to everybody alike."""


def print_line(text: str) -> None:
    """Print a line at once, such as the URL of the pages."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def serve_pages(app: ASGIApp, *, host: str, port: int, token: PageToken | None, open_browser: bool) -> None:
    """Serve pages until SIGINT, SIGTERM or SIGHUP, then raise `KeyboardInterrupt`. Only for the main thread.

    Port 0 is any free one; ``token`` None: none is needed. The address is printed when the server accepts connections.
    `UsageError`: port in use, strange address, or others could use the pages without a token.
    """
    server = PageServer(app, host=host, port=port, token=token)
    if server.serve(partial(server.welcome, open_browser=open_browser)):
        raise KeyboardInterrupt


class PageServer:
    """A server of pages that is bound to its port."""

    def __init__(
        self, app: ASGIApp, *, host: str = LOOPBACK, port: int = 0, token: PageToken | None = None
    ) -> None:
        require_token(host, token)
        self._socket = _bound_socket(host, port)
        self.port = int(self._socket.getsockname()[1])
        self.url = f"http://{_shown(host)}:{self.port}/"
        self.address = self.url
        """What a person opens: the URL, with the token if this start made it."""
        if token is not None and token.made:
            self.address = f"{self.url}{SIGN_IN.lstrip('/')}#token={token.text}"
        self._in_the_open = not is_loopback(host)
        self._browser_folder: tempfile.TemporaryDirectory[str] | None = None
        guard = Guard(app, host=host, port=self.port, token=token)
        config = uvicorn.Config(
            guard,
            http=_Protocol,
            access_log=False,
            log_config=None,
            log_level="critical",
            lifespan="on",
            ws="none",
            server_header=False,
            proxy_headers=False,  # else a client of this computer says by a header which address it has
            timeout_graceful_shutdown=_CLOSE_S,
            timeout_keep_alive=30,
            backlog=ACCEPTED,
        )
        self._server = _Server(config)

    def serve(
        self, ready: Callable[[], None] = lambda: None, at_signal: Callable[[], None] = lambda: None
    ) -> bool:
        """Serve until a signal, or `stop` from another thread, and return whether it was a signal.

        ``ready`` is called when the server accepts connections, ``at_signal`` in the handler of each
        signal, before anything else; it must not wait.
        """
        self._server.ready, self._server.at_signal = ready, at_signal
        try:
            self._server.run(sockets=[self._socket])
        finally:
            self._socket.close()
            if self._browser_folder is not None:
                self._browser_folder.cleanup()
        return self._server.ended_by_signal

    def welcome(self, *, open_browser: bool) -> None:
        """Print the address, and who can read along; open the pages in a browser if that is wanted."""
        print_line(self.address)
        if self._in_the_open:
            print_line(
                "This connection is not encrypted: who can read the network can read the token. For an encrypted one, "
                f"start with --port {self.port} and without --host, and run on the other computer: "
                f"ssh -L {self.port}:{LOOPBACK}:{self.port} {socket.gethostname()}"
            )
        if open_browser:
            self.open_browser()

    def open_browser(self) -> None:
        """Open the pages by a file that leads on: unlike a process's arguments, other users cannot read it."""
        opened = self.url
        if self.address != self.url:
            self._browser_folder = tempfile.TemporaryDirectory(prefix="starbench-page-")
            path = Path(self._browser_folder.name) / "open.html"
            url = html.escape(self.address)
            path.write_text(f'<!doctype html><meta http-equiv="refresh" content="0; url={url}">', "utf-8")
            opened = path.as_uri()
        threading.Thread(target=webbrowser.open, args=(opened,), daemon=True).start()

    def stop(self) -> None:
        """End the server soon. For any thread."""
        self._server.should_exit = True


class _Protocol(H11Protocol):
    """A connection. It is closed if a request takes too long, or for a new one; uvicorn itself does neither."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for a request."""
        super().connection_made(transport)
        self.address = self.client[0] if self.client is not None else ""
        self.heard_s = self.loop.time()
        self._late = self.loop.call_later(REQUEST_S, transport.close)
        self._make_room()

    def data_received(self, data: bytes) -> None:
        """Take a part of a request."""
        super().data_received(data)
        self.heard_s = self.loop.time()
        if self.cycle is not None and not self.cycle.more_body and not self.cycle.response_complete:
            self._late.cancel()
        elif self._late.cancelled():
            self._late = self.loop.call_later(REQUEST_S, self.transport.close)

    def connection_lost(self, exc: Exception | None) -> None:
        """End the wait."""
        super().connection_lost(exc)
        self._late.cancel()

    def _make_room(self) -> None:
        """Of too many connections, close those of strangers: of the address with most, those silent longest.

        They are as many as one turn accepts: a cookie is seen within three turns, so a new connection lives until then.
        """
        if len(self.connections) <= MOST_CONNECTIONS:
            return
        strangers = [one for one in self.connections if isinstance(one, _Protocol) and one.is_strange()]
        held = Counter(one.address for one in strangers)
        strangers.sort(key=lambda one: (-held[one.address], one.heard_s))
        for one in strangers[:ACCEPTED]:
            self.connections.discard(one)
            one.transport.abort()

    def is_strange(self) -> bool:
        """Return whether its last request was not that of somebody who is signed in."""
        return self.scope is None or not self.scope.get(SIGNED_IN)


class _Server(uvicorn.Server):
    """Uvicorn's server: it ends open streams when it closes, and raises no signal again."""

    def __init__(self, config: uvicorn.Config) -> None:
        super().__init__(config)
        self.ready: Callable[[], None] = lambda: None
        self.at_signal: Callable[[], None] = lambda: None
        self.ended_by_signal = False
        self._closing = asyncio.Event()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to accept connections. Raises whatever the application raised at its start."""
        self.lifespan.state[CLOSING] = self._closing
        await super().startup(sockets)
        for one in sockets or []:
            one.listen(_WAITING)  # asyncio has set this, too, to what one turn accepts
        if self.started and not self.should_exit:
            self.ready()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End the streams, then everything else."""
        self._closing.set()
        await super().shutdown(sockets)

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Turn signals into a request to end, without raising them again afterwards."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return

        def end(number: int, _frame: object) -> None:
            self.at_signal()
            self.force_exit = self.should_exit and number == signal.SIGINT
            self.should_exit = self.ended_by_signal = True

        with stopping_signals(end):
            yield


def _bound_socket(host: str, port: int) -> socket.socket:
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
    except (OSError, UnicodeError) as error:
        raise UsageError(
            "This name or address is not known.", where=f"--host {host}", remedy="Check it, or leave it out."
        ) from error
    bound = socket.socket(family, kind, protocol)
    try:
        if os.name == "posix":  # on Windows this option would let two servers share the port
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.bind(address)
        bound.listen(_WAITING)
    except OSError as error:
        bound.close()
        raise UsageError(
            f"This address or port cannot be used: {error.strerror or error}.",
            where=f"--host {host} --port {port}",
            remedy="Name an address of this computer and another port from 1024 to 65535, or leave both out.",
        ) from error
    return bound


def _shown(host: str) -> str:
    """Return the host as it stands in a URL; the computer's name if all addresses are served."""
    address = address_of(host)
    if address is None:
        return host
    if address.is_unspecified:
        return socket.gethostname()
    return f"[{host}]" if address.version == 6 else host
