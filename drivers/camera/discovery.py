"""Which cameras are connected, asked of every driver whose software is installed; opens none of them."""

from __future__ import annotations

from pathlib import Path

from drivers.camera import FoundCamera, metavision, neuromorphic_evk4
from drivers.errors import DriverError


def find_cameras() -> tuple[list[FoundCamera], list[str]]:
    """List the cameras, and say in sentences what is missing to see others.

    The same camera stands in it once for each driver that could use it.
    """
    found: list[FoundCamera] = []
    missing: list[str] = []
    for discover in (metavision.discover, neuromorphic_evk4.discover):
        try:
            found += discover()
        except DriverError as error:
            missing.append(str(error))
    return found + video_devices(), missing


def video_devices(folder: Path = Path("/dev")) -> list[FoundCamera]:
    """List the video devices of a Linux computer, as frame cameras."""
    by_id = folder / "v4l" / "by-id"
    links = {link.resolve(): link.name for link in by_id.iterdir()} if by_id.is_dir() else {}
    devices = sorted(folder.glob("video[0-9]*"))
    return [
        FoundCamera("opencv", "", f"{device} {links.get(device.resolve(), '')}".strip()) for device in devices
    ]
