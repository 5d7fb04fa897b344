"""How a process of a run crashed: what the interpreter wrote when it died of itself.

A process that is killed from outside, or whose power goes, leaves nothing behind, and the step at work is not to blame.
One that dies of its own memory fault, abort or arithmetic writes where it was into ``crash.txt`` of the run folder with
its last breath (`faulthandler`); resuming reads that, and counts it against the pose that was at work. Where the system
ends a process for want of memory it cannot write; its supervisor, which sees that, writes for it.
"""

from __future__ import annotations

import faulthandler
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bench.records.run_folder import RunFolder
from bench.records.storage import storage_errors, write_atomic

CRASH_LOG = "crash.txt"


@contextmanager
def crash_log(folder: Path) -> Iterator[None]:
    """Let a crash of this process inside the block be written to ``crash.txt``; an empty one is removed at the end."""
    path = folder / CRASH_LOG
    outer = faulthandler.is_enabled()
    with storage_errors(path):
        file = path.open("wb")
    try:
        faulthandler.enable(file)
        yield
    finally:
        faulthandler.disable()
        if outer:
            faulthandler.enable(sys.__stderr__ or 2)
        file.close()
        with storage_errors(path):
            path.unlink(missing_ok=True)


def write_crash_log(folder: Path, what: str) -> None:
    """Write down for a process why it died, where it could not itself but whoever watched it knows.

    Raises
    ------
    StorageError
        When it cannot be written.
    """
    if folder.is_dir():
        write_atomic(folder / CRASH_LOG, f"{what}\n".encode())


def read_crash(folder: Path) -> str | None:
    """Say how the last process crashed, in its own words; None when it did not, or was killed from outside.

    Raises
    ------
    StorageError
        When the file cannot be read.
    """
    path = folder / CRASH_LOG
    with storage_errors(path):
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines() if path.is_file() else []
    return lines[0] if lines else None


def archive_crash(folder: RunFolder) -> None:
    """Move what a crash wrote to ``quarantine/``, for those who look into it; remove what is empty.

    Raises
    ------
    StorageError
        When it cannot be moved.
    """
    path = folder.path / CRASH_LOG
    with storage_errors(path):
        if read_crash(folder.path):
            folder.quarantine(path)
        path.unlink(missing_ok=True)
