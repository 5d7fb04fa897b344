"""A simulated device on a line of faults, and a station whose section opens the driver for it."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Final, Protocol

import numpy as np
import pytest

from bench.stations.station import Station
from drivers.errors import DriverError
from sequences.reader import check_document
from simulators.faults.line_faults import FaultLine, LineFault
from simulators.ports.pseudo_terminal import PseudoTerminal
from simulators.ports.serial_device import SerialDevice

PORT: Final = "PORT"
"""Stands in a section for the port of the simulated device."""
SPOILT: Final = ("lost", "truncated", "garbled", "nul", "doubled", "late", "request_lost")
"""What happens to a message on a disturbed line."""
LONGEST_S: Final = 20.0
"""An error must come within this time, whatever the line does; in seconds."""

_OTHERS: Final[Mapping[str, Any]] = {
    "stage": {
        "driver": "grbl",
        "port": "/dev/null",
        "axes": {
            "pan": {
                "letter": "X",
                "steps_per_deg": 100,
                "limits_deg": [-1, 1],
                "speed_deg_s": 1,
                "acceleration_deg_s2": 1,
            }
        },
    },
    "light": {"driver": "scpi", "port": "/dev/null"},
    "camera": {"driver": "metavision", "serial": "1"},
}


class SimulatedDevice(Protocol):
    """A device that answers bytes."""

    @property
    def baud(self) -> int:
        """Baud rate at which it listens."""

    def receive(self, data: bytes) -> bytes:
        """Take bytes as they arrive, in pieces of any size.

        Parameters
        ----------
        data
            Bytes from the computer.

        Returns
        -------
        bytes
            Answers that are ready now.
        """

    def unsolicited(self) -> bytes:
        """Return what it sends without a request, and late answers.

        Returns
        -------
        bytes
            May be empty.
        """


class WithAngles(Protocol):
    """What tells where its axes really are."""

    def angles_deg(self) -> Mapping[str, float]:
        """Return where the axes really are.

        Returns
        -------
        mapping
            Angle by axis, in degrees.
        """


class SimulatedStage(SimulatedDevice, WithAngles, Protocol):
    """A simulated stage on a line of bytes."""


class Connected(Protocol):
    """A simulated device that a driver can reach without a line of bytes."""

    @property
    def address(self) -> str:
        """What stands for ``PORT`` in the section; empty for a device that has no port."""

    def unplug(self) -> None:
        """Pull its cable, or take it off the maker's library; it stays so."""


class LibraryStage(Connected, WithAngles, Protocol):
    """A simulated stage that a maker's library can reach, or a stand-in for that library."""


class SimulatedLight(SimulatedDevice, Protocol):
    """A simulated light."""

    def is_lit(self) -> bool:
        """Return whether the light is really on, flickering or steady.

        Returns
        -------
        bool
            Whether it is.
        """


class ConnectedContract:
    """What the contracts of cameras and of stages behind a library share.

    Attributes
    ----------
    section
        The section of the station file; ``PORT`` stands in place of the address.
    """

    section: ClassVar[Mapping[str, Any]]

    def connected(self) -> AbstractContextManager[Any]:
        """Connect a simulated device, or a stand-in for the library, fresh from power-up.

        Returns
        -------
        context manager
            Gives the device, and takes it away.

        Raises
        ------
        NotImplementedError
            If a subclass does not write it.
        """
        raise NotImplementedError

    @pytest.fixture
    def simulated(self) -> Iterator[Any]:
        """The simulated device."""
        with self.connected() as device:
            yield device


@dataclass
class Rig:
    """A simulated device, its line, and the station that names it.

    Attributes
    ----------
    plugged
        The device on its port.
    line
        The line of faults.
    station
        Returns the station, with changed keys of the section.
    """

    plugged: SerialDevice
    line: FaultLine
    station: Callable[[Mapping[str, Any]], Station]

    def spoil(self, kind: str, count: int | None = 1) -> None:
        """Spoil messages to come.

        Parameters
        ----------
        kind
            One of `SPOILT`, or ``stranger``.
        count
            Number of messages; None for all.
        """
        self.line.inject(LineFault(kind, count=count, delay_s=1.2))


@contextmanager
def rig(kind: str, section: Mapping[str, Any], device: SimulatedDevice, folder: Path) -> Iterator[Rig]:
    """Put a device on a port.

    Parameters
    ----------
    kind
        "stage" or "light".
    section
        Section of the station file, with `PORT` as its port, or as the port of its axis.
    device
        The simulated device.
    folder
        A folder for the port.

    Yields
    ------
    Rig
        While the device answers.
    """
    line = FaultLine(device, time.monotonic, np.random.default_rng(1))
    with SerialDevice(PseudoTerminal(folder / "port"), line) as plugged:

        def station(changes: Mapping[str, Any]) -> Station:
            return station_of(kind, section, plugged.address, changes)

        yield Rig(plugged, line, station)


def station_of(kind: str, section: Mapping[str, Any], address: str, changes: Mapping[str, Any]) -> Station:
    """Return a station with a section.

    Parameters
    ----------
    kind
        "stage", "light" or "camera".
    section
        Section of the station file.
    address
        What stands for each `PORT`.
    changes
        Keys of the section with other values.

    Returns
    -------
    Station
        The station; its other devices are never opened.
    """
    document = {"format": "starbench/station/1", "name": "Contract tests", **_OTHERS}
    text = json.dumps({**document, kind: {**_filled(section, address), **changes}}, indent=1)
    return check_document(text.encode(), "contract.yaml", Station).value


def _filled(section: Mapping[str, Any], address: str) -> dict[str, Any]:
    """Return a section with an address for each `PORT`, those of its axes included."""
    return {
        key: _filled(value, address) if isinstance(value, Mapping) else address if value == PORT else value
        for key, value in section.items()
    }


def fails_in_time(act: Callable[[], object], kind: type[DriverError] = DriverError) -> DriverError:
    """Check that an act ends in an error of a driver, in bounded time.

    Parameters
    ----------
    act
        The act.
    kind
        Class of the error.

    Returns
    -------
    DriverError
        The error. It says what is wrong, where, and what to do.
    """
    began_s = time.monotonic()
    with pytest.raises(kind) as caught:
        act()
    assert time.monotonic() - began_s < LONGEST_S
    assert caught.value.what
    assert caught.value.remedy, "an error must say what the operator should do"
    return caught.value
