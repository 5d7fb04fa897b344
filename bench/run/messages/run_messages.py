"""Messages about one run to people who are away."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from bench.base.clock import BenchClock
from bench.base.errors import BenchError
from bench.record.events import Entering
from bench.run.interlocks import interlock_text
from bench.run.messages.courier import courier_of
from bench.run.status import read_status, status_text
from bench.stations.messages_section import WEBHOOKS_LEFT, MessagesConfig

HOLD_NOTIFY_INTERVAL_S = 600.0
"""Shortest time between two notifications about holds by the same interlock, s: more often, nobody reads them."""


class RunMessages:
    """Writes messages about one run; ``say`` prints why one could not be written, and the run continues."""

    def __init__(
        self, station: MessagesConfig, folder: Path, clock: BenchClock, say: Callable[[str], None]
    ) -> None:
        if station.webhooks is not None:  # of a run that began when they were served
            say(f"No webhook is told: {WEBHOOKS_LEFT}.")
        self._station = station
        self._folder = folder
        self._say = say
        self._courier = courier_of(station, clock, say)

    def write(self, occasion: str, what: str, key: str) -> None:
        """Write a message on ``failure``, ``hold`` or ``end``, if wanted; ``key`` is the line's hash."""
        if self._courier is None or occasion not in self._station.occasions:
            return
        try:
            status = read_status(self._folder)
        except BenchError as error:
            self._say(f"A message could not be written: {error}")
            return
        simulated = " (SIMULATED)" if status.simulated else ""
        subject = f"Starbench: run {status.run_id}{simulated} {what}"
        self._courier.write(
            self._station,
            occasion,
            subject,
            status_text(status),
            run=status.run_id,
            folder=self._folder,
            key=key,
            place=status.place,
        )

    def close(self) -> None:
        """Try once more to deliver what waits."""
        if self._courier is not None:
            self._courier.close()


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
