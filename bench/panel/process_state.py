"""Whether a process works on a run, when it last gave a sign of life, and the free disk space. Writes nothing."""

from __future__ import annotations

import shutil
import time
from dataclasses import dataclass
from pathlib import Path

from bench.base.errors import BenchError
from bench.records.folder_lock import is_locked
from bench.records.run_folder import is_sealed
from bench.run.heartbeat import CONTROL, HEARTBEAT, SLOW_STALL_LIMIT_S, SLOW_STATES

_QUIET_LIMIT_S = 15.0


@dataclass(frozen=True)
class ProcessState:
    """What the file system tells of a run's process."""

    running: bool = False  # Whether a process works on the run
    sealed: bool = False  # Whether the run is sealed
    takes_commands: bool = False  # Whether the process accepts commands
    # Time since the last sign of life of its work, s, if it is longer than it should be; None otherwise.
    quiet_s: float | None = None
    free_bytes: int | None = None  # Free space of the disk; None if it is not known
    fault: str = ""  # Why the folder cannot be looked at; empty if it can


def look_at_process(folder: Path, state: str) -> ProcessState:
    """Look at the process of a run.

    Returns: Also if the folder is missing or cannot be read: then with ``fault``.
    """
    try:
        running = is_locked(folder)
    except BenchError as error:
        return ProcessState(fault=str(error))
    sealed = is_sealed(folder)
    if not running:
        return ProcessState(sealed=sealed)
    return ProcessState(
        running,
        sealed,
        (folder / CONTROL).is_dir(),
        _quiet_s(folder, state),
        _free_bytes(folder),
    )


def _quiet_s(folder: Path, state: str) -> float | None:
    """Return for how long the heartbeat is late; the states in which nothing moves may take long."""
    try:
        age_s = time.time() - (folder / CONTROL / HEARTBEAT).stat().st_mtime
    except OSError:
        return None
    limit_s = SLOW_STALL_LIMIT_S if state in SLOW_STATES else _QUIET_LIMIT_S
    return age_s if age_s > limit_s else None


def _free_bytes(folder: Path) -> int | None:
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return None
