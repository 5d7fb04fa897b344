"""The bench's clock: every wait of a run goes through it, so that a request to stop ends every wait.

Stop does not travel through the queue of the work: a signal handler (or another thread) calls
``request_stop``; the next ``sleep``, or ``check`` between two pieces of work, raises ``Aborted``. While the bench
makes itself safe the clock is shielded, so that the way to safety is not itself interrupted.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime


class Aborted(Exception):
    """The operator, or the system, asked the run to stop."""

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(reason)


class BenchClock:
    """The system's time, with a stop that ends every wait."""

    def __init__(self) -> None:
        self._stop = threading.Event()
        self._reason = ""
        self._shields = 0

    def monotonic(self) -> float:
        """Seconds of the system's monotonic clock."""
        return time.monotonic()

    def utc_now(self) -> datetime:
        """Present time, UTC, with its time zone."""
        return datetime.now(UTC)

    def sleep(self, seconds: float) -> None:
        """Wait that long. Raises Aborted as soon as a stop is requested, unless shielded."""
        if self._shields:
            time.sleep(max(0.0, seconds))
        elif self._stop.wait(max(0.0, seconds)):
            raise Aborted(self._reason)

    def check(self) -> None:
        """Raise Aborted when a stop has been requested, unless shielded."""
        if self._stop.is_set() and not self._shields:
            raise Aborted(self._reason)

    def request_stop(self, reason: str) -> None:
        """Ask the run to stop at its next wait; safe to call from a signal handler or another thread."""
        if not self._stop.is_set():
            self._reason = reason
            self._stop.set()

    @contextmanager
    def shielded(self) -> Iterator[None]:
        """Let nothing interrupt the waits inside: the way to a safe bench."""
        self._shields += 1
        try:
            yield
        finally:
            self._shields -= 1
