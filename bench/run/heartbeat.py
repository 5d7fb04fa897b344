"""Heartbeat of the process that works on a run, for a supervisor that watches it from outside.

A thread writes one small file in ``control/``, but not while the work stalls: a live thread cannot hide stalled work.
`BusyWatch` notes in the journal when the computer is too busy.
"""

from __future__ import annotations

import os
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from bench.base.clock import BenchClock
from bench.base.supervised import outlive_supervisor, supervisor
from bench.record import events
from bench.record.run_log import RunLog
from bench.record.storage import storage_errors
from bench.run.processes import start_ticks, thread_waits_for_disk
from drivers.new_output import TEMPORARY

CONTROL = "control"
HEARTBEAT = ".heartbeat"
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
"""A computer is too busy if it was late by this time in a window, s: the share of `drivers.lateness.BUSY_SHARE`."""
REPEAT_S = 60.0
"""The journal says so at most once in this time, s, so that it stays short through a busy night."""


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
        self._supervisor = supervisor()
        outlive_supervisor()

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


class BusyWatch:
    """Writes ``computer_busy`` to a log when the computer is too busy."""

    def __init__(self, log: RunLog, clock: BenchClock) -> None:
        self._log = log
        self._clock = clock
        self._began_s = clock.monotonic()
        self._lost_s = float(clock.lateness().get("lost_s", 0.0))
        self._noted_s = -REPEAT_S
        self._longest_s = WINDOW_S

    def look(self) -> None:
        """Look whether a window is over, and whether the computer was too busy in it."""
        now_s = self._clock.monotonic()
        window_s = now_s - self._began_s
        if window_s < WINDOW_S:
            return
        lateness = self._clock.lateness()
        lost_s = float(lateness.get("lost_s", 0.0))
        late_s, self._lost_s, self._began_s = lost_s - self._lost_s, lost_s, now_s
        longest_s = float(lateness.get("longest_s", 0.0))
        slept = longest_s > self._longest_s  # is told at once: a result must know it
        busy = late_s >= BUSY_S * window_s / WINDOW_S
        if busy and (slept or now_s - self._noted_s >= REPEAT_S):
            self._noted_s, self._longest_s = now_s, max(longest_s, WINDOW_S)
            self._log.write(
                events.ComputerBusy, late_s=round(late_s, 3), window_s=round(window_s, 3), lateness=lateness
            )
