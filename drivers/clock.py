"""The clock through which drivers wait; the program that opens a driver passes it in.

The bench passes a clock whose ``sleep`` raises as soon as the operator asks to stop, so a driver can be stopped at each
of its waits. With a virtual clock, a night passes in seconds.
"""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """The time that a driver reads and waits by."""

    def monotonic(self) -> float:
        """Return the time since a fixed moment, s; it never goes back."""

    def sleep(self, seconds: float) -> None:
        """Wait, in seconds; the owner of the clock may interrupt the wait by an exception of its own."""


class SystemClock:
    """The monotonic clock of the operating system."""

    def monotonic(self) -> float:
        """See `Clock.monotonic`."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """See `Clock.sleep`. A negative time is no wait."""
        time.sleep(max(0.0, seconds))
