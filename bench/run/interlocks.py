"""Interlocks: what makes a run hold of itself, light off and stage at rest, and lets it go on by itself afterwards.

Each says why it holds, or nothing; with a threshold of its own for going on, so that none goes on and off. The door is
looked at ten times a second by the thread that also takes commands, and interrupts a move or a recording; the others
are looked at between two pieces of work, a lost device where a driver misses it. How long each holds a run is bounded.
Knows what to look at; what holding means is `bench.run.holding`'s business.
"""

from __future__ import annotations

import errno
import os
import shutil
import stat
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from bench.base.clock import BenchClock, Interrupted
from bench.base.errors import InterlockHeld
from bench.records.storage import storage_errors
from bench.run.interlock_text import interlock_text
from bench.stations.station_interlocks import (
    CameraTemperatureConfig,
    DeviceLostConfig,
    DiskSpaceConfig,
    DoorConfig,
    EventRateConfig,
    InterlockName,
    InterlocksConfig,
)

DOOR: InterlockName = "door"
DEVICE_LOST: InterlockName = "device_lost"
GUARDED = frozenset(
    {"homing", "lighting", "slewing", "settling", "waiting", "recording", "backing_off", "parking"}
)
"""States in which something moves, shines or records."""
_MOST_BYTES = 64


class Sensors(Protocol):
    """Readings of the run's devices that interlocks look at (`bench.run.run_devices.RunDevices`)."""

    def camera_c(self) -> float | None:
        """Read the camera's temperature, degrees Celsius; None where it measures none."""
        ...

    def last_mev_s(self) -> float:
        """Return the event rate of the last recording, Mev/s."""
        ...

    def dark_mev_s(self, duration_s: float) -> float:
        """Measure the event rate in the dark for so many seconds, Mev/s."""
        ...

    def reopen(self) -> str:
        """Open the devices again; return why that failed, or nothing."""
        ...


class Interlock(Protocol):
    """One interlock."""

    @property
    def name(self) -> InterlockName:
        """As in the station file."""
        ...

    @property
    def max_hold_s(self) -> float:
        """How long it may hold a run, all in all."""
        ...

    @property
    def poll_s(self) -> float:
        """How often it is looked whether a run may go on."""
        ...

    def why(self, *, held: bool) -> str:
        """Say why it holds; empty where it does not. While ``held`` it takes more to let go."""
        ...


@dataclass(frozen=True)
class Door:
    """A file that says whether the enclosure is closed. Whatever cannot be read is open."""

    config: DoorConfig
    name: InterlockName = field(default=DOOR, init=False)
    poll_s: float = field(default=0.1, init=False)
    utc_s: Callable[[], float] = time.time

    @property
    def max_hold_s(self) -> float:
        """As in the station file."""
        return self.config.max_hold_s

    def why(self, *, held: bool) -> str:  # noqa: ARG002 - a door is open or closed
        """Say why it holds."""
        try:
            said, written_s = _read_sensor(self.config.path)
        except OSError as error:
            return f"its sensor cannot be read ({error.strerror})"
        age_s = self.utc_s() - written_s
        if self.config.max_age_s is not None and age_s > self.config.max_age_s:
            return f"its sensor has said nothing for {age_s:.0f} s"
        if self.config.max_age_s is not None and age_s < -self.config.max_age_s:
            return f"its sensor last spoke {-age_s:.0f} s from now: this machine's clock was set back, or is wrong"
        return "" if said == self.config.closed else f"it is open (the sensor says {said!r})"


def _read_sensor(path: str) -> tuple[str, float]:
    """Read what a sensor's file says, and when it was written. Raises OSError, for a pipe without a writer too."""
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    try:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode):
            raise OSError(errno.EINVAL, "it is not a file")
        return os.read(descriptor, _MOST_BYTES).decode(errors="replace").strip(), found.st_mtime
    finally:
        os.close(descriptor)


@dataclass(frozen=True)
class DiskSpace:
    """Room on the disk of the run folder."""

    config: DiskSpaceConfig
    folder: Path
    name: InterlockName = field(default="disk_space", init=False)
    poll_s: float = field(default=1.0, init=False)

    @property
    def max_hold_s(self) -> float:
        """As in the station file."""
        return self.config.max_hold_s

    def why(self, *, held: bool) -> str:
        """Say why it holds. Raises StorageError."""
        with storage_errors(self.folder):
            free_gb = shutil.disk_usage(self.folder).free / 1e9
        wanted_gb = self.config.release_gb if held else self.config.min_free_gb
        return f"{free_gb:.3g} GB are free, {wanted_gb:g} GB are wanted" if free_gb < wanted_gb else ""


@dataclass(frozen=True)
class CameraTemperature:
    """The sensor's temperature; a camera that cannot tell it is never too warm."""

    config: CameraTemperatureConfig
    read_c: Callable[[], float | None]
    name: InterlockName = field(default="camera_temperature", init=False)
    poll_s: float = field(default=5.0, init=False)

    @property
    def max_hold_s(self) -> float:
        """As in the station file."""
        return self.config.max_hold_s

    def why(self, *, held: bool) -> str:
        """Say why it holds. Raises DriverError."""
        found_c = self.read_c()
        most_c = self.config.release_c if held else self.config.max_c
        if found_c is None or found_c <= most_c:
            return ""
        return f"the sensor has {found_c:.1f} C, at most {most_c:g} C are wanted"


@dataclass(frozen=True)
class EventRate:
    """The rate of the last recording; and, while it holds, that of a short one in the dark."""

    config: EventRateConfig
    last_mev_s: Callable[[], float]
    dark_mev_s: Callable[[float], float]
    name: InterlockName = field(default="event_rate", init=False)
    poll_s: float = field(default=2.0, init=False)

    @property
    def max_hold_s(self) -> float:
        """As in the station file."""
        return self.config.max_hold_s

    def why(self, *, held: bool) -> str:
        """Say why it holds. Raises DriverError."""
        if held:
            found, most = self.dark_mev_s(self.config.probe_ms * 1e-3), self.config.release_mev_s
            return f"{found:.3g} Mev/s come in the dark, at most {most:g} are wanted" if found > most else ""
        found, most = self.last_mev_s(), self.config.max_mev_s
        return (
            f"{found:.3g} Mev/s came with the last recording, at most {most:g} are wanted"
            if found > most
            else ""
        )


@dataclass(frozen=True)
class DeviceLost:
    """A device that went away: it holds until all devices can be opened again, each the one it was."""

    config: DeviceLostConfig
    reopen: Callable[[], str]
    name: InterlockName = field(default=DEVICE_LOST, init=False)

    @property
    def max_hold_s(self) -> float:
        """As in the station file."""
        return self.config.max_hold_s

    @property
    def poll_s(self) -> float:
        """As in the station file."""
        return self.config.retry_s

    def why(self, *, held: bool) -> str:
        """Say why it holds: by itself only once it is held. Raises WrongDevice where another one came back."""
        return self.reopen() if held else ""


@dataclass(frozen=True)
class Trip:
    """An interlock that holds, and why."""

    interlock: Interlock
    why: str

    @property
    def text(self) -> str:
        """In words."""
        return f"the {interlock_text(self.interlock.name)} interlock: {self.why}"


class Interlocks:
    """All interlocks of a station.

    Parameters
    ----------
    interlocks
        Those that are looked at.
    clock
        Interrupted when the door opens while devices are at work.
    """

    def __init__(self, interlocks: Sequence[Interlock], clock: BenchClock) -> None:
        self._interlocks = tuple(interlocks)
        self._clock = clock
        self._guarding = False
        self._interrupting: Trip | None = None
        self._lock = threading.Lock()
        self._held_s: dict[str, float] = {}

    def look(self) -> None:
        """Look at the door, and interrupt the work where it is open; for a thread."""
        with self._lock:
            door = next((i for i in self._interlocks if i.name == DOOR), None)
            if self._guarding and door is not None and (why := door.why(held=False)):
                self._interrupting = Trip(door, why)
                self._clock.interrupt(self._interrupting.text)

    def entering(self, state: str) -> None:
        """Let an open door interrupt the work of a state in which devices are at work, and of no other."""
        with self._lock:
            self._guarding = state in GUARDED
            if not self._guarding:
                self._clock.clear_interruption()

    def left_off(self) -> None:
        """Let nothing interrupt what is between two states."""
        self.entering("")

    def require_clear(self) -> None:
        """See that none holds at this moment, before work goes on.

        Raises
        ------
        Interrupted
            When one holds; ``take`` then gives it.
        StorageError, DriverError
            When that cannot be told.
        """
        for interlock in self._interlocks:
            if why := interlock.why(held=False):
                trip = Trip(interlock, why)
                self._interrupting = trip
                raise Interrupted(trip.text)

    def lost(self, why: str) -> Trip | None:
        """Give what is to be done where a device went away; None where the station names no such interlock."""
        interlock = next((i for i in self._interlocks if i.name == DEVICE_LOST), None)
        return Trip(interlock, why) if interlock is not None else None

    def take(self) -> Trip:
        """Give the interlock that has just interrupted the work; the clock goes on."""
        with self._lock:
            trip, self._interrupting = self._interrupting, None
            self._clock.clear_interruption()
        assert trip is not None
        return trip

    def wait(self, trip: Trip) -> float:
        """Wait until an interlock lets go; return how long that took, s.

        Raises
        ------
        InterlockHeld
            When it has held this run for too long, all its holds together.
        Aborted
            When a stop was asked for.
        """
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
                    f"The {name} interlock has held the run for {all_s:.0f} s: {why}.",
                    remedy="Remove the cause, then go on with `starbench resume`.",
                )
            self._clock.sleep(interlock.poll_s)


def interlocks_of(config: InterlocksConfig, folder: Path, sensors: Sensors) -> list[Interlock]:
    """Make the interlocks that a station names.

    Parameters
    ----------
    config
        The station file's ``interlocks`` section.
    folder
        The run folder.
    sensors
        Readings of the run's devices.

    Returns
    -------
    list of Interlock
        Those that the station names, in a fixed order.
    """
    found: list[Interlock] = []
    if config.door is not None:
        found.append(Door(config.door))
    if config.disk_space is not None:
        found.append(DiskSpace(config.disk_space, folder))
    if config.camera_temperature is not None:
        found.append(CameraTemperature(config.camera_temperature, sensors.camera_c))
    if config.event_rate is not None:
        found.append(EventRate(config.event_rate, sensors.last_mev_s, sensors.dark_mev_s))
    if config.device_lost is not None:
        found.append(DeviceLost(config.device_lost, sensors.reopen))
    return found
