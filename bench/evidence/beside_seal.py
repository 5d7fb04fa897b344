"""Read and add the reserved files beside a seal. The sealed folder stays read-only.

A file appears whole or not at all: it is written without a name and synced, then linked under its name.
Linking never replaces a file. Where the file system has no files without a name, a temporary file is
used; the next attempt removes one that a died process left behind.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from bench.base.errors import EvidenceError
from bench.base.pasteable import pasteable
from bench.evidence.seal import RESERVED
from bench.record.storage import storage_errors
from drivers.durable import sync_folder, write_all
from drivers.new_output import TEMPORARY

MOST_BYTES = 1 << 20
"""Signatures and time stamps have some kilobytes; a larger file is not read."""
_NO_TMPFILE = {errno.EOPNOTSUPP, errno.EISDIR, errno.EINVAL, errno.ENOENT}
_NO_LINKS = {errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK}
"""Errors of file systems without hard links, such as FAT."""
_MODE, _FOLDER_MODE = 0o444, 0o555  # Read-only for all, as the sealed files


def read_beside(folder: Path, name: str) -> bytes | None:
    """Read a reserved file, or the signature of the seal: no link, and no larger than 1 MiB."""
    path = f"{folder}/{name}"  # as text: a list asks for files that are not there ten thousand times
    try:
        status = os.lstat(path)
    except FileNotFoundError:
        return None
    if not stat.S_ISREG(status.st_mode):
        raise EvidenceError("this is a link or a folder, not a file", where=name)
    if status.st_size > MOST_BYTES:
        raise EvidenceError(f"the file is too large: more than {MOST_BYTES} bytes", where=name)
    return Path(path).read_bytes()


def add_beside(folder: Path, name: str, data: bytes) -> None:
    """Add a reserved file, which is never replaced, beside the seal. File and folder are read-only afterwards."""
    if name not in RESERVED:
        raise EvidenceError(f"{name!r} cannot be added to a sealed folder.", where=str(folder))
    path = folder / name
    with storage_errors(path):
        with _writable(folder):
            (folder / f".{name}{TEMPORARY}").unlink(missing_ok=True)
            try:
                write_and_link(path, data)
            except FileExistsError as error:
                raise EvidenceError(
                    f"There is a file {name} already; it is never replaced.",
                    where=str(folder),
                    remedy=f"Check it: {pasteable('verify', folder)}",
                ) from error
        sync_folder(folder)


@contextmanager
def _writable(folder: Path) -> Iterator[None]:
    """Make the folder writable for the block."""
    folder.chmod(_FOLDER_MODE | stat.S_IWUSR)
    try:
        yield
    finally:
        folder.chmod(_FOLDER_MODE)


def write_and_link(path: Path, data: bytes) -> None:
    """Write a file without a name, and give it its name. Raises FileExistsError and other OSErrors."""
    try:
        descriptor = os.open(path.parent, os.O_TMPFILE | os.O_WRONLY, _MODE)
    except (AttributeError, OSError) as error:
        if isinstance(error, OSError) and error.errno not in _NO_TMPFILE:
            raise
        write_and_rename(path, data)
        return
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        _fill(descriptor, data)
        # Its name in /proc is linked (open(2), O_TMPFILE). Python follows that link only if a folder's descriptor
        # is given.
        os.link(f"/proc/self/fd/{descriptor}", path.name, dst_dir_fd=folder, follow_symlinks=True)
    finally:
        os.close(descriptor)
        os.close(folder)


def write_and_rename(path: Path, data: bytes) -> None:
    """Write a file under another name, sync it, and give it its name."""
    part = path.with_name(f".{path.name}{TEMPORARY}")
    descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, _MODE)
    try:
        try:
            _fill(descriptor, data)
        finally:
            os.close(descriptor)
        try:
            os.link(part, path)
        except OSError as error:
            if error.errno not in _NO_LINKS or path.exists():
                raise
            part.rename(path)
    finally:
        with suppress(FileNotFoundError):
            part.unlink()


def _fill(descriptor: int, data: bytes) -> None:
    write_all(descriptor, data)
    if hasattr(os, "fchmod"):
        os.fchmod(descriptor, _MODE)  # whatever the umask
    os.fsync(descriptor)
