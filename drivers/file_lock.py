"""Lock an open file against other processes, by flock, or by msvcrt on Windows; say which process holds a lock.

Both locks belong to the kernel and vanish with their process, however it ended. No file's content is touched.

Who holds a lock is read from what Linux tells: process, user, since when, and the run folder. Nothing is written beside
the lock, so nothing can be left behind or be false. Where the system does not tell, as on another system or for a
process of another container, the text is empty. Sources: the manual pages proc(5), proc_locks(5) and proc_pid_stat(5).
"""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

_PROC: Final = Path("/proc")
_START_TIME: Final = 19
"""Position in ``/proc/PID/stat`` after the name of the program: field 22, clock ticks since the system booted."""
_MOST_LETTERS: Final = 200


def holder_text(inode: int) -> str:
    """Return who holds the exclusive lock of the file with this inode; empty if it is not known.

    Such as ``process 4711 of ada, since 2026-11-21 12:03 UTC, in /data/runs/cam7``.
    """
    with suppress(OSError, ValueError, IndexError):
        locks = list(_locks())
        for process, locked in locks:
            if locked == inode and process > 0:
                return _process_text(process, frozenset(other for one, other in locks if one == process))
    return ""


def _locks() -> Iterator[tuple[int, int]]:
    """Yield process and inode of each exclusive flock(2). Devices are left out: layered file systems have several."""
    for line in (_PROC / "locks").read_text("ascii").splitlines():
        fields = line.split()
        if fields[1] == "FLOCK" and fields[3] == "WRITE":
            yield int(fields[4]), int(fields[5].rpartition(":")[2])


def _process_text(process: int, locked: frozenset[int]) -> str:
    """Return user, start and work of a process; other users may not see which folder it has locked."""
    home = _PROC / str(process)
    fields = (home / "stat").read_text("utf-8", "replace").rpartition(")")[2].split()
    up_s = float((_PROC / "uptime").read_text("ascii").split()[0])
    begun_s = time.time() - up_s + int(fields[_START_TIME]) / os.sysconf("SC_CLK_TCK")
    begun = datetime.fromtimestamp(begun_s, UTC)
    work = _locked_folder(home, locked)
    if not work:
        words = (home / "cmdline").read_bytes().decode("utf-8", "replace").split("\0")
        work = f"`{' '.join(words).strip()[:_MOST_LETTERS]}`"
    return f"process {process} of {_user(home.stat().st_uid)}, since {begun:%Y-%m-%d %H:%M} UTC, in {work}"


def _locked_folder(home: Path, locked: frozenset[int]) -> str:
    with suppress(OSError):
        for one in (home / "fd").iterdir():
            with suppress(OSError):
                if one.stat().st_ino in locked and one.is_dir():
                    return str(one.readlink())
    return ""


def _user(number: int) -> str:
    try:
        import pwd

        return pwd.getpwuid(number).pw_name
    except (ImportError, KeyError):
        return f"user {number}"


_HELD: Final = {errno.EWOULDBLOCK, errno.EACCES, errno.EDEADLK}

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
