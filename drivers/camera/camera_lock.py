"""Lock a camera for this process, by a name that all drivers of the same camera use (see `drivers.device_hold`).

The makers' software refuses a second program late at best, and OpenCV does not refuse it at all.
"""

from __future__ import annotations

from typing import ClassVar

from drivers.device_hold import DeviceHold
from drivers.errors import CameraBusy, CameraError, DriverError


def event_camera_name(serial: str) -> str:
    """Return the lock name of an event camera, so that all drivers that reach it by USB exclude each other."""
    return f"event camera {serial}"


class CameraLock(DeviceHold):
    """A camera locked by this process, until ``release`` or the end of the process.

    Raises CameraBusy: If another process, or another driver object in this one, holds the lock.
    Raises CameraError: If the lock file cannot be made.
    """

    BUSY: ClassVar[type[DriverError]] = CameraBusy
    DENIED: ClassVar[type[DriverError]] = CameraError
