"""Time comes in from outside: drivers wait through a clock they are given.

The bench hands in a clock whose ``sleep`` raises as soon as the operator asks to stop, so that every
wait of a driver is a safe point; a virtual clock makes a night pass in seconds.
"""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """What a driver needs of time."""

    def monotonic(self) -> float:
        """Seconds since some fixed moment, never going back."""
        ...

    def sleep(self, seconds: float) -> None:
        """Wait; may raise what the owner of the clock chooses to interrupt the wait."""
        ...


class SystemClock:
    """The machine's own time."""

    def monotonic(self) -> float:
        """Seconds of the system's monotonic clock."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Wait that long."""
        time.sleep(max(0.0, seconds))
