"""The bench's clock: every wait of a run goes through it, so that a request to stop ends every wait.

Stop does not travel through the queue of the work: a signal handler (or another thread) calls
``request_stop``; the next ``sleep``, or ``check`` between two pieces of work, raises ``Aborted``. An interlock calls
``interrupt`` in the same way, and the work may ``clear_interruption`` after it. While the bench makes itself safe the clock is
shielded, so that the way to safety is not itself interrupted. ``inactive_s`` tells whether the work still waits,
checks or asks the time (as waits do that must not be interrupted): where a driver hangs it does neither. A virtual
clock is the same, but its time passes only where somebody waits.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime, timedelta


class Aborted(Exception):
    """The operator, or the system, asked the run to stop."""

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(reason)


class Interrupted(Exception):
    """An interlock wants the work to pause; it goes on afterwards."""

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(reason)


class _Bell:
    """A ``threading.Event`` that may be set by a signal handler in the midst of its other calls.

    An Event has a lock: a handler that sets it, run while the same thread has just taken that lock to wait, would
    wait for itself for ever. Putting into a SimpleQueue takes none that a handler could meet.
    """

    def __init__(self) -> None:
        self._rung = False
        self._queue: queue.SimpleQueue[None] = queue.SimpleQueue()

    def is_set(self) -> bool:
        return self._rung

    def set(self) -> None:
        self._rung = True
        self._queue.put(None)

    def clear(self) -> None:
        self._rung = False
        with suppress(queue.Empty):
            while True:
                self._queue.get_nowait()

    def wait(self, seconds: float) -> bool:
        """Wait that long, or until it is rung; tell whether it is."""
        deadline_s = time.monotonic() + seconds
        while not self._rung:  # a ring that was taken back leaves nothing to wake up for
            left_s = deadline_s - time.monotonic()
            if left_s <= 0:
                break
            with suppress(queue.Empty):
                self._queue.get(timeout=left_s)
        if self._rung:
            self._queue.put(None)  # for whoever else waits
        return self._rung


class BenchClock:
    """The system's time, with a stop that ends every wait."""

    def __init__(self) -> None:
        self._woken = _Bell()
        self._stop: str | None = None
        self._failure: Exception | None = None
        self._interruption: str | None = None
        self._shields = 0
        self._asleep = False
        self._asked_s = time.monotonic()
        self._worker = threading.get_ident()

    def monotonic(self) -> float:
        """Seconds of the system's monotonic clock."""
        now_s = time.monotonic()
        if threading.get_ident() == self._worker:  # others ask on behalf of those who watch
            self._asked_s = now_s
        return now_s

    def utc_now(self) -> datetime:
        """Present time, UTC, with its time zone."""
        return datetime.now(UTC)

    def sleep(self, seconds: float) -> None:
        """Wait that long. Raises Aborted, or Interrupted, as soon as that is asked for, unless shielded."""
        self._asleep = True
        try:
            if self._shields:
                time.sleep(max(0.0, seconds))
            elif self._woken.wait(max(0.0, seconds)):
                self._give_way()
        finally:
            self._asked_s = time.monotonic()
            self._asleep = False

    def check(self) -> None:
        """Raise Aborted, or Interrupted, when that has been asked for, unless shielded."""
        self._asked_s = time.monotonic()
        if self._woken.is_set() and not self._shields:
            self._give_way()

    def inactive_s(self) -> float:
        """How long the work has neither waited, nor checked, nor asked the time, s; 0 while it waits."""
        return 0.0 if self._asleep else max(0.0, time.monotonic() - self._asked_s)

    def request_stop(self, reason: str) -> None:
        """Ask the run to stop at its next wait; safe to call from a signal handler or another thread."""
        if self._stop is None:
            self._stop = reason
            self._woken.set()

    def request_failure(self, error: Exception) -> None:
        """Ask the run to end with an error at its next wait: what goes on beside the work cannot go on."""
        if self._stop is None:
            self._failure = error
            self.request_stop(str(error))

    def interrupt(self, reason: str) -> None:
        """Ask the work to pause at its next wait; a stop that was asked for comes first."""
        if self._interruption is None:
            self._interruption = reason
            self._woken.set()

    def clear_interruption(self) -> None:
        """Forget an interruption; a stop stays asked for."""
        self._interruption = None
        self._woken.clear()
        if self._stop is not None:  # asked for before or during this very moment
            self._woken.set()

    def _give_way(self) -> None:
        if self._failure is not None:
            raise self._failure
        if self._stop is not None:
            raise Aborted(self._stop)
        if self._interruption is not None:
            raise Interrupted(self._interruption)

    @contextmanager
    def shielded(self) -> Iterator[None]:
        """Let nothing interrupt the waits inside: the way to a safe bench."""
        self._shields += 1
        try:
            yield
        finally:
            self._shields -= 1


class VirtualClock(BenchClock):
    """Time that passes only where somebody waits: a night takes as long as its computing.

    Parameters
    ----------
    begin
        The moment at which it begins, with its time zone.

    Examples
    --------
    >>> clock = VirtualClock(datetime(2026, 3, 1, 22, tzinfo=UTC))
    >>> clock.sleep(3600)
    >>> f"{clock.utc_now():%H:%M}", clock.monotonic()
    ('23:00', 3600.0)
    """

    def __init__(self, begin: datetime) -> None:
        super().__init__()
        self._begin = begin.astimezone(UTC)
        self._now_s = 0.0

    def monotonic(self) -> float:
        """Virtual seconds since the begin."""
        return self._now_s

    def utc_now(self) -> datetime:
        """Present virtual time, UTC."""
        return self._begin + timedelta(seconds=self._now_s)

    def sleep(self, seconds: float) -> None:
        """Let that much virtual time pass, at once. Raises Aborted where a stop was requested, unless shielded."""
        self.check()
        self._now_s += max(0.0, seconds)
