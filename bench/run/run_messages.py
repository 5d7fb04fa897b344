"""Messages about one run to people who are away."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from bench.base.clock import BenchClock
from bench.base.errors import BenchError
from bench.record.events import Entering
from bench.run.interlocks import interlock_text
from bench.run.status import read_status, status_text
from bench.stations.messages_section import MessagesConfig

HOLD_NOTIFY_INTERVAL_S = 600.0
"""Shortest time between two notifications about holds by the same interlock, s."""


class Sender(Protocol):
    """Takes the messages of a run and delivers them, also after the run has ended."""

    def is_wanted(self, occasion: str) -> bool:
        """Return whether the station wants messages on ``failure``, ``hold`` or ``end``, and names a channel."""

    def write(
        self,
        occasion: str,
        subject: str,
        text: str,
        *,
        run: str,
        folder: Path,
        key: str,
        place: tuple[int, str] | None = None,
    ) -> None:
        """Keep a message, once for each ``key``; ``place`` is the run's number and hash in the ledger."""

    def close(self) -> None:
        """Try once more to deliver what waits."""


MakeSender = Callable[[MessagesConfig, BenchClock, Callable[[str], None]], Sender]
"""Makes the sender of a station's messages; the last argument prints what could not be sent."""


@dataclass(frozen=True)
class RunMessages:
    """Writes messages about one run; ``say`` prints why one could not be written, and the run continues."""

    sender: Sender | None  # None: the caller watches the run itself
    folder: Path
    say: Callable[[str], None]

    def write(self, occasion: str, what: str, key: str) -> None:
        """Write a message on ``failure``, ``hold`` or ``end``, if wanted; ``key`` is the line's hash."""
        if self.sender is None or not self.sender.is_wanted(occasion):
            return
        try:
            status = read_status(self.folder)
        except BenchError as error:
            self.say(f"A message could not be written: {error}")
            return
        simulated = " (SIMULATED)" if status.simulated else ""
        subject = f"Starbench: run {status.run_id}{simulated} {what}"
        self.sender.write(
            occasion,
            subject,
            status_text(status),
            run=status.run_id,
            folder=self.folder,
            key=key,
            place=status.place,
        )

    def close(self) -> None:
        """Try once more to deliver what waits."""
        if self.sender is not None:
            self.sender.close()


class HoldNotifier:
    """Notifies absent people that a run holds, about the same interlock not too often."""

    def __init__(self, clock: BenchClock, notify: Callable[[str, str, str], None]) -> None:
        self._clock = clock
        self._notify = notify
        self._notified_s: dict[str, float] = {}

    def entering(self, facts: Entering, line: str) -> None:
        """Notify that the run holds. A door that opens again and again does not cause a hundred messages."""
        rule, now_s = str(facts.get("rule", "")), self._clock.monotonic()
        if rule and now_s - self._notified_s.get(rule, -HOLD_NOTIFY_INTERVAL_S) < HOLD_NOTIFY_INTERVAL_S:
            return
        self._notified_s[rule] = now_s
        self._notify("hold", _waits_for(facts), line)


def _waits_for(facts: Entering) -> str:
    """Return what a run that holds waits for."""
    if "rule" in facts:
        return f"is held by the {interlock_text(facts['rule'])} interlock: {facts['why']}"
    return f"is held by {facts['by']}" if "by" in facts else "asks the operator a question"
