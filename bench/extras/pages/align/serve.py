"""Run a session of aligning from the command line, on a page; Ctrl-C stops the stage from the signal itself."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Sequence
from functools import partial

from bench.base.clock import stop_on_signals
from bench.base.errors import ScriptError
from bench.extras.pages.align.align_app import align_app
from bench.extras.pages.align.session import Session
from bench.extras.pages.web.server import PageServer, print_line
from bench.extras.pages.web.token import PageToken
from bench.record.device_end import DeviceEnd
from bench.stations.placeholders import find_placeholders
from bench.stations.station import load_station
from drivers.errors import DriverError


def align_on_page(
    station: str,
    *,
    host: str = "127.0.0.1",
    port: int = 0,
    token: PageToken | None,
    open_browser: bool = True,
) -> int:
    """Serve the align page of a station until Ctrl-C; return 0 if every device confirmed a safe state, else 1.

    Other computers need a ``token`` (else `UsageError`).
    """
    session = make_session(station)
    server = PageServer(align_app(session), host=host, port=port, token=token)
    opening = threading.Thread(target=_open, args=(session,), name="align-open", daemon=True)

    def ready() -> None:
        server.welcome(open_browser=open_browser)
        print_line(
            f"Station: {session.station.value.name}. Ctrl-C stops the stage, switches the light off, and ends."
        )
        opening.start()

    try:
        server.serve(ready, partial(_stop_soon, session))
    finally:
        if opening.ident is not None:
            opening.join()
        status = leave(session)
    return status


def make_session(station: str) -> Session:
    """Make a session, no device open yet."""
    located = load_station(station)
    missing = find_placeholders(located.tree)
    if missing:  # a scale that nobody has filled in would turn the stage by a wrong angle
        raise ScriptError([str(fault) for fault in missing])
    return Session(located)


def leave(session: Session) -> int:
    """Leave the bench safe, and print what each device confirmed; exit status 1 if one did not."""
    with stop_on_signals(lambda _why: None, received=1):  # one more Ctrl-C does not break off the leaving
        confirmed = session.close()
    for line in confirmation_lines(confirmed):
        print_line(line)
    return 0 if all(end.state == "confirmed safe" for end in confirmed) else 1


def confirmation_lines(confirmed: Sequence[DeviceEnd]) -> list[str]:
    """Return what each device confirmed, a line each, for the terminal; one line if no device was open.

    >>> confirmation_lines([DeviceEnd("light", "confirmed safe", "off, as it reports itself.")])
    ['light: confirmed safe: off, as it reports itself.']
    """
    if not confirmed:
        return ["No device was open."]
    return [f"{'' if end.state == 'confirmed safe' else 'CHECK THE BENCH: '}{end.text}" for end in confirmed]


def _open(session: Session) -> None:
    failure = session.open()
    if failure is not None:
        print_line(f"The devices could not be opened. {failure.message}")


def _stop_soon(session: Session) -> None:
    """Stop the stage on a thread of its own: a signal handler must not wait."""

    def stop() -> None:
        with contextlib.suppress(DriverError):  # `leave` stops again, and says what was confirmed
            session.stop()

    threading.Thread(target=stop, name="align-signal-stop", daemon=True).start()
