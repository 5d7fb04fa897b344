"""Which cameras are connected, asked of every driver whose software is installed; opens none of them."""

from __future__ import annotations

from drivers.camera import FoundCamera, metavision, neuromorphic_evk4
from drivers.camera.video_devices import video_devices
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
