"""What all simulated stage controllers share: power, a restart without answers, events of the motion, and a buffer.

A `Unit` has power and axes: a controller, or one of several devices on a line. A `Controller` has a line of its own.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from simulators.stages.axis_motion import Axis, MotionEvent


class Unit(ABC):
    """Something with power that moves axes; for ``boot_s`` after a restart it gives no answers."""

    def __init__(self, axes: Iterable[Axis], now_s: float, boot_s: float = 0.0) -> None:
        self._moved = tuple(axes)
        self._boot_s = boot_s
        self._powered = True
        self._boot_ends_s = now_s

    @abstractmethod
    def _power_up(self, t_s: float) -> None:
        """Set the state after power-up."""

    @abstractmethod
    def _notice(self, axis: Axis, event: MotionEvent, t_s: float) -> None:
        """Process an event of a motion that is no restart."""

    def awake(self, t_s: float) -> bool:
        """Return whether it has power and has booted."""
        return self._powered and t_s >= self._boot_ends_s

    def take_events(self, t_s: float) -> None:
        """Process the events of the motions so far."""
        for axis in self._moved:
            event = axis.take_event(t_s)
            if event is None:
                continue
            if event.kind == "restart":
                self.restart(event.t_s)
                return
            self._notice(axis, event, t_s)

    def restart(self, t_s: float) -> None:
        """Reboot: no answers for a while, then the state after power-up; references are lost, counters are 0."""
        for axis in self._moved:
            axis.restart(t_s)
        self._power_up(t_s)
        self._boot_ends_s = t_s + self._boot_s

    def emergency_stop(self, t_s: float, *, released: bool = False) -> None:
        """Press or release the emergency stop, which cuts the power; released, nothing happens if it was not cut."""
        if not released:
            self._powered = False
            for axis in self._moved:
                axis.halt(t_s)
        elif not self._powered:
            self._powered = True
            self.restart(t_s)


class Controller(Unit):
    """A controller with a line of its own, as its dialect; half a message is dropped after ``byte_timeout_s``."""

    def __init__(
        self,
        axes: Iterable[Axis],
        clock: Callable[[], float],
        *,
        baud: int = 115_200,
        boot_s: float = 0.0,
        byte_timeout_s: float = math.inf,
    ) -> None:
        super().__init__(axes, clock(), boot_s)
        self._clock = clock
        self.baud = baud
        self._byte_timeout_s = byte_timeout_s
        self._received_at_s = clock()
        self._buffer = b""

    def receive(self, data: bytes) -> bytes:
        """See `Dialect.receive`."""
        now = self._clock()
        self.take_events(now)
        if not self.awake(now):
            return b""
        if now - self._received_at_s > self._byte_timeout_s:
            self._buffer = b""
        self._received_at_s = now
        self._buffer += data
        return self._answer(now)

    def unsolicited(self) -> bytes:
        """See `Dialect.unsolicited`. Most controllers say nothing unasked."""
        return b""

    @abstractmethod
    def _answer(self, now: float) -> bytes:
        """Take whole messages from the buffer, and return their answers."""


@dataclass
class AxisOfController:
    """One of several axes of a controller, for faults: what happens to the controller happens to all its axes."""

    controller: Unit
    axis: Axis

    def restart(self, t_s: float) -> None:
        """See `AxisController.restart`."""
        self.controller.restart(t_s)

    def emergency_stop(self, t_s: float, *, released: bool = False) -> None:
        """See `AxisController.emergency_stop`."""
        self.controller.emergency_stop(t_s, released=released)
