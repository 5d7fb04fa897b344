"""Serve a set of pages until Ctrl-C: bind, print the URL as the first line, open a browser, end quietly.

No URL is ever logged. A token made for this start stands behind the ``#`` of the address, which browsers keep.
"""

from __future__ import annotations

import asyncio
import errno
import html
import os
import signal
import socket
import sys
import tempfile
import threading
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import uvicorn
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from bench.base.clock import stopping_signals
from bench.base.errors import UsageError
from bench.web.guard import SIGN_IN, Guard
from bench.web.server_sent import CLOSING
from bench.web.token import PageToken, address_of, require_token

LOOPBACK = "127.0.0.1"
_CLOSE_S = 2  # Streams never end by themselves
HEAD_S = 10.0  # A request's head arrives at once; a slow sender holds a connection
_BACKLOG = 128  # That of Python's own servers


def print_line(text: str) -> None:
    """Print a line at once, such as the URL of the pages."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def serve_pages(
    app: ASGIApp,
    *,
    host: str = LOOPBACK,
    port: int = 0,
    token: PageToken | None = None,
    open_browser: bool = True,
    announce: Callable[[str], None] = print_line,
) -> None:
    """Serve pages until SIGINT, SIGTERM or SIGHUP, then raise `KeyboardInterrupt`. Only for the main thread.

    Port 0 is any free one; ``token`` None: none is needed. ``announce`` gets the URL when the server accepts
    connections. `UsageError`: port in use, strange address, or others could use the pages without a token.
    """
    server = PageServer(app, host=host, port=port, token=token)

    def ready() -> None:
        announce(server.address)
        if open_browser:
            server.open_browser()

    server.serve(ready)
    if server.ended_by_signal:
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
        """What is printed for a person: the URL, with the token if this start made it."""
        if token is not None and token.made:
            self.address = f"{self.url}{SIGN_IN.lstrip('/')}#token={token.text}"
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
            timeout_graceful_shutdown=_CLOSE_S,
            timeout_keep_alive=30,
        )
        self._server = _Server(config)

    @property
    def ended_by_signal(self) -> bool:
        """Whether a signal has ended the server."""
        return self._server.ended_by_signal

    def serve(
        self, ready: Callable[[], None] = lambda: None, at_signal: Callable[[], None] = lambda: None
    ) -> None:
        """Serve until a signal, or `stop` from another thread; ``ready`` is called when it accepts connections.

        ``at_signal`` is called in the handler of each signal, before anything else; it must not wait.
        """
        self._server.ready, self._server.at_signal = ready, at_signal
        try:
            self._server.run(sockets=[self._socket])
        finally:
            self._socket.close()
            if self._browser_folder is not None:
                self._browser_folder.cleanup()

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
    """A connection; it is closed if the head of a request takes too long. Uvicorn itself waits for ever."""

    _late: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for a request."""
        super().connection_made(transport)
        self._late = self.loop.call_later(HEAD_S, transport.close)

    def data_received(self, data: bytes) -> None:
        """Take a part of a request."""
        super().data_received(data)
        working = self.cycle is not None and not self.cycle.response_complete
        if working and self._late is not None:
            self._late.cancel()
            self._late = None
        elif not working and self._late is None:
            self._late = self.loop.call_later(HEAD_S, self.transport.close)

    def connection_lost(self, exc: Exception | None) -> None:
        """End the wait."""
        super().connection_lost(exc)
        if self._late is not None:
            self._late.cancel()


class _Server(uvicorn.Server):
    """Uvicorn's server: it ends open streams when it closes, and raises no signal again."""

    def __init__(self, config: uvicorn.Config) -> None:
        super().__init__(config)
        self.ready: Callable[[], None] = lambda: None
        self.at_signal: Callable[[], None] = lambda: None
        self.ended_by_signal = False
        self._closing: asyncio.Event | None = None

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to accept connections. Raises whatever the application raised at its start."""
        self._closing = closing = asyncio.Event()
        inner = self.config.loaded_app

        async def app(scope: Scope, receive: Receive, send: Send) -> None:
            scope[CLOSING] = closing
            await inner(scope, receive, send)

        self.config.loaded_app = app
        await super().startup(sockets)
        if self.started and not self.should_exit:
            self.ready()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End the streams, then everything else."""
        if self._closing is not None:
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
        bound.listen(_BACKLOG)
    except OSError as error:
        bound.close()
        raise _bind_error(error, host, port) from error
    return bound


def _bind_error(error: OSError, host: str, port: int) -> UsageError:
    if error.errno == errno.EADDRINUSE:
        return UsageError(
            f"Port {port} is in use by another program.",
            where=f"--port {port}",
            remedy="Name another port, or leave --port out: a free one is then chosen.",
        )
    if error.errno == errno.EACCES:
        return UsageError(
            f"Port {port} needs the rights of the system's administrator.",
            where=f"--port {port}",
            remedy="Name a port from 1024 to 65535.",
        )
    return UsageError(
        f"This address cannot be used: {error.strerror or error}.",
        where=f"--host {host}",
        remedy="Name an address of this computer, or leave --host out.",
    )


def _shown(host: str) -> str:
    """Return the host as it stands in a URL; the computer's name if all addresses are served."""
    address = address_of(host)
    if address is None:
        return host
    if address.is_unspecified:
        return socket.gethostname()
    return f"[{host}]" if address.version == 6 else host
