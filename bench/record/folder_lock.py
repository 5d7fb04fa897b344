"""A lock on a folder, so that one process at a time works in it.

The lock is held by the kernel (flock(2), `drivers.file_lock`) and ends with its process: a process that
died leaves no lock behind. To ask whether a folder is locked writes nothing.
"""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from bench.base.errors import RunFolderError, StorageError
from bench.record.storage import open_to_lock, storage_errors
from drivers import file_lock

_LOCK_TRIES, _LOCK_PAUSE_S = 4, 0.05  # Another process that only looks holds it for some ms


def lock_folder(path: Path) -> int:
    """Lock a folder against other processes until the descriptor is closed; RunFolderError if one has it."""
    with storage_errors(path):
        lock = open_to_lock(path)
    try:
        _lock_exclusively(lock)
    except OSError as error:
        os.close(lock)
        if error.errno not in {errno.EWOULDBLOCK, errno.EACCES}:
            raise StorageError(f"The folder cannot be locked: {error.strerror}.", where=str(path)) from error
        raise RunFolderError(
            f"Another process is working on this run: {error.strerror}.",
            where=str(path),
            remedy="Wait until that process ends, or stop it.",
        ) from error
    return lock


@contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Lock a folder for the block; waits for other processes."""
    with storage_errors(folder):
        lock = open_to_lock(folder)
    try:
        file_lock.lock(lock, wait=True)
        yield
    finally:
        os.close(lock)


def is_locked(path: Path) -> bool:
    """Return whether a process has locked a folder at this moment. Writes nothing."""
    with storage_errors(path):
        probe = open_to_lock(path)
        try:
            file_lock.lock(probe, shared=True)
        except BlockingIOError:
            return True
        finally:
            os.close(probe)
    return False


def suspended_process(path: Path) -> int:
    """Return the process that works in a folder, but is suspended, as after Ctrl-Z; 0 if none is."""
    with suppress(OSError):
        return file_lock.suspended_holder(path.stat().st_ino)
    return 0


def resume_process(process: int) -> str:
    """Return what a person does with a suspended process."""
    return (
        f"Process {process}, which works here, is suspended, as Ctrl-Z does it: nothing watches stage and light. To"
        f" let it continue: `fg` in its terminal, or `kill -CONT {process}`."
    )


def _lock_exclusively(descriptor: int) -> None:
    """Take the lock. Try again for a moment, because `is_locked` of another process takes it for an instant."""
    for _ in range(_LOCK_TRIES - 1):
        with suppress(BlockingIOError):
            file_lock.lock(descriptor)
            return
        time.sleep(_LOCK_PAUSE_S)
    file_lock.lock(descriptor)
