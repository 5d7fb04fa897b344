"""Who works in a folder: one process at a time, by a lock of the kernel on the folder itself.

It dies with its process, so a dead one leaves none behind. Whoever only asks leaves no trace.
"""

from __future__ import annotations

import errno
import os
import time
from contextlib import suppress
from pathlib import Path

from bench.base.errors import RunFolderError, StorageError
from bench.records.storage import open_to_lock, storage_errors
from drivers import file_lock

_LOCK_TRIES, _LOCK_PAUSE_S = 4, 0.05


def lock_folder(path: Path) -> int:
    """Hold a folder against other processes, for as long as the descriptor returned is open.

    Raises
    ------
    RunFolderError
        When another process holds it.
    StorageError
        When it cannot be locked.
    """
    with storage_errors(path):
        lock = open_to_lock(path)
    try:
        _lock_exclusively(lock)
    except OSError as error:
        os.close(lock)
        if error.errno not in {errno.EWOULDBLOCK, errno.EACCES}:
            raise StorageError(f"It cannot be locked: {error.strerror}.", where=str(path)) from error
        raise RunFolderError(
            "Another process is working on this run.",
            where=str(path),
            remedy="Wait for it to end, or stop it.",
        ) from error
    return lock


def is_locked(path: Path) -> bool:
    """Whether a process holds a run folder at this moment. Leaves no trace there.

    Raises
    ------
    StorageError
        When the folder cannot be read.
    """
    with storage_errors(path):
        probe = open_to_lock(path)
        try:
            file_lock.lock(probe, shared=True)
        except BlockingIOError:
            return True
        finally:
            os.close(probe)
    return False


def _lock_exclusively(descriptor: int) -> None:
    """Take the lock; tried again for a moment, since whoever asks whether it is held touches it (is_worked_on)."""
    for _ in range(_LOCK_TRIES - 1):
        with suppress(BlockingIOError):
            file_lock.lock(descriptor)
            return
        time.sleep(_LOCK_PAUSE_S)
    file_lock.lock(descriptor)
