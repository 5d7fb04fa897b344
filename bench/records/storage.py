"""Writing so that it lasts: whole files or none, synced with their folder, failures in plain words.

Knows the file system and nothing of runs. Every file of ours goes to disk through here or through the
journal; whoever writes elsewhere (a camera, HDF5) has its file put in place by ``move_into_place``.
"""

from __future__ import annotations

import errno
import hashlib
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from bench.base.errors import StorageError

HASH_CHUNK_BYTES = 1 << 20
TEMPORARY = ".tmp"

_FOLDERS_OPEN = hasattr(os, "O_DIRECTORY")
O_BINARY = getattr(os, "O_BINARY", 0)
"""Flag of ``os.open``: without it Windows writes two bytes for each line feed."""
_TO_SYNC = os.O_RDONLY if _FOLDERS_OPEN else os.O_RDWR
"""Windows syncs no file that is open for reading alone."""

_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_DENIED = {errno.EACCES, errno.EPERM, errno.EROFS}
_NOWHERE = {errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.ENAMETOOLONG, errno.ELOOP}


@contextmanager
def storage_errors(where: Path) -> Iterator[None]:
    """Turn an OSError of the block into a StorageError that says what to do.

    Parameters
    ----------
    where
        The file or folder being written; named in the message unless the error names another.

    Raises
    ------
    StorageError
        For any OSError raised inside.
    """
    try:
        yield
    except OSError as error:
        place = str(error.filename or where)
        if error.errno in _FULL:
            what, remedy = "The disk is full.", "Make room; a run then goes on with `starbench resume`."
        elif error.errno in _DENIED:
            what, remedy = "No permission.", "Change its mode or owner, or use another folder."
        elif error.errno in _NOWHERE:
            what, remedy = f"It cannot lie there: {error.strerror or error}.", "Check the path."
        else:
            what = f"The file system refused: {error.strerror or error}."
            remedy = "Check the disk (dmesg, SMART) before going on."
        raise StorageError(what, where=place, remedy=remedy) from error


def sync_folder(folder: Path) -> None:
    """Make the names in a folder last through a power cut, where folders can be synced: not on Windows."""
    if not _FOLDERS_OPEN:
        return
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_file(path: Path) -> None:
    """Make what a file holds last through a power cut. Raises OSError."""
    descriptor = os.open(path, _TO_SYNC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def open_to_lock(folder: Path) -> int:
    """Open a folder itself to lock it (see `drivers.file_lock`); a hidden file beside it where folders cannot be.

    Raises
    ------
    OSError
        When it cannot be opened.
    """
    if _FOLDERS_OPEN:
        return os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    return os.open(folder.with_name(f".{folder.name}.lock"), os.O_RDWR | os.O_CREAT)


def make_folder(folder: Path) -> None:
    """Make a folder and its parents, each name synced.

    Raises
    ------
    StorageError
        When one of them is a file, or cannot be made.
    """
    with storage_errors(folder):
        missing = [p for p in (folder, *folder.parents) if not p.exists()]
        for path in reversed(missing):
            path.mkdir(exist_ok=True)
            sync_folder(path.parent)
        if not folder.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(folder))


def write_all(descriptor: int, data: bytes) -> None:
    """Write every byte; ``os.write`` alone may stop short. Raises OSError."""
    view = memoryview(data)
    while view:
        view = view[os.write(descriptor, view) :]


def write_atomic(path: Path, data: bytes, *, mode: int = 0o644) -> None:
    """Write a file so that its name holds either all of ``data`` or what it held before.

    Temporary file beside it, fsync, rename, fsync of the folder.

    Raises
    ------
    StorageError
        Disk full, no permission, or any other failure; ``path`` is as before.
    """
    part = path.with_name(f".{path.name}{TEMPORARY}")
    with storage_errors(path):
        part.unlink(missing_ok=True)
        try:
            _write_new(part, data, mode)
            part.replace(path)
        except OSError:
            with suppress(OSError):  # the first error is the one to tell
                part.unlink()
            raise
        sync_folder(path.parent)


def remove(path: Path) -> None:
    """Remove whatever lies there, a folder with all in it too; of a link, the link alone. Raises OSError."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink()


def is_temporary(path: Path) -> bool:
    """Whether a file is one that ``write_atomic`` was writing when its process died."""
    return path.name.startswith(".") and path.name.endswith(TEMPORARY)


def move_into_place(part: Path, path: Path) -> None:
    """Give a file written by somebody else its final name: fsync, rename, fsync of the folder.

    Raises
    ------
    StorageError
        When it cannot be synced or renamed.
    """
    with storage_errors(part):
        sync_file(part)
        part.rename(path)
        sync_folder(path.parent)


def sha256_of(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal; memory stays bounded. Raises OSError."""
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        while chunk := stream.read(HASH_CHUNK_BYTES):
            digest.update(chunk)
    return digest.hexdigest()


def _write_new(path: Path, data: bytes, mode: int) -> None:
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | O_BINARY, mode)
    try:
        write_all(descriptor, data)
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
