"""Keeps a device to one process by who it is: a kernel's lock on a small file named after it. Touches no device.

A port's lock does not know a device that is reached by another port as well: over a network, by a second cable, by
another name. The lock vanishes with its process, however that ended; the empty file stays, and means nothing. Whoever
reaches the same device must name it alike.
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
from drivers.errors import DriverError, PortBusy, PortDenied

FOLDER_MODE: Final = 0o1777
"""Devices are shared by the users of a computer: anybody may hold one, nobody may remove another's file."""
FOLDER_VARIABLE: Final = "STARBENCH_LOCKS"
"""Names another folder: one that containers share, or one that a test has for itself."""


def locks_folder() -> Path:
    """Where the files lie: one place for all users of this computer."""
    if folder := os.environ.get(FOLDER_VARIABLE):
        return Path(folder)
    base = Path(tempfile.gettempdir()) if sys.platform == "win32" else Path("/tmp")  # noqa: S108 - TMPDIR may differ between users
    return base / "starbench-devices"


class DeviceHold:
    """A device held by this process, until ``release`` or the end of the process.

    Parameters
    ----------
    device
        What tells this device from every other one: family and serial number, or its real path.
    folder
        Where the lock's file is put; None for ``locks_folder()``.

    Raises
    ------
    PortBusy
        When another process, or another opener in this one, holds the device.
    PortDenied
        When the lock's file cannot be made.
    """

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
                "Another program of this bench holds it, perhaps by another port.",
                where=device,
                remedy="End the other run, or the program that uses it, then try again.",
            ) from error
        except OSError as error:
            self.release()
            raise self.DENIED(
                f"The lock that keeps it to one program cannot be made: {error.strerror}.",
                where=str(path),
                remedy=f"Remove that file, let everybody write in its folder, or name another by {FOLDER_VARIABLE}.",
            ) from error

    def release(self) -> None:
        """Let others hold the device; once more does no harm."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


def _file_name(device: str) -> str:
    """Give a name that can be read, and is another one for every other camera.

    Examples
    --------
    >>> _file_name("evk4 00050423")
    'evk4-00050423-4642f8a7.lock'
    """
    readable = re.sub(r"[^A-Za-z0-9]+", "-", device).strip("-")[:60]
    return f"{readable}-{hashlib.sha256(device.encode()).hexdigest()[:8]}.lock"


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
