"""Durable writing: files are written as a whole or not at all, and synced together with their folder.

The steps are a temporary file, fsync(2), rename(2), and fsync of the folder, which makes the new name durable.
"""

from __future__ import annotations

import errno
import hashlib
import os
import shutil
import stat
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO, Final

from bench.base.bounded_json import parse_json
from bench.base.errors import StorageError, UsageError
from drivers import new_output as outputs
from drivers.durable import FOLDERS_OPEN, O_BINARY, sync_file, sync_folder, write_all
from drivers.new_output import TEMPORARY, unfinished

SEAL: Final = "SHA256SUMS.sig"
"""The signature of a sealed folder: with it, the folder gets no new file."""
HASH_CHUNK_BYTES = 1 << 20  # Memory that a hash takes

_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_DENIED = {errno.EACCES, errno.EPERM, errno.EROFS}
_NOWHERE = {errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.ENAMETOOLONG, errno.ELOOP}
MOST_BYTES = 100_000_000
"""Largest JSON file that is read: the results of ten thousand poses have 70 MB."""
MOST_TABLE_BYTES = 1 << 30
"""Largest table of rows, a line of JSON each, that is read."""
_RESTORE = "Restore the file from a copy."


@contextmanager
def storage_errors(where: Path) -> Iterator[None]:
    """Turn an OSError of the block into a StorageError with a remedy; it names ``where`` if the error names no file."""
    try:
        yield
    except OSError as error:
        place = Path(error.filename or where)
        if is_temporary(place):  # nobody knows the name that a file has while it is written
            place = where
        place = Path(
            *(part[1 : -len(TEMPORARY)] if is_temporary(Path(part)) else part for part in place.parts)
        )
        if error.errno in _FULL:
            real = Path(os.path.realpath(place))
            disk = next(above for above in (real, *real.parents) if os.path.ismount(above))
            what, remedy = "The disk is full.", f"Make room on the disk at {disk}, or use another one."
        elif error.errno in _DENIED:
            what, remedy = "No permission.", "Change its mode or owner, or use another folder."
        elif error.errno in _NOWHERE:
            what, remedy = f"This path cannot be used: {error.strerror or error}.", "Check the path."
        else:
            what = f"The file system reports an error: {error.strerror or error}."
            remedy = "Check the disk (dmesg, SMART) before you continue."
        raise StorageError(what, where=str(place), remedy=remedy) from error


def open_to_lock(folder: Path) -> int:
    """Open a folder in order to lock it (see `drivers.file_lock`). On Windows, open a hidden file beside it instead."""
    if FOLDERS_OPEN:
        return os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    return os.open(folder.with_name(f".{folder.name}.lock"), os.O_RDWR | os.O_CREAT)


def make_folder(folder: Path) -> None:
    """Make a folder and its parents, unless they exist, and sync the name of each."""
    with storage_errors(folder):
        missing = [p for p in (folder, *folder.parents) if not p.exists()]
        for path in reversed(missing):
            path.mkdir(exist_ok=True)
            sync_folder(path.parent)
        if not folder.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(folder))


def write_atomic(path: Path, data: bytes, *, mode: int = 0o644) -> None:
    """Write a file so that at any moment it has either its new contents or its old ones."""
    part = unfinished(path)
    with storage_errors(path):
        part.unlink(missing_ok=True)
        try:
            _write_new(part, data, mode)
            part.replace(path)
        except BaseException:  # Ctrl-C too
            with suppress(OSError):  # the first error is the one to report
                part.unlink()
            raise
        sync_folder(path.parent)


@contextmanager
def new_output(path: Path) -> Iterator[Path]:
    """Provide a path for a new file or folder, which gets its name at the end of the block (`drivers.new_output`).

    Parents are made. Raises UsageError if the name is taken or in a sealed folder, or another process is writing it.
    """
    require_unsealed(path)
    make_folder(path.absolute().parent)
    with storage_errors(path):
        try:
            with outputs.new_output(path) as part:
                yield part
        except FileExistsError as error:
            raise _taken(path) from error
        except BlockingIOError as error:
            raise UsageError(
                f"Another process is writing it now: {error.strerror}.",
                where=str(path),
                remedy="Wait until that process ends, or choose another name.",
            ) from error


def discard_unfinished(path: Path) -> None:
    """Remove what a killed process left of a new output."""
    with storage_errors(path), suppress(BlockingIOError):
        outputs.discard_unfinished(path)


def require_unsealed(path: Path) -> None:
    """Refuse a new output in a sealed folder."""
    above = Path(os.path.realpath(path)).parents  # a link may lead into the folder
    with storage_errors(path):
        sealed = next((folder for folder in above if (folder / SEAL).exists()), None)
    if sealed is not None:
        raise UsageError(
            f"{sealed} is sealed; a file in it would break its seal.",
            where=str(path),
            remedy="Choose an output outside of it.",
        )


def require_free(path: Path) -> None:
    """Refuse a name that no new output may get: nothing is ever overwritten, and no seal broken."""
    require_unsealed(path)
    with storage_errors(path):
        if not outputs.is_free(path):
            raise _taken(path)


def _taken(path: Path) -> UsageError:
    if path.is_dir() and (occupant := next(path.iterdir(), None)) is not None:
        what = f"The folder is not empty: it contains {occupant.name}."
    else:
        what = "A file or folder with this name already exists."
    return UsageError(what, where=str(path), remedy="Choose another name; nothing is ever overwritten.")


def write_new(path: Path, data: bytes) -> None:
    """Write a new file, refused if the name is taken."""
    with new_output(path) as part:
        _write_new(part, data, 0o644)


def write_files(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files into a folder in their order, by their paths within it; folders are made."""
    make_folder(folder)
    for name, data in files.items():
        make_folder((folder / name).parent)
        write_atomic(folder / name, data)


def remove(path: Path) -> None:
    """Remove a file, a folder with its contents, or a link but not its target."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink()


def is_temporary(path: Path) -> bool:
    """Return whether `write_atomic` left a file of this name behind, or is writing it now."""
    return path.name.startswith(".") and path.name.endswith(TEMPORARY)


def move_into_place(part: Path, path: Path) -> None:
    """Give a file that other code has written its final name: fsync, rename, fsync of the folder."""
    with storage_errors(part):
        sync_file(part)
        part.rename(path)
        sync_folder(path.parent)


def sha256_of(path: Path, goes_on: Callable[[], object] = lambda: None) -> str:
    """Return a file's SHA-256 (FIPS 180-4) by pieces; ``goes_on`` is called after each, for a supervisor to see."""
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        while chunk := stream.read(HASH_CHUNK_BYTES):
            digest.update(chunk)
            goes_on()
    return digest.hexdigest()


def _write_new(path: Path, data: bytes, mode: int) -> None:
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | O_BINARY, mode)
    try:
        write_all(descriptor, data)
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def is_plain_file(path: Path) -> bool:
    """Return whether a path is an ordinary file itself: no link to one, no folder, no pipe, no device."""
    return path.is_file() and not path.is_symlink()


@contextmanager
def open_to_read(path: Path) -> Iterator[BinaryIO]:
    """Open an ordinary file for reading. A pipe or a device, which might never answer, is refused."""
    with storage_errors(path):
        descriptor = os.open(path, os.O_RDONLY | O_BINARY | getattr(os, "O_NONBLOCK", 0))
        mode = os.fstat(descriptor).st_mode
        if not stat.S_ISREG(mode):
            os.close(descriptor)
            what = "a folder" if stat.S_ISDIR(mode) else "a pipe, a socket or a device"
            raise StorageError(f"This is {what}, not a file.", where=str(path), remedy=_RESTORE)
        with os.fdopen(descriptor, "rb") as stream:
            yield stream


def read_bounded(path: Path, most_bytes: int = MOST_BYTES) -> bytes:
    """Read an ordinary file of a bounded size."""
    with open_to_read(path) as stream:
        is_larger = os.fstat(stream.fileno()).st_size > most_bytes
        data = b"" if is_larger else stream.read(most_bytes + 1)  # the file may grow meanwhile
    if is_larger or len(data) > most_bytes:
        raise StorageError(
            f"The file has more than {most_bytes} bytes.",
            where=str(path),
            remedy=_RESTORE,
        )
    return data


def whole_lines(path: Path) -> list[bytes]:
    """Return the lines of a table, none without a file; half a line, which a power cut has left, is taken out of it."""
    if not path.is_file():
        return []
    with storage_errors(path):
        data = read_bounded(path, MOST_TABLE_BYTES)
        whole = data[: data.rfind(b"\n") + 1]
        if len(whole) < len(data):
            os.truncate(path, len(whole))
    return whole.splitlines()


def read_json(path: Path, most_bytes: int = MOST_BYTES) -> Any:
    """Read a JSON file of a bounded size; `ValueError` if it is none, nested too deeply, or has too many values."""
    return parse_json(read_bounded(path, most_bytes))
