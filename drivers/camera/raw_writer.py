"""A new RAW file on disk: never over another one, written once, synced; knows no camera."""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path
from types import TracebackType
from typing import Final, Self

from drivers.errors import RecordingFailed

FULL_BYTES: Final = 1 << 20
"""A disk with less free space than this is taken for full."""

_BINARY: Final = getattr(os, "O_BINARY", 0)  # only Windows knows other files
_FOLDERS_OPEN: Final = hasattr(os, "O_DIRECTORY")
_TO_SYNC: Final = os.O_RDONLY if _FOLDERS_OPEN else os.O_RDWR  # Windows syncs no file open for reading alone

_REMEDIES: Final = {
    errno.EEXIST: ("There is such a file already", "Recordings are never overwritten: choose another name."),
    errno.ENOSPC: ("The disk is full", "Free space on that disk, then record again."),
    errno.EDQUOT: ("The disk quota is used up", "Free space within the quota, then record again."),
    errno.EACCES: ("This user may not write there", "Give yourself write permission on the folder."),
    errno.EPERM: ("This user may not write there", "Give yourself write permission on the folder."),
    errno.EROFS: ("That disk is read-only", "Record to a disk that can be written."),
    errno.ENOENT: ("There is no such folder", "Make the folder first."),
    errno.ENOTDIR: ("A part of its path is no folder", "Check the path."),
}


class RawWriter:
    """A file that did not exist before; used in a ``with`` statement, which syncs and closes it in any case.

    Parameters
    ----------
    path
        Where to make it.
    header
        Its first bytes.

    Raises
    ------
    RecordingFailed
        When it exists, cannot be made, or the disk does not take what it is given; what was written stays.
    """

    def __init__(self, path: Path, header: bytes) -> None:
        self.path = path
        self.bytes_written = 0
        try:
            self._handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | _BINARY, 0o644)
        except OSError as error:
            raise disk_refused(path, error) from error
        try:
            self.write(header)
        except RecordingFailed:
            os.close(self._handle)
            raise

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Append all of it."""
        rest = memoryview(data)
        try:
            while rest:
                written = os.write(self._handle, rest)
                self.bytes_written += written
                rest = rest[written:]
        except OSError as error:
            raise disk_refused(self.path, error) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            os.fsync(self._handle)
            sync_folder(self.path.parent)
        except OSError as failed:
            if error is None:  # else the first failure is the one to tell
                raise disk_refused(self.path, failed) from failed
        finally:
            os.close(self._handle)


def check_new(path: Path) -> None:
    """Raise RecordingFailed when there is such a file already, or its folder is missing or may not be written."""
    code = 0
    try:
        if path.exists():
            code = errno.EEXIST
        elif not path.parent.is_dir():
            code = errno.ENOENT
        elif not os.access(path.parent, os.W_OK):
            code = errno.EACCES
    except OSError as error:  # a folder above it that may not be looked into
        raise disk_refused(path, error) from error
    if code:
        raise disk_refused(path, OSError(code, os.strerror(code)))


def check_space(path: Path) -> None:
    """Raise RecordingFailed when the disk of a file is full."""
    if shutil.disk_usage(path.parent).free < FULL_BYTES:
        raise disk_refused(path, OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))


def sync_file(path: Path) -> None:
    """Sync a file that another program wrote, and its name; a file that is not there needs none."""
    try:
        if not path.exists():
            return
        handle = os.open(path, _TO_SYNC)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
        sync_folder(path.parent)
    except OSError as error:
        raise disk_refused(path, error) from error


def sync_folder(folder: Path) -> None:
    """Sync a folder, so that a new file's name is on disk as well; Windows has no such thing."""
    if not _FOLDERS_OPEN:
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def disk_refused(path: Path, error: OSError) -> RecordingFailed:
    """Say in words why a recording could not be written."""
    otherwise = (f"It cannot be written ({error.strerror or error})", "Check the disk it lies on.")
    what, remedy = _REMEDIES.get(error.errno or 0, otherwise)
    kept = (
        " What was recorded before is kept." if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EIO) else ""
    )
    return RecordingFailed(f"{what}.{kept}", where=str(path), remedy=remedy)
