"""Event cameras on USB: those that this user may not open, and the speed of their connection.

The maker's software lists no camera that this user may not open, and gives no reason.

Reads the lists of the Linux kernel only; sends nothing to any device.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final

from drivers.errors import CameraSettingRefused

USB_DEVICES: Final = Path("/sys/bus/usb/devices")
"""Folder in which Linux lists the devices on USB."""
LEAST_MBIT_S: Final = 5000
"""Slowest connection that an event camera needs, Mbit/s: that of USB 3."""
USB_NODES: Final = Path("/dev/bus/usb")
"""Folder with the file of each device on USB."""

_KINDS: Final[Mapping[tuple[str, str], tuple[str, str]]] = {
    ("04b4", "00f4"): ("Prophesee", "EVK3"),
    ("04b4", "00f5"): ("Prophesee", "EVK4"),
    ("31f7", "0003"): ("CenturyArks", "SilkyEvCam HD"),
    ("1409", "8e00"): ("IDS", "uEye XCP-E"),
}
"""Maker and model by vendor and product numbers: of the udev rules of OpenEB, and of those that neuromorphic-drivers
opens as an EVK4 (its ``prophesee_evk4.rs``)."""


def unreadable_cameras(devices: Path = USB_DEVICES, nodes: Path = USB_NODES) -> list[str]:
    """Return what to do for each known event camera on USB that this user may not open; empty on other systems."""
    unreadable = []
    for device, kind in _cameras(devices):
        with suppress(OSError, ValueError):
            node = nodes / f"{int(_read(device, 'busnum')):03d}" / f"{int(_read(device, 'devnum')):03d}"
            if not os.access(node, os.R_OK | os.W_OK):
                unreadable.append(
                    f"A {_name(kind)} is connected, but this user may not use it ({node}): install the udev rules of"
                    " its maker (in OpenEB: hal_psee_plugins/resources/rules), then plug it in again."
                )
    return unreadable


def connected_cameras(devices: Path = USB_DEVICES) -> list[str] | None:
    """Return the kind of each known event camera on USB; None if the system has no such list."""
    return [_name(kind) for _, kind in _cameras(devices)] if devices.is_dir() else None


def slow_cameras(devices: Path = USB_DEVICES) -> list[str]:
    """Return what to do for each known event camera that is not connected by USB 3; empty on other systems."""
    slow = []
    for device, kind in _cameras(devices):
        speed_mbit_s = _speed_mbit_s(device)
        if speed_mbit_s is not None and speed_mbit_s < LEAST_MBIT_S:
            slow.append(
                f"A {_name(kind)} is connected at {speed_mbit_s} Mbit/s (USB 2); it would lose events. Use a USB 3 port"
                f" and cable ({LEAST_MBIT_S} Mbit/s or more)."
            )
    return slow


def only_camera_mbit_s(devices: Path = USB_DEVICES) -> int | None:
    """Return the speed, Mbit/s, of the only known event camera; None if it is not known, or there are several.

    (A USB device states no serial number that belongs to the camera for certain.)
    """
    cameras = _cameras(devices)
    return _speed_mbit_s(cameras[0][0]) if len(cameras) == 1 else None


def only_camera_kind(devices: Path = USB_DEVICES) -> tuple[str, str] | None:
    """Return maker and model of the cameras that neuromorphic-drivers opens as an EVK4.

    None if none is listed, or if there are several kinds: the package does not say which it has opened.
    """
    kinds = {kind for _, kind in _cameras(devices)}
    return kinds.pop() if len(kinds) == 1 else None


def check_link(link_mbit_s: int | None, where: str) -> None:
    """Refuse a camera that is known to be on USB 2, which loses events at the rates of a measurement."""
    if link_mbit_s is not None and link_mbit_s < LEAST_MBIT_S:
        raise CameraSettingRefused(
            f"The camera is connected at {link_mbit_s} Mbit/s (USB 2); it would lose events.",
            where=where,
            remedy=f"Use a USB 3 port and cable ({LEAST_MBIT_S} Mbit/s or more).",
        )


def _name(kind: tuple[str, str]) -> str:
    maker, model = kind
    return f"{maker} camera ({model})"


def _cameras(devices: Path) -> list[tuple[Path, tuple[str, str]]]:
    """List the folders of the known event cameras, each with maker and model."""
    cameras = []
    for device in sorted(devices.iterdir()) if devices.is_dir() else ():
        with suppress(OSError, ValueError):
            kind = _KINDS.get((_read(device, "idVendor").lower(), _read(device, "idProduct").lower()))
            if kind is not None:
                cameras.append((device, kind))
    return cameras


def _speed_mbit_s(device: Path) -> int | None:
    with suppress(OSError, ValueError):
        return int(float(_read(device, "speed"))) or None
    return None


def _read(device: Path, name: str) -> str:
    return (device / name).read_text(encoding="ascii").strip()
