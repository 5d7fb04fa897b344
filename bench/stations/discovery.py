"""Lists the serial ports and cameras of this computer, their names for a station file, and what is missing.

It reads the lists of the operating system and sends no byte to a device, so that nothing can move or switch.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from serial.tools import list_ports

from drivers.camera import FoundCamera
from drivers.camera.discovery import find_cameras
from drivers.camera.usb_permission import slow_cameras, unreadable_cameras

BY_ID = Path("/dev/serial/by-id")
DRAFT = Path(__file__).with_name("station_draft.yaml.j2")


@dataclass(frozen=True)
class FoundPort:
    """A serial port."""

    name: str  # Name for a station file: below ``/dev/serial/by-id``, if the system provides it
    device: str  # The system's name, which may belong to another device after a restart
    what: str
    serial: str  # Serial number of the adapter, not of the device behind it
    note: str  # Why the port cannot be used; empty if it can


@dataclass(frozen=True)
class Discovery:
    """What is connected."""

    ports: tuple[FoundPort, ...]
    cameras: tuple[FoundCamera, ...]
    missing: tuple[str, ...]  # Sentences that say what is missing in order to find or use more


def discover(by_id: Path = BY_ID) -> Discovery:
    """List the serial ports, in the order of their system names, and the cameras of this computer."""
    names = {os.path.realpath(link): str(link) for link in by_id.iterdir()} if by_id.is_dir() else {}
    ports = tuple(_port(info, names) for info in sorted(list_ports.comports(), key=lambda info: info.device))
    cameras, missing = find_cameras()
    missing += [*unreadable_cameras(), *slow_cameras()]
    if not ports:
        missing.append("No serial port was found: connect the adapters of stage and light.")
    if not cameras:
        missing.append(
            "No camera was found: connect one. A network camera is named by its URL (driver: opencv)."
        )
    return Discovery(ports, tuple(cameras), tuple(missing))


def _port(info: Any, names: dict[str, str]) -> FoundPort:
    allowed = os.access(info.device, os.R_OK | os.W_OK)
    return FoundPort(
        name=names.get(os.path.realpath(info.device), info.device),
        device=info.device,
        what=info.description if info.description not in {None, "n/a"} else "",
        serial=info.serial_number or "",
        note=""
        if allowed
        else "no permission: add your user to the group of the port (often dialout) and log in again",
    )
