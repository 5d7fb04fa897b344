"""Measure how late a busy computer wakes this program, and let deadlines of replies follow that.

A reply may be there and this process may get no chance to read it; a simulated device may have no chance to write it.
Neither is a fault of the device. A thread therefore asks to be woken 50 times a second and adds up how late it was.
``Deadline`` counts only the time that this process, and the process that simulates the device, could use.

This module opens nothing, sends nothing, and moves nothing.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Final, TypedDict

PERIOD_S: Final = 0.02
"""The thread asks to be woken after this time, s."""
NOTED_S: Final = 0.005
"""Delays below this are usual on an idle computer, and are not counted, s."""
MOST_STRETCH_S: Final = 30.0
"""A deadline is stretched by this time at most, s: a stopped process must not keep the bench waiting for ever."""
BUSY_SHARE: Final = 0.3
"""A wait in which this share of the time was lost is told as the fault of the computer."""
BUSY_S: Final = 0.3
"""It is told so only if at least this time was lost, s."""
REMEDY: Final = (
    "End other programs on this computer, or start fewer runs at the same time; then resume the run."
)
_clocks: dict[str, Callable[[], float]] = {}


class LatenessData(TypedDict, total=False):
    """How late a process was woken, in all and at once, and the computer's load; empty where it was not measured."""

    lost_s: float
    longest_s: float
    load: float | None  # Of the last minute; None where the system has none


class Lateness:
    """Adds up how late this process is woken; ``longest_s`` is the longest single delay, s."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._noting = threading.Lock()
        self._due_s = now_s() + PERIOD_S
        self._lost_s = 0.0
        self._held = 0
        self.longest_s = 0.0

    def woken(self) -> None:
        """Note that the thread was woken, and when it was due."""
        with self._noting:
            now_s = self._now_s()
            delay_s = 0.0 if self._held else max(0.0, now_s - self._due_s)
            self.longest_s = max(self.longest_s, delay_s)
            self._lost_s += delay_s if delay_s > NOTED_S else 0.0
            self._due_s = now_s + PERIOD_S

    @contextmanager
    def interpreter_held(self) -> Iterator[None]:
        """Count no delay during the block: software of a maker runs in it that lets no other thread of Python run."""
        with self._noting:
            self._held += 1
        try:
            yield
        finally:
            with self._noting:
                self._held -= 1
                self._due_s = self._now_s() + PERIOD_S

    def lost_s(self) -> float:
        """Return the time that this process has lost since it began to measure, s, with a delay that still lasts."""
        with self._noting:
            overdue_s = self._overdue_s()
            return self._lost_s + (overdue_s if overdue_s > NOTED_S else 0.0)

    def summary(self) -> LatenessData:
        """Return the lateness for a journal."""
        with self._noting:
            longest_s = max(self.longest_s, self._overdue_s())
        return {"lost_s": round(self.lost_s(), 3), "longest_s": round(longest_s, 3), "load": _load()}

    def _overdue_s(self) -> float:
        """Return the delay that still lasts, s: after a sleep, another thread may run before that which measures."""
        return 0.0 if self._held else self._now_s() - self._due_s


def _load() -> float | None:
    try:
        return round(os.getloadavg()[0], 2)
    except (AttributeError, OSError):
        return None


@cache
def own_lateness() -> Lateness:
    """Return the measurement of this process; the first call begins it."""
    lateness = Lateness()

    def wake() -> None:
        while True:
            time.sleep(PERIOD_S)
            lateness.woken()

    threading.Thread(target=wake, name="lateness", daemon=True).start()
    return lateness


def follow_clock(address: str, lived_s: Callable[[], float]) -> None:
    """Let the deadlines of a device follow the clock of the process that simulates it.

    ``lived_s`` returns the time that the process could use, s. It stands still while the process waits for a processor.
    """
    _clocks[address] = lived_s


def follow_no_clock(address: str) -> None:
    """End what `follow_clock` began."""
    _clocks.pop(address, None)


class Deadline:
    """A deadline that counts only the time that the processes at both ends could use.

    ``seconds`` is the time on an idle computer, ``address`` that of the device; see `follow_clock`.
    """

    def __init__(
        self,
        seconds: float,
        address: str = "",
        *,
        now_s: Callable[[], float] = time.monotonic,
        lateness: Lateness | None = None,
    ) -> None:
        self._seconds = seconds
        self._now_s = now_s
        self._lateness = lateness or own_lateness()
        self._peer_s = _clocks.get(address)
        self._began_s = now_s()
        self._lost_before_s = self._lateness.lost_s()
        self._peer_before_s = self._peer_s() if self._peer_s is not None else 0.0

    def late_s(self) -> float:
        """Return the time since the beginning that one of the two processes could not use."""
        own_s = self._lateness.lost_s() - self._lost_before_s
        peer_s = 0.0
        if self._peer_s is not None:  # the peer's clock moves in steps of two periods at most
            peer_s = self._now_s() - self._began_s - (self._peer_s() - self._peer_before_s) - 2.0 * PERIOD_S
        return max(0.0, own_s, peer_s)

    def left_s(self) -> float:
        """Return the time that is left, s; 0 or less when the deadline is over."""
        return self._seconds - (self._now_s() - self._began_s) + min(self.late_s(), MOST_STRETCH_S)

    def starved_s(self) -> float:
        """Return how late the computer was, s, where that may be why no reply came; else 0."""
        late_s = self.late_s()
        waited_s = self._now_s() - self._began_s
        return late_s if late_s >= max(BUSY_S, BUSY_SHARE * waited_s) else 0.0


def busy_text(late_s: float) -> str:
    """Return the sentence about a computer that was late, without a capital letter and without a full stop.

    >>> busy_text(2.345)
    'this computer is too busy: it was 2.3 s late'
    """
    return f"this computer is too busy: it was {late_s:.1f} s late"
