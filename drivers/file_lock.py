"""Lock a file or a device against other processes, by flock, or by msvcrt on Windows; say which process holds a lock.

A device is locked by a small file that is named after it, because several ports may reach it; every user must name it
alike. Cameras need that too: OpenCV refuses no second program. Locks belong to the kernel and vanish with their
process. Who holds one is what Linux tells, or empty (proc(5), proc_locks(5), proc_pid_stat(5)).
"""

from __future__ import annotations

import errno
import hashlib
import os
import re
import stat
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import ClassVar, Final

from drivers.errors import CameraBusy, CameraError, DriverError, PortBusy, PortDenied

_PROC: Final = Path("/proc")
_START_TIME: Final = 19
"""Position in ``/proc/PID/stat`` after the name of the program: field 22, clock ticks since the system booted."""
_MOST_LETTERS: Final = 200  # A command line as a message can show it
_HELD: Final = {errno.EWOULDBLOCK, errno.EACCES, errno.EDEADLK}

FOLDER_VARIABLE: Final = "STARBENCH_LOCKS"
"""Environment variable that names another folder: one that containers share, or one for a single test."""
_SHARED_FOLDERS: Final = (Path("/run/lock"), Path("/tmp"))  # noqa: S108 - never trusted by its name: see _is_shared


def holder_text(inode: int) -> str:
    """Return who holds the exclusive lock of the file with this inode; empty if it is not known.

    Such as ``process 4711 of ada, since 2026-11-21 12:03 UTC, in /data/runs/cam7``.
    """
    with suppress(OSError, ValueError, IndexError):
        locks = list(_locks())
        for process, locked in locks:
            if locked == inode and process > 0:
                return _process_text(
                    process, frozenset(other for holder, other in locks if holder == process)
                )
    return ""


def suspended_holder(inode: int) -> int:
    """Return the process that holds the exclusive lock of the file with this inode and is suspended; 0 if none is."""
    with suppress(OSError, ValueError, IndexError):
        for process, locked in _locks():
            if locked == inode and process > 0 and _is_suspended(_stat_fields(process)):
                return process
    return 0


def _stat_fields(process: int) -> list[str]:
    """Return ``/proc/PID/stat`` after the name of the program."""
    return (_PROC / str(process) / "stat").read_text("utf-8", "replace").rpartition(")")[2].split()


def _is_suspended(fields: Sequence[str]) -> bool:
    """Return whether Ctrl-Z or SIGSTOP has stopped a process, by its state."""
    return fields[0] == "T"


def _locks() -> Iterator[tuple[int, int]]:
    """Yield process and inode of each exclusive flock(2). Devices are left out: layered file systems have several."""
    for line in (_PROC / "locks").read_text("ascii").splitlines():
        fields = line.split()
        if fields[1] == "FLOCK" and fields[3] == "WRITE":
            yield int(fields[4]), int(fields[5].rpartition(":")[2])


def _process_text(process: int, locked: frozenset[int]) -> str:
    """Return user, start and work of a process; other users may not see which folder it has locked."""
    home = _PROC / str(process)
    fields = _stat_fields(process)
    up_s = float((_PROC / "uptime").read_text("ascii").split()[0])
    begun_s = time.time() - up_s + int(fields[_START_TIME]) / os.sysconf("SC_CLK_TCK")
    begun = datetime.fromtimestamp(begun_s, UTC)
    work = _locked_folder(home, locked)
    if not work:
        words = (home / "cmdline").read_bytes().decode("utf-8", "replace").split("\0")
        work = f"`{' '.join(words).strip()[:_MOST_LETTERS]}`"
    since = f"since {begun:%Y-%m-%d %H:%M} UTC{', suspended' if _is_suspended(fields) else ''}"
    return f"process {process} of {_user(home.stat().st_uid)}, {since}, in {work}"


def _locked_folder(home: Path, locked: frozenset[int]) -> str:
    with suppress(OSError):
        for link in (home / "fd").iterdir():
            with suppress(OSError):
                if link.stat().st_ino in locked and link.is_dir():
                    return str(link.readlink())
    return ""


def _user(number: int) -> str:
    try:
        import pwd

        return pwd.getpwuid(number).pw_name
    except (ImportError, KeyError):
        return f"user {number}"


try:
    import fcntl
except ImportError:  # Windows
    import msvcrt

    _PAUSE_S: Final = 0.02

    def _take(descriptor: int, *, shared: bool, wait: bool) -> None:  # noqa: ARG001
        """Lock the first byte. Windows has no shared lock, so those who would share it take turns."""
        while True:
            os.lseek(descriptor, 0, os.SEEK_SET)
            try:
                msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined, unused-ignore]
            except OSError as error:
                if not wait or error.errno not in _HELD:
                    raise
            else:
                return
            time.sleep(_PAUSE_S)

else:

    def _take(descriptor: int, *, shared: bool, wait: bool) -> None:
        kind = fcntl.LOCK_SH if shared else fcntl.LOCK_EX
        fcntl.flock(descriptor, kind if wait else kind | fcntl.LOCK_NB)


def lock(descriptor: int, *, shared: bool = False, wait: bool = False) -> None:
    """Lock an open file until it is closed. Locking the same descriptor again does no harm.

    On Windows the file must be open for writing. ``wait`` waits without limit; else a lock of another process raises
    `BlockingIOError`, whose ``strerror`` says which one.
    """
    try:
        _take(descriptor, shared=shared, wait=wait)
    except OSError as error:
        if error.errno not in _HELD:
            raise
        holder = "" if shared else holder_text(os.fstat(descriptor).st_ino)
        raise BlockingIOError(errno.EWOULDBLOCK, holder or "another process") from error


def event_camera_name(serial: str) -> str:
    """Return the lock name of an event camera, so that all drivers that reach it by USB exclude each other."""
    return f"event camera {serial}"


def locks_folder(shared: Sequence[Path] = _SHARED_FOLDERS) -> Path:
    """Return the folder of the lock files, if possible the same one for all users of this computer.

    It is the one that ``STARBENCH_LOCKS`` names; else the first of ``shared`` in which the system lets every user make
    files and nobody remove those of another; else the user's runtime folder (XDG Base Directory Specification), or the
    user's temporary folder: then only this user's programs exclude each other.
    """
    if folder := os.environ.get(FOLDER_VARIABLE):
        return Path(folder)
    own = os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir()
    return next((shared_folder for shared_folder in shared if _is_shared(shared_folder)), Path(own))


def _is_shared(folder: Path) -> bool:
    """Return whether a folder is the system's own, sticky, and open to all; then no user can replace it by a link."""
    if sys.platform == "win32":
        return False
    try:
        status = folder.lstat()
    except OSError:
        return False
    open_and_sticky = stat.S_ISVTX | stat.S_IWOTH
    return (
        stat.S_ISDIR(status.st_mode)
        and status.st_uid == 0
        and status.st_mode & open_and_sticky == open_and_sticky
    )


class DeviceHold:
    """A device reserved for this process, until ``release`` or the end of the process.

    ``device`` is a unique name: family and serial number, or its real path. The default of ``folder`` is
    ``locks_folder()``. Raises `PortDenied` if the lock file cannot be made.
    """

    # Raised if another program has the device; of its own family in a subclass.
    BUSY: ClassVar[type[DriverError]] = PortBusy
    # Raised if this user may not lock it; of its own family in a subclass.
    DENIED: ClassVar[type[DriverError]] = PortDenied

    def __init__(self, device: str, *, folder: Path | None = None) -> None:
        self._descriptor = -1
        path = (locks_folder() if folder is None else folder) / _file_name(device)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._descriptor = _open(path)
            lock(self._descriptor)
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
                f"The lock file of a device cannot be used: {error.strerror}.",
                where=str(path),
                remedy=f"Remove this file, or name a folder in {FOLDER_VARIABLE} that you may write in.",
            ) from error

    def release(self) -> None:
        """Give the device free for others. A second call does nothing."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


def _file_name(device: str) -> str:
    """Return a readable file name that is different for every device, and the same in capitals and small letters.

    >>> _file_name("evk4 00050423")
    'starbench-evk4-00050423-4642f8a7.lock'
    """
    device = device.casefold()
    readable = re.sub("[^a-z0-9]+", "-", device).strip("-")[:60]
    return f"starbench-{readable}-{hashlib.sha256(device.encode()).hexdigest()[:8]}.lock"


def _open(path: Path) -> int:
    """Open the lock file for every user: a plain file, never through a link; only the own file's mode is set."""
    flags = os.O_RDWR | os.O_CREAT
    extra = sum(getattr(os, name, 0) for name in ("O_NOFOLLOW", "O_NONBLOCK", "O_CLOEXEC"))
    try:
        descriptor = os.open(path, flags | extra, 0o666)
    except PermissionError:
        # In a sticky folder the kernel lets nobody create over another user's file; it can still be locked.
        descriptor = os.open(path, os.O_RDONLY | extra)
    except OSError as error:
        if error.errno == errno.ELOOP:  # O_NOFOLLOW: it is a link
            raise _not_a_lock_file(path) from error
        raise
    status = os.fstat(descriptor)
    if not stat.S_ISREG(status.st_mode) or status.st_nlink > 1:
        os.close(descriptor)
        raise _not_a_lock_file(path)
    if hasattr(os, "fchmod") and status.st_uid == os.geteuid():
        os.fchmod(descriptor, 0o666)
    return descriptor


def _not_a_lock_file(path: Path) -> OSError:
    return OSError(errno.EPERM, "something else has its name, such as a link", str(path))


class CameraLock(DeviceHold):
    """A camera locked by this process, until ``release`` or the end of the process.

    Raises `CameraBusy` if another process, or another driver object in this one, holds the lock.
    """

    BUSY: ClassVar[type[DriverError]] = CameraBusy
    DENIED: ClassVar[type[DriverError]] = CameraError
