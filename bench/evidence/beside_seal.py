"""Read and add the reserved files beside a seal. The sealed folder stays read-only.

A file appears whole or not at all: it is written without a name and synced, then linked under its name.
Linking never replaces a file. Where the file system has no files without a name, it is written as every new output.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bench.base.errors import EvidenceError
from bench.base.pasteable import pasteable
from bench.evidence.seal import RESERVED
from bench.record.storage import storage_errors
from drivers.durable import sync_folder, write_all
from drivers.new_output import new_output

MOST_BYTES = 1 << 20
"""Signatures and time stamps have some kilobytes; a larger file is not read."""
_NO_TMPFILE = {errno.EOPNOTSUPP, errno.EISDIR, errno.EINVAL, errno.ENOENT}
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
        write_named(path, data)
        return
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        _fill(descriptor, data)
        # Its name in /proc is linked (open(2), O_TMPFILE). Python follows that link only if a folder's descriptor
        # is given.
        os.link(f"/proc/self/fd/{descriptor}", path.name, dst_dir_fd=folder, follow_symlinks=True)
    except OSError as error:
        error.filename = str(path)  # not its name in /proc, which tells an operator nothing
        raise
    finally:
        os.close(descriptor)
        os.close(folder)


def write_named(path: Path, data: bytes) -> None:
    """Write a file as every new output is written."""
    with new_output(path) as part:
        part.write_bytes(data)
        part.chmod(_MODE)


def _fill(descriptor: int, data: bytes) -> None:
    write_all(descriptor, data)
    if hasattr(os, "fchmod"):
        os.fchmod(descriptor, _MODE)  # whatever the umask
    os.fsync(descriptor)
