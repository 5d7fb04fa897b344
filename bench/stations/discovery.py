"""What is connected to this computer, what a station file would call it, and what is missing to use more.

Looks at the system's own lists; sends no byte to any device, so that nothing can move or switch.
"""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from serial.tools import list_ports

from drivers.camera import FoundCamera
from drivers.camera.discovery import find_cameras

BY_ID = Path("/dev/serial/by-id")


@dataclass(frozen=True)
class FoundPort:
    """A serial port.

    Attributes
    ----------
    name
        What a station file should call it: its name by id, where the system gives one.
    device
        The system's own name, which may be another device's after a restart.
    what
        What the adapter says it is.
    serial
        Serial number of the adapter, not of the device behind it.
    note
        Why it cannot be used as it is; empty when it can.
    """

    name: str
    device: str
    what: str
    serial: str
    note: str


@dataclass(frozen=True)
class Discovery:
    """Serial ports, cameras, and in sentences what is missing to see or use more."""

    ports: tuple[FoundPort, ...]
    cameras: tuple[FoundCamera, ...]
    missing: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Give it as ``--json`` prints it."""
        return asdict(self)


def discover(by_id: Path = BY_ID) -> Discovery:
    """List what is connected."""
    names = {os.path.realpath(link): str(link) for link in by_id.iterdir()} if by_id.is_dir() else {}
    ports = tuple(_port(info, names) for info in sorted(list_ports.comports(), key=lambda info: info.device))
    cameras, missing = find_cameras()
    if not ports:
        missing.append("No serial port was found: plug in the stage's and the light's adapters.")
    if not cameras:
        missing.append(
            "No camera was found: plug one in; a network camera is named by its URL (driver: opencv)."
        )
    return Discovery(ports, tuple(cameras), tuple(missing))


def _port(info: Any, names: dict[str, str]) -> FoundPort:
    allowed = os.access(info.device, os.R_OK | os.W_OK)
    return FoundPort(
        name=names.get(os.path.realpath(info.device), info.device),
        device=info.device,
        what=info.description if info.description not in {None, "n/a"} else "",
        serial=info.serial_number or "",
        note="" if allowed else "no permission: add yourself to its group (often dialout) and log in again",
    )
