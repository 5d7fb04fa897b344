"""Find the cameras that are connected, by every driver whose software is installed. No camera is opened."""

from __future__ import annotations

from drivers.camera import FoundCamera, metavision_discovery, neuromorphic_evk4
from drivers.camera.frame_cameras import video_devices
from drivers.errors import DriverError


def find_cameras() -> tuple[list[FoundCamera], list[str]]:
    """List the connected cameras, once for each driver that could use them; and sentences about missing software."""
    cameras: list[FoundCamera] = []
    missing: list[str] = []
    for discover in (metavision_discovery.discover, neuromorphic_evk4.discover):
        try:
            cameras += discover()
        except DriverError as error:
            missing.append(str(error))
    return cameras + video_devices(), missing
