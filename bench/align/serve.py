"""Run a session of aligning from the command line, on a page.

Ctrl-C stops the stage at once, from the signal itself. Then the light goes off, the devices are closed, and what each
device confirmed is printed.
"""

from __future__ import annotations

import contextlib
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType

from bench.align.app import align_app
from bench.align.open_bench import Confirmation
from bench.align.page_requests import PageFiles
from bench.align.session import Session
from bench.base.errors import ScriptError, UsageError
from bench.stations.placeholders import find_placeholders
from bench.stations.station import SHIPPED_STATIONS, load_station
from bench.web.server import PageServer, announce_url
from bench.web.tokens import PageToken
from drivers.errors import DriverError
from sequences.reader import find_document
from sequences.settings import OptionSettings

_STOPPED = 0
_NOT_CONFIRMED = 1


def align_on_page(
    station: str,
    settings: Sequence[str] = (),
    *,
    seed: int = 1,
    host: str = "127.0.0.1",
    port: int = 0,
    token: PageToken | None,
    open_browser: bool = True,
) -> int:
    """Serve the align page of a station until Ctrl-C.

    station: Station file, or name of a shipped one.
    settings: Values that replace those of the file, as ``PATH=VALUE``.
    host, port: Address and port of the page; port 0 takes a free one.
    token: The token of the page; None if it needs none.
    open_browser: Whether to open a browser of this computer.
    Returns: Exit status: 0 if every device confirmed a safe state, 1 if not.
    Raises UsageError: If the port is in use, or other computers could use the page without a token.
    Raises DocumentFaults: If the station file is not valid.
    """
    session = make_session(station, settings, seed=seed)
    path = find_document(station, SHIPPED_STATIONS)
    server = PageServer(align_app(session, PageFiles(str(path))), host=host, port=port, token=token)
    opening = threading.Thread(target=_open, args=(session,), name="align-open", daemon=True)

    def ready() -> None:
        announce_url(server.address)
        _print(
            f"Station: {session.station.value.name}. Ctrl-C stops the stage, switches the light off, and ends."
        )
        _stop_at_signals(session)
        opening.start()
        if open_browser:
            server.open_browser()

    try:
        server.serve(ready)
    finally:
        if opening.ident is not None:
            opening.join()
        status = leave(session)
    return status


def make_session(station: str, settings: Sequence[str] = (), *, seed: int = 1) -> Session:
    """Read the station file and make a session; no device is opened yet.

    station: Station file, or name of a shipped one.
    settings: Values that replace those of the file, as ``PATH=VALUE``; ``station.`` may stand before the
      path.
    Raises UsageError: If a setting does not have the form ``PATH=VALUE``.
    Raises DocumentFaults: If the station file is not valid.
    Raises ScriptError: If values of the station file are not filled in yet.
    """
    given = {}
    for text in settings:
        path, equals, value = text.partition("=")
        if not equals:
            raise UsageError(f"{text!r} does not have the form PATH=VALUE.", where="--set")
        given[path.strip().removeprefix("station.")] = value
    located = load_station(station, OptionSettings(given, "--set") if given else None)
    missing = find_placeholders(located.tree)
    if missing:  # a scale that nobody has filled in would turn the stage by a wrong angle
        raise ScriptError([str(fault) for fault in missing])
    return Session(located, seed=seed)


def leave(session: Session) -> int:
    """Leave the bench safe, and print what each device confirmed.

    session: The session; it is closed.
    Returns: Exit status: 0 if every device confirmed, 1 if not.
    """
    with _ignored_signals():
        confirmed = session.close()
    for line in confirmation_lines(confirmed):
        _print(line)
    return _STOPPED if all(one.safe for one in confirmed) else _NOT_CONFIRMED


def confirmation_lines(confirmed: Sequence[Confirmation]) -> list[str]:
    """Return what each device confirmed, as lines for the terminal.

    Returns: One line a device; one line that says so if no device was open.

    Examples
    --------
    >>> confirmation_lines([Confirmation("light", safe=True, text="off, as it reports itself.")])
    ['light: off, as it reports itself.']
    """
    if not confirmed:
        return ["No device was open."]
    return [f"{'' if one.safe else 'CHECK THE BENCH: '}{one.device}: {one.text}" for one in confirmed]


def _open(session: Session) -> None:
    failure = session.open()
    if failure is not None:
        _print(f"The devices could not be opened. {failure.message}")


def _stop_soon(session: Session) -> None:
    """Stop the stage on a thread of its own: a signal handler must not wait."""

    def stop() -> None:
        with contextlib.suppress(DriverError):  # `leave` stops again, and says what was confirmed
            session.stop("because the program ends")

    threading.Thread(target=stop, name="align-signal-stop", daemon=True).start()


def _stop_at_signals(session: Session) -> None:
    """Stop the stage in the handlers of the signals that end the server, before these do their own work."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is None or threading.current_thread() is not threading.main_thread():
            continue
        before = signal.getsignal(number)

        def handle(
            received: int,
            frame: FrameType | None,
            before: Callable[[int, FrameType | None], object] = before,  # type: ignore[assignment]
        ) -> None:
            _stop_soon(session)
            if callable(before):
                before(received, frame)

        signal.signal(number, handle)


@contextmanager
def _ignored_signals() -> Iterator[None]:
    """Let one more Ctrl-C not break off the leaving; the third one ends the process at once."""
    count = 0

    def handle(_number: int, _frame: FrameType | None) -> None:
        nonlocal count
        count += 1
        if count >= 2:
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, handle)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _print(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()
