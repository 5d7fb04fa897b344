"""Heartbeat of the process that works on a run, for a supervisor that watches it from outside.

A thread writes one small file in ``control/``, but not while the work stalls: a live thread cannot hide stalled work.
`BusyWatch` notes in the journal when the computer is too busy.
"""

from __future__ import annotations

import faulthandler
import json
import os
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from bench.base.bounded_json import parse_json
from bench.base.clock import BenchClock
from bench.base.errors import StorageError
from bench.record import events
from bench.record.history import RunLog
from bench.record.run_folder import RunFolder
from bench.record.storage import TEMPORARY, read_bounded, storage_errors, write_atomic

if TYPE_CHECKING:
    from bench.measure.measure import Measurement
    from calib.target import StarTarget

# Processes as the Linux kernel reports them below ``/proc``: start time, waits for the disk, lack of
# memory.
#
# Source: the manual pages proc(5), proc_pid_stat(5) and proc_vmstat(5). On a system without ``/proc`` every
# function returns its neutral value. `docs/decisions/0002-dependencies.md` says why psutil does not do
# this.

PROC = Path("/proc")
_STATE, _START_TIME = 0, 19
"""Positions in ``/proc/PID/stat`` after the name of the program: fields 3 and 22 of proc_pid_stat(5)."""
_WAITS_FOR_DISK = "D"


def start_ticks(pid: int, proc: Path = PROC) -> int:
    """Return when a process started, in kernel clock ticks since boot, as its number is used again; 0 if it is gone."""
    try:
        return int(_stat(proc / str(pid) / "stat")[_START_TIME])
    except (OSError, IndexError, ValueError):
        return 0


def thread_waits_for_disk(pid: int, thread: int, proc: Path = PROC) -> bool:
    """Return whether a thread is in state D, an uninterruptible wait, which is usually a wait for the disk."""
    return _is_waiting(proc / str(pid) / "task" / str(thread) / "stat")


def waits_for_disk(pid: int, proc: Path = PROC) -> bool:
    """Return whether any thread of a process is in state D, an uninterruptible wait."""
    return any(_is_waiting(path) for path in proc.glob(f"{pid}/task/*/stat"))


def out_of_memory_kills(path: Path = PROC / "vmstat") -> int:
    """Return how many processes the kernel has killed for lack of memory since it booted; 0 if it does not tell."""
    with suppress(OSError):
        for line in path.read_text(encoding="ascii").splitlines():
            name, _, value = line.partition(" ")
            if name == "oom_kill":
                return int(value)
    return 0


def _is_waiting(stat: Path) -> bool:
    with suppress(OSError, IndexError):
        return _stat(stat)[_STATE] == _WAITS_FOR_DISK
    return False


def _stat(path: Path) -> list[str]:
    """Return the fields after the program's name, which stands in brackets and may contain anything."""
    return path.read_text().rpartition(")")[2].split()


CONTROL = "control"
HEARTBEAT = ".heartbeat"
SUPERVISOR = "STARBENCH_SUPERVISOR"
"""Environment variable: process id of the supervisor of this process."""
STALL_LIMIT_S = 0.5
"""Work that used its clock longer ago than this has stalled, s. Drivers use the clock 20 times a second."""
SLOW_STALL_LIMIT_S = 600.0
"""The same limit in states in which nothing moves, and while the process waits for the disk, s."""
SLOW_STATES = frozenset(
    {"idle", "preflight", "holding", "checking", "choosing", "solving", "reporting", "recovering", "finished"}
)
"""States in which nothing moves: calculations do not use the clock, and devices may take long to start."""

WINDOW_S = 10.0
"""The lateness of this time is looked at, s."""
BUSY_S = 3.0
"""A computer is too busy if it was late by this time in a window, s."""
REPEAT_S = 60.0
"""The journal says so at most once in this time, s."""


@dataclass(frozen=True)
class Heartbeat:
    """Last heartbeat of a process."""

    pid: int
    started: int
    moment_ns: int  # Time at which its work last made progress, ns; comparable within one process only


class HeartbeatWriter:
    """Writes heartbeats for this process's work on a run."""

    def __init__(self, folder: Path, clock: BenchClock) -> None:
        self._path = folder / CONTROL / HEARTBEAT
        self._clock = clock
        self._state = "idle"
        self._since_s = time.monotonic()
        self._own = os.getpid(), start_ticks(os.getpid())
        self._supervisor = _supervisor()

    def entering(self, state: str) -> None:
        """Take note of the state that the work enters."""
        self._state, self._since_s = state, time.monotonic()

    def beat(self) -> None:
        """Write a heartbeat, unless the work has stalled.

        It replaces the last one as a whole: a process that is stopped here leaves one that says when it was alive.
        """
        if self.stalled_s() > (SLOW_STALL_LIMIT_S if self._may_take_long() else STALL_LIMIT_S):
            return
        text = f"{self._own[0]} {self._own[1]} {time.monotonic_ns()}"
        with storage_errors(self._path), suppress(FileNotFoundError):
            part = self._path.with_name(f"{HEARTBEAT}{TEMPORARY}")
            part.write_bytes(text.encode())
            part.replace(self._path)

    def stalled_s(self) -> float:
        """Return how long ago the work last made progress."""
        return min(self._clock.inactive_s(), time.monotonic() - self._since_s)

    def supervisor_is_gone(self) -> bool:
        """Return whether the supervisor of this process has ended; True only at the first call after that."""
        gone = self._supervisor is not None and os.getppid() != self._supervisor
        if gone:
            self._supervisor = None
        return gone

    def _may_take_long(self) -> bool:
        """Return whether nothing moves, or the process waits for the disk (kernel state D)."""
        pid = self._own[0]
        return self._state in SLOW_STATES or thread_waits_for_disk(pid, pid)


def read_heartbeat(folder: Path) -> Heartbeat | None:
    """Read the last heartbeat of a run's process; None while none accepts commands."""
    try:
        numbers = [int(number) for number in (folder / CONTROL / HEARTBEAT).read_bytes().split()]
    except (OSError, ValueError):
        return None
    return Heartbeat(*numbers) if len(numbers) == 3 else None


def open_process(heartbeat: Heartbeat) -> int | None:
    """Return a pidfd of the process that wrote a heartbeat, to wait for and signal; None if it has ended."""
    try:
        process = os.pidfd_open(heartbeat.pid)
    except OSError:
        return None
    if start_ticks(heartbeat.pid) == heartbeat.started:
        return process
    os.close(process)
    return None


def _supervisor() -> int | None:
    """Return the process id of the supervisor, if the environment names it and it is the parent process."""
    text = os.environ.get(SUPERVISOR, "")
    return int(text) if text.isdecimal() and int(text) == os.getppid() else None


class BusyWatch:
    """Writes ``computer_busy`` to a log when the computer is too busy."""

    def __init__(self, log: RunLog, clock: BenchClock) -> None:
        self._log = log
        self._clock = clock
        self._began_s = clock.monotonic()
        self._lost_s = float(clock.lateness().get("lost_s", 0.0))
        self._noted_s = -REPEAT_S

    def look(self) -> None:
        """Look whether a window is over, and whether the computer was too busy in it."""
        now_s = self._clock.monotonic()
        window_s = now_s - self._began_s
        if window_s < WINDOW_S:
            return
        lateness = self._clock.lateness()
        lost_s = float(lateness.get("lost_s", 0.0))
        late_s, self._lost_s, self._began_s = lost_s - self._lost_s, lost_s, now_s
        if late_s >= BUSY_S * window_s / WINDOW_S and now_s - self._noted_s >= REPEAT_S:
            self._noted_s = now_s
            self._log.write(
                events.ComputerBusy, late_s=round(late_s, 3), window_s=round(window_s, 3), lateness=lateness
            )


# The picture of the last recording, for people who watch a run from another process.
#
# It is one file in ``control/`` of the run folder, no evidence: it is not synced, it is replaced with each
# recording, and it goes with ``control/`` when the run ends. If it cannot be written, the run goes on
# without it.

LAST_VIEW = ".last-view"
_DIGITS = 3
_MOST_BYTES = 64 << 20


@dataclass(frozen=True)
class LastView:
    """The picture of a recording."""

    # pose, attempt: Number of the pose and of the attempt, from 1.
    pose: int
    attempt: int
    nodes: Sequence[Sequence[float]]
    points_px: Sequence[Sequence[float]]  # Place of each star, [x, y], px, to a thousandth
    fault: str  # Why no stars were found; empty if there are some
    png: bytes


def leave_view(folder: Path, pose: int, attempt: int, found: Measurement, target: StarTarget) -> None:
    """Leave the picture of a recording for others; nothing happens if there is no image or nobody can be told."""
    if found.image is None or not (folder / CONTROL).is_dir():
        return
    stars = (
        {"nodes": [], "points_px": []}
        if found.view is None
        else {
            "nodes": target.node_of(found.view.ids).tolist(),
            "points_px": found.view.points_px.round(_DIGITS).tolist(),
        }
    )
    head = json.dumps({"pose": pose, "attempt": attempt, "fault": found.fault, **stars})
    path = folder / CONTROL / LAST_VIEW
    part = path.with_name(f"{LAST_VIEW}{TEMPORARY}")
    with suppress(OSError):
        part.write_bytes(head.encode() + b"\n" + found.image.png)
        part.replace(path)


def read_last_view(folder: Path) -> LastView | None:
    """Read the picture of the last recording of a run in progress; None if there is none."""
    try:
        head, _, png = read_bounded(folder / CONTROL / LAST_VIEW, _MOST_BYTES).partition(b"\n")
        found = parse_json(head)
        return LastView(
            int(found["pose"]),
            int(found["attempt"]),
            [[float(column), float(row)] for column, row in found["nodes"]],
            [[float(x), float(y)] for x, y in found["points_px"]],
            str(found["fault"]),
            png,
        )
    except (StorageError, ValueError, KeyError, TypeError):
        return None


# How the process of a run crashed, as the interpreter wrote it while it died.
#
# A process that is killed from outside, or loses power, writes nothing, and the step at work did not cause
# it. A process that dies by a memory fault, an abort or an arithmetic fault writes where it was into
# ``crash.txt`` of the run folder (`faulthandler`). Resuming reads this file and counts the crash against
# the pose at work. If the system ends a process because memory is short, the process cannot write; its
# supervisor notices this and writes the file.

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
