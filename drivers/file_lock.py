"""Lock an open file against other processes: by flock, or by msvcrt on Windows.

Both locks belong to the kernel and vanish with their process, however it ended. No file's content is touched.
"""

from __future__ import annotations

import errno
import os
import time
from typing import Final

from drivers.lock_holder import holder_text

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

    descriptor: Descriptor of the open file; on Windows the file must be open for writing.
    wait: Wait, without limit, until no other process holds the lock.
    Raises BlockingIOError: Another process holds the lock; the error's ``strerror`` says which one.
    Raises OSError: The file cannot be locked.
    """
    try:
        _take(descriptor, shared=shared, wait=wait)
    except OSError as error:
        if error.errno not in _HELD:
            raise
        holder = "" if shared else holder_text(os.fstat(descriptor).st_ino)
        raise BlockingIOError(errno.EWOULDBLOCK, holder or "another process") from error
