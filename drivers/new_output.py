"""A new file or folder that appears under its name as a whole or not at all, and is one writer's.

It is written under a hidden name beside its place. A hidden file beside that is the claim: the kernel's lock on it ends
with its process, so what a killed process left is told from what is being written, and the next one of the same name
removes it. The claim also states what was given the name: a process that is killed right after that left a whole
output, whose command can be repeated all the same.
"""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from drivers.durable import O_BINARY, sync_file, sync_folder, write_all
from drivers.file_lock import lock

TEMPORARY: Final = ".tmp"
"""Ending of a hidden name that a file or folder has while it is written."""
_MOST_CLAIM_BYTES: Final = 64  # Longer than any claim, so that a longer file is none
_TAKEN: Final = frozenset({errno.EEXIST, errno.ENOTEMPTY})


@contextmanager
def new_output(path: Path) -> Iterator[Path]:
    """Provide a path for a new file or folder; at the end of the block it is synced and gets its name.

    Raises OSError: FileExistsError if the name is not free (`is_free`), BlockingIOError while another process writes
    it, with that process as its ``strerror``. An error or Ctrl-C within the block leaves nothing.
    """
    path = path.resolve() if path.is_dir() else path.absolute()
    part, claim = unfinished(path), _claim_of(path)
    descriptor = _claimed(claim)
    try:
        remove_unfinished(part)
        if _was_named_by(claim, path):
            path.rename(part)
            remove_unfinished(part)
        if not is_free(path):
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path))
        yield part
        if part.is_dir():
            sync_folder(part)
        else:
            sync_file(part)
        os.ftruncate(descriptor, 0)
        write_all(descriptor, _identity(part))
        _give_name(part, path)
    finally:
        with suppress(OSError):  # the next one of this name removes it
            remove_unfinished(part)
        _give_up(claim, descriptor)


def discard_unfinished(path: Path) -> None:
    """Remove what a killed process left of a new output. Raises BlockingIOError if a living one writes it."""
    claim = _claim_of(path)
    if os.path.lexists(claim):
        descriptor = _claimed(claim)
        try:
            remove_unfinished(unfinished(path))
        finally:
            _give_up(claim, descriptor)


def is_free(path: Path) -> bool:
    """Return whether a new output may get this name: nothing has it, or an empty folder, or what a killed one left."""
    if not os.path.lexists(path) or _was_named_by(_claim_of(path), path):
        return True
    return path.is_dir() and next(path.iterdir(), None) is None and not path.samefile(Path.cwd())


def unfinished(path: Path) -> Path:
    """Return the hidden name of an output while it is written."""
    return path.with_name(f".{path.name}{TEMPORARY}")


def remove_unfinished(part: Path) -> None:
    """Remove a file or folder that never got its name, if it is there; a seal may have made the folder read-only."""
    if part.is_dir() and not part.is_symlink():
        for folder, _, _ in os.walk(part):
            Path(folder).chmod(0o755)
        shutil.rmtree(part)
    else:
        part.unlink(missing_ok=True)


def _claim_of(path: Path) -> Path:
    return path.with_name(f".{path.name}.claim{TEMPORARY}")


def _claimed(claim: Path) -> int:
    """Return the locked file; another process may have removed it between its opening and its lock."""
    while True:
        descriptor = os.open(claim, os.O_RDWR | os.O_CREAT | O_BINARY, 0o644)
        try:
            lock(descriptor)
            with suppress(FileNotFoundError):
                if claim.stat().st_ino == os.fstat(descriptor).st_ino:
                    return descriptor
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)


def _give_up(claim: Path, descriptor: int) -> None:
    try:
        claim.unlink()
    except OSError:  # Windows removes no open file
        with suppress(OSError):
            os.ftruncate(descriptor, 0)
    os.close(descriptor)


def _identity(path: Path) -> bytes:
    """Return what a file or folder keeps when it is renamed, and another one of its name does not have."""
    status = path.lstat()
    return f"{status.st_ino} {status.st_mtime_ns}".encode()


def _was_named_by(claim: Path, path: Path) -> bool:
    try:
        return claim.read_bytes()[:_MOST_CLAIM_BYTES] == _identity(path)
    except OSError:
        return False


def _give_name(part: Path, path: Path) -> None:
    """Give the output its name, and make the name durable, else take it back."""
    try:
        if part.is_dir():
            with suppress(FileNotFoundError):
                path.rmdir()
            part.rename(path)
        else:
            _link(part, path)
    except OSError as error:
        if error.errno in _TAKEN:
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path)) from error
        raise
    try:
        sync_folder(path.parent)
    except OSError:
        with suppress(OSError):  # the first error is the one to report
            path.rename(part)
        raise


def _link(part: Path, path: Path) -> None:
    """Give a file its name, unless another program has taken it meanwhile."""
    try:
        os.link(part, path)
    except FileExistsError:
        raise
    except OSError:  # a file system without hard links
        if path.exists():
            raise
        part.rename(path)
    else:
        with suppress(OSError):
            part.unlink()
