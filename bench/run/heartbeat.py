"""Signs of life of the process that works on a run, for whoever watches it from outside.

One small file in ``control/`` of the run folder: which process works there, and when its work was last seen to go on.
A thread writes it; but where the work itself stands still (a driver that never returns), the sign stands still with
it, so that a live thread does not hide dead work. Knows no devices and no commands.
"""

from __future__ import annotations

import os
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from bench.base.clock import BenchClock
from bench.base.linux_process import start_ticks, thread_waits_for_disk
from bench.records.storage import storage_errors

CONTROL = "control"
HEARTBEAT = ".heartbeat"
SUPERVISOR = "STARBENCH_SUPERVISOR"
"""Variable of the environment: the number of the process that watches this one."""
STALL_LIMIT_S = 0.5
"""No sign is given for work that has neither waited nor checked for so long; drivers do that 20 times a second."""
SLOW_STALL_LIMIT_S = 600.0
"""As long in a state in which nothing moves, or while the disk takes its time."""
SLOW_STATES = frozenset(
    {"idle", "preflight", "holding", "checking", "solving", "reporting", "recovering", "finished"}
)
"""States in which nothing moves: what computes does not pass the clock, and devices take their time to start up."""


@dataclass(frozen=True)
class Heartbeat:
    """The last sign of life.

    Attributes
    ----------
    pid, started
        The process, and when it started, in the kernel's ticks: numbers of processes are used again.
    moment_ns
        When its work was last seen to go on; comparable within one process only.
    """

    pid: int
    started: int
    moment_ns: int


class HeartbeatWriter:
    """Gives signs of life of this process's work on a run.

    Parameters
    ----------
    folder
        The run folder.
    clock
        The work's clock: as long as it is asked, the work goes on.
    """

    def __init__(self, folder: Path, clock: BenchClock) -> None:
        self._path = folder / CONTROL / HEARTBEAT
        self._clock = clock
        self._state = "idle"
        self._since_s = time.monotonic()
        self._own = os.getpid(), start_ticks(os.getpid())
        self._watched_by = _supervisor()

    def entering(self, state: str) -> None:
        """Note that the work enters a state."""
        self._state, self._since_s = state, time.monotonic()

    def beat(self) -> None:
        """Give a sign, unless the work stands still. Raises StorageError."""
        if self.stalled_s() > (SLOW_STALL_LIMIT_S if self._may_take_long() else STALL_LIMIT_S):
            return
        sign = f"{self._own[0]} {self._own[1]} {time.monotonic_ns()}"
        with storage_errors(self._path), suppress(FileNotFoundError):
            self._path.write_bytes(sign.encode())

    def stalled_s(self) -> float:
        """How long the work has not been seen to go on, s."""
        return min(self._clock.inactive_s(), time.monotonic() - self._since_s)

    def supervisor_is_gone(self) -> bool:
        """Whether the process that watched this one is gone; told once."""
        gone = self._watched_by is not None and os.getppid() != self._watched_by
        if gone:
            self._watched_by = None
        return gone

    def _may_take_long(self) -> bool:
        """Whether nothing moves, or the kernel has it wait for the disk (state D), which no driver's wait does."""
        pid = self._own[0]
        return self._state in SLOW_STATES or thread_waits_for_disk(pid, pid)


def read_heartbeat(folder: Path) -> Heartbeat | None:
    """Give the last sign of life of the process that works on a run; None while it takes no commands."""
    try:
        pid, started, moment_ns = map(int, (folder / CONTROL / HEARTBEAT).read_bytes().split())
    except (OSError, ValueError):
        return None
    return Heartbeat(pid, started, moment_ns)


def open_process(sign: Heartbeat) -> int | None:
    """Open the very process that gave a sign, as a descriptor to wait for and to signal; None when it is gone."""
    try:
        process = os.pidfd_open(sign.pid)
    except OSError:
        return None
    if start_ticks(sign.pid) == sign.started:
        return process
    os.close(process)
    return None


def _supervisor() -> int | None:
    """The process that watches this one: as told by it, where it is indeed our parent."""
    told = os.environ.get(SUPERVISOR, "")
    return int(told) if told.isdecimal() and int(told) == os.getppid() else None
