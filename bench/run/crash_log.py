"""How the process of a run crashed, as the interpreter wrote it while it died.

A process that is killed from outside, or loses power, writes nothing, and the step at work did not cause
it. A process that dies by a memory fault, an abort or an arithmetic fault writes where it was into
``crash.txt`` of the run folder (`faulthandler`). Resuming reads this file and counts the crash against
the pose at work. If the system ends a process because memory is short, the process cannot write; its
supervisor notices this and writes the file.
"""

from __future__ import annotations

import faulthandler
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bench.record.run_folder import RunFolder
from bench.record.storage import storage_errors, write_atomic

CRASH_LOG = "crash.txt"


@contextmanager
def crash_log(folder: Path) -> Iterator[None]:
    """Write a crash of this process inside the block to ``crash.txt``; remove the empty file at the end."""
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
    """Write why a process died, for one that could not write it itself, unless the folder is gone."""
    if folder.is_dir():
        write_atomic(folder / CRASH_LOG, f"{what}\n".encode())


def read_crash(folder: Path) -> str | None:
    """Return the first line of the crash log; None if the last process did not crash, or was killed from outside."""
    path = folder / CRASH_LOG
    with storage_errors(path):
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines() if path.is_file() else []
    return lines[0] if lines else None


def archive_crash(folder: RunFolder) -> None:
    """Move the crash log to ``quarantine/`` for later inspection, or remove it if it is empty."""
    path = folder.path / CRASH_LOG
    with storage_errors(path):
        if read_crash(folder.path):
            folder.quarantine(path)
        path.unlink(missing_ok=True)
