"""Keeps a camera to one process: a kernel's lock on a small file named after the camera. Touches no camera.

The makers' software refuses a second program at best late, and OpenCV not at all. The lock vanishes with its
process, however that ended; the empty file stays, and means nothing. Every driver that reaches the same camera must
name it alike.
"""

from __future__ import annotations

import hashlib
import os
import re
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Final

from drivers import file_lock
from drivers.errors import CameraBusy, CameraError

FOLDER_MODE: Final = 0o1777
"""Cameras are shared by the users of a computer: anybody may hold one, nobody may remove another's file."""


def event_camera(serial: str) -> str:
    """Name an event camera, so that all drivers that reach it by USB keep each other out."""
    return f"event camera {serial}"


def locks_folder() -> Path:
    """Where the files lie: one place for all users of this computer."""
    base = Path(tempfile.gettempdir()) if sys.platform == "win32" else Path("/tmp")  # noqa: S108 - TMPDIR may differ between users
    return base / "starbench-cameras"


class CameraHold:
    """A camera held by this process, until ``release`` or the end of the process.

    Parameters
    ----------
    camera
        What tells this camera from every other one: family and serial number, or the device's real path.
    folder
        Where the lock's file is put.

    Raises
    ------
    CameraBusy
        When another process, or another opener in this one, holds the camera.
    CameraError
        When the lock's file cannot be made.
    """

    def __init__(self, camera: str, *, folder: Path | None = None) -> None:
        self._descriptor = -1
        path = (locks_folder() if folder is None else folder) / _file_name(camera)
        try:
            _make_folder(path.parent)
            descriptor = _open(path)
        except OSError as error:
            raise CameraError(
                f"The lock that keeps it to one program cannot be made: {error.strerror}.",
                where=str(path),
                remedy="Remove that file, or let everybody write in its folder.",
            ) from error
        try:
            file_lock.lock(descriptor)
        except OSError as error:
            os.close(descriptor)
            raise CameraBusy(
                "Another program of this bench holds it.",
                where=f"camera {camera}",
                remedy="End the other run, or the program that shows the camera, then try again.",
            ) from error
        self._descriptor = descriptor

    def release(self) -> None:
        """Let others hold the camera; once more does no harm."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


def _file_name(camera: str) -> str:
    """Give a name that can be read, and is another one for every other camera.

    Examples
    --------
    >>> _file_name("evk4 00050423")
    'evk4-00050423-4642f8a7.lock'
    """
    readable = re.sub(r"[^A-Za-z0-9]+", "-", camera).strip("-")[:60]
    return f"{readable}-{hashlib.sha256(camera.encode()).hexdigest()[:8]}.lock"


def _make_folder(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    with suppress(PermissionError):  # somebody else's, who has set it so already
        folder.chmod(FOLDER_MODE)


def _open(path: Path) -> int:
    """Open the lock's file for whoever comes, never through a link."""
    flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0)
    try:
        descriptor = os.open(path, flags, 0o666)
    except PermissionError:
        # In a sticky folder the kernel lets nobody create over another user's file; it can still be locked.
        return os.open(path, flags & ~os.O_CREAT & ~os.O_RDWR | os.O_RDONLY)
    with suppress(PermissionError, AttributeError):
        os.fchmod(descriptor, 0o666)
    return descriptor
