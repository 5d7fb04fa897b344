"""Keeps a camera to one process, and says how cameras are named for that (see `drivers.device_hold`).

The makers' software refuses a second program at best late, and OpenCV not at all.
"""

from __future__ import annotations

from typing import ClassVar

from drivers.device_hold import DeviceHold
from drivers.errors import CameraBusy, CameraError, DriverError


def event_camera_name(serial: str) -> str:
    """Name an event camera, so that all drivers that reach it by USB keep each other out."""
    return f"event camera {serial}"


class CameraLock(DeviceHold):
    """A camera held by this process, until ``release`` or the end of the process.

    Raises
    ------
    CameraBusy
        When another process, or another opener in this one, holds the camera.
    CameraError
        When the lock's file cannot be made.
    """

    BUSY: ClassVar[type[DriverError]] = CameraBusy
    DENIED: ClassVar[type[DriverError]] = CameraError
