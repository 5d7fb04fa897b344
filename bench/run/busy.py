"""Note in the journal when the computer is too busy for the run: no device is touched."""

from __future__ import annotations

from bench.base.clock import BenchClock
from bench.records.events import Event
from bench.records.run_log import RunLog

WINDOW_S = 10.0
"""The lateness of this time is looked at, s."""
BUSY_S = 3.0
"""A computer is too busy if it was late by this time in a window, s."""
REPEAT_S = 60.0
"""The journal says so at most once in this time, s."""


class BusyWatch:
    """Writes ``computer_busy`` when the computer is too busy.

    log: Where it is written.
    """

    def __init__(self, log: RunLog, clock: BenchClock) -> None:
        self._log = log
        self._clock = clock
        self._began_s = clock.monotonic()
        self._lost_s = float(clock.lateness().get("lost_s", 0.0))
        self._noted_s = -REPEAT_S

    def look(self) -> None:
        """Look whether a window is over, and whether the computer was too busy in it."""
        now_s = self._clock.monotonic()
        window_s = now_s - self._began_s
        if window_s < WINDOW_S:
            return
        lateness = self._clock.lateness()
        lost_s = float(lateness.get("lost_s", 0.0))
        late_s, self._lost_s, self._began_s = lost_s - self._lost_s, lost_s, now_s
        if late_s >= BUSY_S * window_s / WINDOW_S and now_s - self._noted_s >= REPEAT_S:
            self._noted_s = now_s
            self._log.write(
                Event.COMPUTER_BUSY, late_s=round(late_s, 3), window_s=round(window_s, 3), lateness=lateness
            )
