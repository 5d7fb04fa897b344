"""Processes as the Linux kernel reports them below ``/proc``: start, waits for the disk, lack of memory.

Source: the manual pages proc(5), proc_pid_stat(5) and proc_vmstat(5). On a system without ``/proc`` every function
returns its neutral value. `docs/decisions/0002-dependencies.md` says why psutil does not do this.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

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
