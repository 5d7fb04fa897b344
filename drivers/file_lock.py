"""Knows how this platform locks an open file against other processes: flock, or msvcrt where there is none.

Either lock is the kernel's, and vanishes with its process, however that ended. Touches no file's content.
"""

from __future__ import annotations

import errno
import os
import time
from typing import Final

_HELD: Final = {errno.EWOULDBLOCK, errno.EACCES, errno.EDEADLK}

try:
    import fcntl
except ImportError:  # Windows
    import msvcrt

    _PAUSE_S: Final = 0.02

    def _take(descriptor: int, *, shared: bool, wait: bool) -> None:  # noqa: ARG001
        """Lock the first byte. There is no shared lock: those who would share take turns."""
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
    """Lock an open file until it is closed. A second lock of the same descriptor does no harm.

    Parameters
    ----------
    descriptor
        Of the open file; where there is no flock, one that may be written to.
    shared
        Whether it may be shared with others that share it.
    wait
        Whether to wait for whoever holds it, however long.

    Raises
    ------
    BlockingIOError
        When another process holds it.
    OSError
        When it cannot be locked at all.
    """
    try:
        _take(descriptor, shared=shared, wait=wait)
    except OSError as error:
        if error.errno not in _HELD:
            raise
        raise BlockingIOError(errno.EWOULDBLOCK, "another process holds it") from error
