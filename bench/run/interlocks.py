"""Interlocks: conditions that make a run hold, with light off and stage at rest, and let it continue once they clear.

Their kinds are door, disk space, camera temperature, event rate and lost device. A second, stricter limit to continue
avoids switching on and off. The thread of the commands checks the door ten times a second, and an open door interrupts
the work; the others are checked between two pieces of work.
"""

from __future__ import annotations

import errno
import os
import shutil
import stat
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from bench.base.clock import BenchClock, Interrupted
from bench.base.errors import InterlockHeld
from bench.record.storage import storage_errors
from bench.wording.goals import beside_goal
from drivers.errors import DriverError

if TYPE_CHECKING:  # the model of the station file loads NumPy, which `status` does not need
    from bench.stations.station_fields import (
        CameraTemperatureConfig,
        DeviceLostConfig,
        DiskSpaceConfig,
        DoorConfig,
        EventRateConfig,
        InterlockConfig,
        InterlockName,
    )

DOOR: InterlockName = "door"
DEVICE_LOST: InterlockName = "device_lost"
GUARDED = frozenset(
    {"homing", "lighting", "slewing", "settling", "waiting", "recording", "backing_off", "parking"}
)
"""States in which the stage moves, the light is on, or the camera records."""
_MOST_BYTES = 64  # A number


class Interlock(ABC):
    """A condition under which a run holds. ``config`` is its section of the station file."""

    name: ClassVar[InterlockName]
    poll_s: float = 1.0  # Time between two checks whether the run may continue, s
    config: InterlockConfig

    @abstractmethod
    def why(self, *, held: bool) -> str:
        """Return why the interlock holds, or an empty text; while held, the stricter limit for continuing applies."""


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
        """Let an open door interrupt the work in states that use devices, and at no other time (an empty name)."""
        with self._lock:
            self._guarding = state in GUARDED
            if not self._guarding:
                self._clock.clear_interruption()

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
            if before_s + held_s > interlock.config.max_hold_s:
                name, all_s = interlock_text(interlock.name), before_s + held_s
                raise InterlockHeld(
                    f"The {name} interlock has held the run for {all_s:.0f} s: {why.rstrip('.')}.",
                    remedy="Remove the cause. Then resume the run.",
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


@dataclass(frozen=True)
class Door(Interlock):
    """A file that states whether the enclosure is closed. If it cannot be read, the door counts as open."""

    name = DOOR
    poll_s = 0.1  # A run holds at once when a door opens
    config: DoorConfig
    utc_s: Callable[[], float] = time.time  # Returns the system time, s since 1970

    def why(self, *, held: bool) -> str:  # noqa: ARG002 - a door is open or closed
        """See `Interlock.why`."""
        try:
            state, written_s = _read_sensor(self.config.path)
        except OSError as error:
            return f"its sensor cannot be read ({error.strerror})"
        age_s = self.utc_s() - written_s
        if self.config.max_age_s is not None and age_s > self.config.max_age_s:
            return f"its sensor has reported nothing for {age_s:.0f} s"
        if self.config.max_age_s is not None and age_s < -self.config.max_age_s:
            return (
                f"the last report of its sensor lies {-age_s:.0f} s in the future:"
                " the clock of this computer was set back, or is wrong"
            )
        return "" if state == self.config.closed else f"it is open (the sensor reports {state!r})"


def _read_sensor(path: str) -> tuple[str, float]:
    """Read the text of a sensor's file and its time of writing. Raises OSError, also for a pipe."""
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise OSError(errno.EINVAL, "it is not a regular file")
        return os.read(descriptor, _MOST_BYTES).decode(errors="replace").strip(), status.st_mtime
    finally:
        os.close(descriptor)


@dataclass(frozen=True)
class DiskSpace(Interlock):
    """Free space on the disk of the run folder."""

    name = "disk_space"
    config: DiskSpaceConfig
    folder: Path

    def why(self, *, held: bool) -> str:
        """See `Interlock.why`."""
        with storage_errors(self.folder):
            free_gb = shutil.disk_usage(self.folder).free / 1e9
        wanted_gb = self.config.release_gb if held else self.config.min_free_gb
        if free_gb >= wanted_gb:
            return ""
        return f"{beside_goal(free_gb, wanted_gb)} GB are free, at least {wanted_gb:g} GB are needed"


@dataclass(frozen=True)
class CameraTemperature(Interlock):
    """Temperature of the sensor; a camera that does not measure it never holds the run."""

    name = "camera_temperature"
    poll_s = 5.0  # A sensor warms up in minutes
    config: CameraTemperatureConfig
    read_c: Callable[[], float | None]  # Reads the temperature, degrees Celsius

    def why(self, *, held: bool) -> str:
        """See `Interlock.why`."""
        found_c = self.read_c()
        most_c = self.config.release_c if held else self.config.max_c
        if found_c is None or found_c <= most_c:
            return ""
        return f"the sensor has {beside_goal(found_c, most_c)} C, at most {most_c:g} C are allowed"


@dataclass(frozen=True)
class EventRate(Interlock):
    """Event rate of the last recording; while it holds, that of a short recording in the dark."""

    name = "event_rate"
    poll_s = 2.0  # While it holds, each look is a recording
    config: EventRateConfig
    last_mev_s: Callable[[], float]  # Returns the event rate of the last recording, Mev/s
    dark_mev_s: Callable[[float], float]  # Measures the event rate in the dark for a time in s, Mev/s

    def why(self, *, held: bool) -> str:
        """See `Interlock.why`."""
        if held:
            rate_mev_s, most = self.dark_mev_s(self.config.probe_ms * 1e-3), self.config.release_mev_s
        else:
            rate_mev_s, most = self.last_mev_s(), self.config.max_mev_s
        if rate_mev_s <= most:
            return ""
        place = "dark" if held else "last recording"
        return f"{beside_goal(rate_mev_s, most)} Mev/s in the {place}, at most {most:g} are allowed"


@dataclass(frozen=True)
class DeviceLost(Interlock):
    """A lost device: holds until all devices can be opened again, each with the serial number it had."""

    name = DEVICE_LOST
    config: DeviceLostConfig
    reopen: Callable[[], str]  # Opens the devices again; returns why that failed, or an empty text

    @property
    def poll_s(self) -> float:  # type: ignore[override]
        """Time between two attempts to open the devices, s."""
        return self.config.retry_s

    def why(self, *, held: bool) -> str:
        """See `Interlock.why`. It never begins to hold by itself."""
        return self.reopen() if held else ""
