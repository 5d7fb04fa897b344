"""Reserve a device for one process: a lock of the kernel on a small file that is named after the device.

A lock on a port is not enough, because one device can be reached by several ports: over a network, by a second cable,
under another name. Every user of a device must therefore name it alike. The lock vanishes with its process, however
the process ended. The empty file stays, and its presence means nothing. This module touches no device.

Cameras need such a lock as well: the makers' software refuses a second program late at best, and OpenCV does not refuse
it at all.
"""

from __future__ import annotations

import hashlib
import os
import re
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import ClassVar, Final

from drivers import file_lock
from drivers.errors import CameraBusy, CameraError, DriverError, PortBusy, PortDenied


def event_camera_name(serial: str) -> str:
    """Return the lock name of an event camera, so that all drivers that reach it by USB exclude each other."""
    return f"event camera {serial}"


FOLDER_MODE: Final = 0o1777
"""All users of a computer share its devices: everybody may lock one, nobody may remove another user's file."""
FOLDER_VARIABLE: Final = "STARBENCH_LOCKS"
"""Environment variable that names another folder: one that containers share, or one for a single test."""


def locks_folder() -> Path:
    """Return the folder of the lock files, the same one for all users of this computer.

    It is the one that ``STARBENCH_LOCKS`` names, else ``starbench-devices`` in the system's temporary folder.
    """
    if folder := os.environ.get(FOLDER_VARIABLE):
        return Path(folder)
    base = Path(tempfile.gettempdir()) if sys.platform == "win32" else Path("/tmp")  # noqa: S108 - TMPDIR may differ between users
    return base / "starbench-devices"


class DeviceHold:
    """A device reserved for this process, until ``release`` or the end of the process.

    ``device`` is a unique name: family and serial number, or its real path; ``folder`` None stands for
    ``locks_folder()``. Raises `PortDenied` if the lock file cannot be made.
    """

    # BUSY, DENIED: Errors that are raised; a subclass may name errors of its own family.
    BUSY: ClassVar[type[DriverError]] = PortBusy
    DENIED: ClassVar[type[DriverError]] = PortDenied

    def __init__(self, device: str, *, folder: Path | None = None) -> None:
        self._descriptor = -1
        path = (locks_folder() if folder is None else folder) / _file_name(device)
        try:
            _make_folder(path.parent)
            self._descriptor = _open(path)
            file_lock.lock(self._descriptor)
        except BlockingIOError as error:
            self.release()
            raise self.BUSY(
                f"Another program holds it, perhaps through another port: {error.strerror}.",
                where=device,
                remedy="End the other run, or the program that uses it, then try again.",
            ) from error
        except OSError as error:
            self.release()
            raise self.DENIED(
                f"The lock file of a device cannot be made: {error.strerror}.",
                where=str(path),
                remedy="Remove this file, let all users write in its folder, or name another folder in"
                f" {FOLDER_VARIABLE}.",
            ) from error

    def release(self) -> None:
        """Give the device free for others. A second call does nothing."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


def _file_name(device: str) -> str:
    """Return a readable file name that is different for every device.

    >>> _file_name("evk4 00050423")
    'evk4-00050423-4642f8a7.lock'
    """
    readable = re.sub(r"[^A-Za-z0-9]+", "-", device).strip("-")[:60]
    return f"{readable}-{hashlib.sha256(device.encode()).hexdigest()[:8]}.lock"


def _make_folder(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    with suppress(PermissionError):  # the folder of another user, who has set its mode
        folder.chmod(FOLDER_MODE)


def _open(path: Path) -> int:
    """Open the lock file for every user, never through a symbolic link."""
    flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0)
    try:
        descriptor = os.open(path, flags, 0o666)
    except PermissionError:
        # In a sticky folder the kernel lets nobody create over another user's file; it can still be locked.
        return os.open(path, flags & ~os.O_CREAT & ~os.O_RDWR | os.O_RDONLY)
    with suppress(PermissionError, AttributeError):
        os.fchmod(descriptor, 0o666)
    return descriptor


class CameraLock(DeviceHold):
    """A camera locked by this process, until ``release`` or the end of the process.

    Raises `CameraBusy` if another process, or another driver object in this one, holds the lock.
    """

    BUSY: ClassVar[type[DriverError]] = CameraBusy
    DENIED: ClassVar[type[DriverError]] = CameraError
