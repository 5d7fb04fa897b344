"""Find the cameras that are connected, by every driver whose software is installed. No camera is opened."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from drivers.camera import FoundCamera, metavision_discovery, neuromorphic_evk4
from drivers.camera.frame_cameras import video_devices
from drivers.errors import CameraSoftwareMissing, DriverError

_SOFTWARE: Final[Mapping[str, Callable[[], object]]] = {
    "metavision": metavision_discovery.vendor_software,
    "neuromorphic_evk4": neuromorphic_evk4.import_package,
}
"""What imports the software of other makers that a driver needs."""


def missing_software(driver: str) -> list[str]:
    """Return, as sentences, which software of other makers a driver of a camera needs and this computer lacks."""
    try:
        if driver in _SOFTWARE:
            _SOFTWARE[driver]()
    except CameraSoftwareMissing as error:
        return [str(error)]
    return []


def find_cameras() -> tuple[list[FoundCamera], list[str]]:
    """List the connected cameras, once for each driver that could use them; and sentences about missing software."""
    found: list[FoundCamera] = []
    missing: list[str] = []
    for discover in (metavision_discovery.discover, neuromorphic_evk4.discover):
        try:
            found += discover()
        except DriverError as error:
            missing.append(str(error))
    return found + video_devices(), missing
