"""Writes messages into the outbox, and delivers them in one thread beside the work: no server delays a run."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from pathlib import Path

from bench.base.clock import BenchClock
from bench.base.errors import BenchError
from bench.base.home import home_folder
from bench.run.messages.channels import TIMEOUT_S, send
from bench.run.messages.outbox import Message, Outbox
from bench.stations.messages_section import MessagesConfig

_LOOK_S = 5.0  # So late at most a message that waits is tried again
_UNPRINTABLE = re.compile(r"\x1b\[[0-9;]*[A-Za-z]|[\x00-\x08\x0b-\x1f\x7f]")
"""Colours of a terminal, and control characters: an error of another package may have them."""


class Courier:
    """Takes messages, and delivers what waits in the outbox until it is closed; ``say`` shows what it could not do."""

    def __init__(self, clock: BenchClock, say: Callable[[str], None]) -> None:
        self._outbox = Outbox(home_folder())
        self._clock = clock
        self._say = say
        self._wake, self._closing = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._deliver, name="messages", daemon=True)
        self._thread.start()

    def write(
        self,
        station: MessagesConfig,
        occasion: str,
        subject: str,
        text: str,
        *,
        run: str,
        folder: Path,
        key: str,
        place: tuple[int, str] | None = None,
    ) -> None:
        """Keep a message, if the station asks for one at a ``failure``, ``hold`` or ``end``.

        ``key`` is the hash of the journal line that caused it; ``place`` number and hash of the run's line in the
        ledger, or None.
        """
        if occasion not in station.occasions or not station.channels:
            return
        number, head = place or (None, None)
        if place is not None:
            text = f"{text}\nLedger: run {number} of this bench, line {head}"
        subject = " ".join(_printable(subject).split())[:200]
        utc = self._clock.utc_now().isoformat()
        message = Message(
            key,
            occasion,
            subject,
            _printable(text),
            _printable(run),
            _printable(str(folder)),
            utc,
            number,
            head,
        )
        try:
            self._outbox.put(message, station.channels)
        except BenchError as error:
            self._say(f"A message could not be put into the outbox and is lost: {error}")
        self._wake.set()

    def close(self, patience_s: float = 2 * TIMEOUT_S) -> None:
        """Try once more, for ``patience_s`` at most, to deliver what waits; the rest stays."""
        self._closing.set()
        self._wake.set()
        self._thread.join(patience_s)
        try:
            waiting = self._outbox.waiting()
        except BenchError as error:
            self._say(f"Messages cannot be delivered: {error}")
            return
        if waiting:
            self._say(f"Messages not delivered yet: {waiting}. See `starbench messages`.")

    def _deliver(self) -> None:
        closing = False
        try:
            while not closing:
                self._wake.wait(_LOOK_S)
                self._wake.clear()
                closing = (
                    self._closing.is_set()
                )  # read before the last delivery, which then misses no message
                for given_up in self._outbox.deliver(send, self._clock.utc_now):
                    what = f"given up after {given_up.tries} tries: {given_up.last_error}"
                    self._say(
                        f"The message {given_up.message.subject!r} is {what}. See `starbench messages`."
                    )
        except BenchError as error:
            self._say(f"Messages cannot be delivered: {error}")


def _printable(text: str) -> str:
    """Return a text that a mail and a terminal can show."""
    return _UNPRINTABLE.sub("", text).encode(errors="replace").decode()


def courier_of(station: MessagesConfig, clock: BenchClock, say: Callable[[str], None]) -> Courier | None:
    """Return a courier for the messages of a station; None if it names no channel."""
    return Courier(clock, say) if station.channels else None
