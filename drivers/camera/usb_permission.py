"""Cameras on USB that this user may not open: then the maker's software lists none, and gives no reason.

Reads the lists of the Linux kernel only; sends nothing to any device.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final

USB_DEVICES: Final = Path("/sys/bus/usb/devices")
"""Folder in which Linux lists the devices on USB."""
USB_NODES: Final = Path("/dev/bus/usb")
"""Folder with the file of each device on USB."""

_CAMERAS: Final[Mapping[tuple[str, str], str]] = {
    ("04b4", "00f4"): "Prophesee camera (EVK3)",
    ("04b4", "00f5"): "Prophesee camera (EVK4)",
}
"""Vendor and product numbers, as the udev rules of OpenEB have them."""


def unreadable_cameras(devices: Path = USB_DEVICES, nodes: Path = USB_NODES) -> list[str]:
    """Return a sentence for each known event camera on USB that this user may not open.

    Parameters
    ----------
    devices
        Folder in which Linux lists the devices on USB.
    nodes
        Folder with the file of each device.

    Returns
    -------
    list of str
        What is connected, and what to do; empty on other systems.
    """
    found = []
    for device in sorted(devices.iterdir()) if devices.is_dir() else ():
        with suppress(OSError, ValueError):
            name = _CAMERAS.get((_read(device, "idVendor").lower(), _read(device, "idProduct").lower()))
            if name is None:
                continue
            node = nodes / f"{int(_read(device, 'busnum')):03d}" / f"{int(_read(device, 'devnum')):03d}"
            if not os.access(node, os.R_OK | os.W_OK):
                found.append(
                    f"A {name} is connected, but this user may not use it ({node}): install the udev rules of its"
                    " maker (in OpenEB: hal_psee_plugins/resources/rules), then plug it in again."
                )
    return found


def _read(device: Path, name: str) -> str:
    return (device / name).read_text(encoding="ascii").strip()
