"""Write a new RAW file to disk: never over another file, written once, synced.

A converted file appears complete or not at all (`new_file`). A recording stays as far as it was written.
"""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Final, Self

from drivers import durable
from drivers.durable import O_BINARY, sync_folder
from drivers.errors import RecordingFailed, RecordingFileError
from drivers.new_output import new_output

FULL_BYTES: Final = 1 << 20
"""A disk with less free space than this counts as full."""

_REMEDIES: Final = {
    errno.EEXIST: ("The file exists already", "Files are never overwritten: choose another name."),
    errno.ENOSPC: ("The disk is full", "Free space on that disk, then try again."),
    errno.EDQUOT: ("The disk quota is used up", "Free space within the quota, then try again."),
    errno.EACCES: ("This user has no write permission", "Give yourself write permission on the folder."),
    errno.EPERM: ("This user has no write permission", "Give yourself write permission on the folder."),
    errno.EROFS: ("The disk is read-only", "Use a disk that can be written."),
    errno.ENOENT: ("There is no such folder", "Make the folder first."),
    errno.ENOTDIR: ("A part of the path is no folder", "Check the path."),
}


@contextmanager
def new_file(path: Path) -> Iterator[Path]:
    """Provide a path to write to, as `drivers.new_output`; RecordingFileError if the file cannot be written."""
    try:
        with new_output(path) as part:
            yield part
    except OSError as error:
        raise write_error(path, error) from error


def reason(error: OSError) -> str:
    """Return the system's reason in brackets, if there is one; libraries put long texts of their own into errors."""
    return f" ({os.strerror(error.errno)})" if error.errno else ""


def write_error(path: Path, error: OSError) -> RecordingFileError:
    """Build the error of a file that cannot be written, with the system's reason."""
    what, remedy = _REMEDIES.get(
        error.errno or 0,
        (
            f"The file cannot be written{reason(error)}",
            "Check that its folder exists, that you may write to it, and that the disk has space.",
        ),
    )
    if isinstance(error, BlockingIOError):
        what, remedy = f"Another process is writing it now: {error.strerror}", "Wait until that process ends."
    return RecordingFileError(f"{what}.", where=str(path), remedy=remedy)


class RawWriter:
    """A new file that begins with ``header``. Its ``with`` statement syncs and closes it in any case.

    Raises `RecordingFailed` if the file exists, cannot be made, or the disk does not accept the data; what was written
    stays.
    """

    def __init__(self, path: Path, header: bytes) -> None:
        self.path = path
        self.bytes_written = 0
        try:
            self._handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | O_BINARY, 0o644)
        except OSError as error:
            raise recording_write_error(path, error) from error
        try:
            self.write(header)
        except RecordingFailed:
            os.close(self._handle)
            raise

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Append all data, or raise `RecordingFailed`."""
        rest = memoryview(data)
        try:
            while rest:
                written = os.write(self._handle, rest)
                self.bytes_written += written
                rest = rest[written:]
        except OSError as error:
            raise recording_write_error(self.path, error) from error

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
            if error is None:  # else the first failure is the one to report
                raise recording_write_error(self.path, failed) from failed
        finally:
            os.close(self._handle)


def check_new(path: Path) -> None:
    """Raise `RecordingFailed` if the file exists, or its folder is missing or may not be written."""
    code = 0
    try:
        if path.exists():
            code = errno.EEXIST
        elif not path.parent.is_dir():
            code = errno.ENOENT
        elif not os.access(path.parent, os.W_OK):
            code = errno.EACCES
    except OSError as error:  # no permission on a parent folder
        raise recording_write_error(path, error) from error
    if code:
        raise recording_write_error(path, OSError(code, os.strerror(code)))


def check_space(path: Path) -> None:
    """Raise `RecordingFailed` if less than ``FULL_BYTES`` are free on the disk of a file."""
    if shutil.disk_usage(path.parent).free < FULL_BYTES:
        raise recording_write_error(path, OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))


def sync_file(path: Path) -> None:
    """Sync a file that another program wrote, and its name. A file that does not exist is ignored."""
    try:
        if not path.exists():
            return
        durable.sync_file(path)
        sync_folder(path.parent)
    except OSError as error:
        raise recording_write_error(path, error) from error


def recording_write_error(path: Path, error: OSError) -> RecordingFailed:
    """Build the error of a recording that cannot be written."""
    otherwise = (f"The file cannot be written{reason(error)}", "Check the disk.")
    what, remedy = _REMEDIES.get(error.errno or 0, otherwise)
    kept = (
        " What was recorded before is kept." if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EIO) else ""
    )
    return RecordingFailed(f"{what}.{kept}", where=str(path), remedy=remedy)
