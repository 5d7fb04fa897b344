"""Writes messages into the outbox, and delivers them in one thread beside the work: no server delays a run."""

from __future__ import annotations

import queue
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

FIRST_PAUSE_S = 5.0  # Doubled after each try that failed
LONGEST_PAUSE_S = 3600.0  # A network that is back is used within an hour
_UNPRINTABLE = re.compile(r"\x1b\[[0-9;]*[A-Za-z]|[\x00-\x08\x0b-\x1f\x7f]")
"""Colours of a terminal, and control characters: an error of another package may have them."""


class Courier:
    """Takes messages, and delivers what waits in the outbox until it is closed; ``say`` shows what it could not do."""

    def __init__(self, clock: BenchClock, say: Callable[[str], None]) -> None:
        self._outbox = Outbox(home_folder())
        self._clock = clock
        self._say = say
        self._rounds: queue.SimpleQueue[bool] = queue.SimpleQueue()  # False: there is no other one
        self._rounds.put(True)  # what waits from before
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
        if place is not None:
            text = f"{text}\nLedger: run {place[0]} of this bench, line {place[1]}"
        subject = " ".join(_printable(subject).split())[:200]
        utc = self._clock.utc_now().isoformat()
        message = Message(
            key, occasion, subject, _printable(text), _printable(run), _printable(str(folder)), utc
        )
        try:
            self._outbox.put(message, station.channels)
        except BenchError as error:
            self._say(f"A message could not be put into the outbox and is lost: {error}")
        self._rounds.put(True)

    def close(self, patience_s: float = 2 * TIMEOUT_S) -> None:
        """Wait, for ``patience_s`` at most, until each message was tried once; the rest stays."""
        self._rounds.put(False)
        self._thread.join(patience_s)
        try:
            unsent = self._outbox.unsent()
        except BenchError as error:
            self._say(f"Messages cannot be delivered: {error}")
            return
        if unsent:
            self._say(f"Messages not delivered yet: {unsent}. See `starbench messages`.")

    def _deliver(self) -> None:
        pause_s = FIRST_PAUSE_S
        try:
            while self._next_round(pause_s):
                failed = self._outbox.deliver(send, self._clock.utc_now)
                pause_s = min(2 * pause_s, LONGEST_PAUSE_S) if failed else FIRST_PAUSE_S
        except BenchError as error:
            self._say(f"Messages cannot be delivered: {error}")

    def _next_round(self, pause_s: float) -> bool:
        """Wait for a message, or for the end of a pause; return False once the courier is closed."""
        try:
            return self._rounds.get(timeout=pause_s)
        except queue.Empty:
            return True


def _printable(text: str) -> str:
    """Return a text that a mail and a terminal can show."""
    return _UNPRINTABLE.sub("", text).encode(errors="replace").decode()


def courier_of(station: MessagesConfig, clock: BenchClock, say: Callable[[str], None]) -> Courier | None:
    """Return a courier for the messages of a station; None if it names no channel."""
    return Courier(clock, say) if station.channels else None
