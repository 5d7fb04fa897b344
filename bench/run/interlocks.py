"""Interlocks: conditions that make a run hold, with light off and stage at rest, and let it continue once they clear.

A second, stricter limit to continue avoids switching on and off. The thread of the commands checks the door ten times a
second, and an open door interrupts the work; the others are checked between two pieces of work.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from bench.base.clock import BenchClock, Interrupted
from bench.base.errors import InterlockHeld
from drivers.errors import DriverError

if TYPE_CHECKING:
    from bench.stations.station_fields import InterlockName

DOOR: InterlockName = "door"
DEVICE_LOST: InterlockName = "device_lost"
GUARDED = frozenset(
    {"homing", "lighting", "slewing", "settling", "waiting", "recording", "backing_off", "parking"}
)
"""States in which the stage moves, the light is on, or the camera records."""


class Interlock(Protocol):
    """A condition that makes a run hold."""

    @property
    def name(self) -> InterlockName:
        """Name in the station file."""
        ...

    @property
    def max_hold_s(self) -> float:
        """Longest total time for which it may hold a run, s."""
        ...

    @property
    def poll_s(self) -> float:
        """Time between two checks whether the run may continue, s."""
        ...

    def why(self, *, held: bool) -> str:
        """Return why the interlock holds, or an empty text; while held, the stricter limit for continuing applies."""
        ...


@dataclass(frozen=True)
class Trip:
    """An interlock that holds the run, and why."""

    interlock: Interlock
    why: str

    @property
    def text(self) -> str:
        """The interlock and the reason, as text."""
        return f"the {interlock_text(self.interlock.name)} interlock: {self.why}"


class Interlocks:
    """All interlocks of a station; one interrupts the clock when the door opens while devices are at work."""

    def __init__(self, interlocks: Sequence[Interlock], clock: BenchClock) -> None:
        self._interlocks = tuple(interlocks)
        self._clock = clock
        self._guarding = False
        self._interrupting: Trip | None = None
        self._lock = threading.Lock()
        self._held_s: dict[str, float] = {}

    def check_door(self) -> None:
        """Check the door, and interrupt the work if it is open; called by a thread."""
        with self._lock:
            door = next((i for i in self._interlocks if i.name == DOOR), None)
            if self._guarding and door is not None and (why := door.why(held=False)):
                self._interrupting = Trip(door, why)
                self._clock.interrupt(self._interrupting.text)

    def entering(self, state: str) -> None:
        """Let an open door interrupt the work in states that use devices, and in no other state."""
        with self._lock:
            self._guarding = state in GUARDED
            if not self._guarding:
                self._clock.clear_interruption()

    def left_off(self) -> None:
        """Let no interlock interrupt the time between two states."""
        self.entering("")

    def require_clear(self) -> None:
        """Raise `Interrupted` if an interlock holds before work continues; ``take_interruption`` then returns it."""
        for interlock in self._interlocks:
            if why := interlock.why(held=False):
                trip = Trip(interlock, why)
                self._interrupting = trip
                raise Interrupted(trip.text)

    def device_lost(self, why: str) -> Trip | None:
        """Return what holds the run after a device was lost; None if the station has no ``device_lost`` interlock."""
        interlock = next((i for i in self._interlocks if i.name == DEVICE_LOST), None)
        return Trip(interlock, why) if interlock is not None else None

    def take_interruption(self) -> Trip:
        """Return the interlock that has just interrupted the work, and clear the interruption of the clock."""
        with self._lock:
            trip, self._interrupting = self._interrupting, None
            self._clock.clear_interruption()
        assert trip is not None
        return trip

    def wait_until_clear(self, trip: Trip) -> float:
        """Wait until an interlock clears; `InterlockHeld` if all holds of this interlock together took too long."""
        begin_s = self._clock.monotonic()
        interlock = trip.interlock
        before_s = self._held_s.get(interlock.name, 0.0)
        while True:
            held_s = self._clock.monotonic() - begin_s
            self._held_s[interlock.name] = before_s + held_s
            if not (why := interlock.why(held=True)):
                return held_s
            if before_s + held_s > interlock.max_hold_s:
                name, all_s = interlock_text(interlock.name), before_s + held_s
                raise InterlockHeld(
                    f"The {name} interlock has held the run for {all_s:.0f} s: {why.rstrip('.')}.",
                    remedy="Remove the cause, then continue with `starbench resume`.",
                )
            self._clock.sleep(interlock.poll_s)


def loss_text(error: DriverError) -> str:
    """Return how a device was lost, for a run that holds: it continues by itself, so nobody has to resume it.

    Place, what is wrong, and remedy, without the last full stop: whoever quotes it ends the sentence.

    >>> loss_text(DriverError("It is gone.", where="camera 7", remedy="Check the cable, then resume the run."))
    'camera 7: It is gone. Check its cable and power'
    """
    place = f"{error.where}: " if error.where else ""
    remedy = "Check its cable and power." if "resume" in error.remedy.lower() else error.remedy
    return f"{place}{error.what} {remedy}".strip().removesuffix(".")


def interlock_text(name: str) -> str:
    """Return the name of an interlock as text.

    >>> interlock_text("camera_temperature")
    'camera temperature'
    """
    return name.replace("_", " ")
