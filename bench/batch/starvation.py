"""How long another process waited for nothing but a processor. Reads ``/proc`` only; touches no process.

A process that hangs sleeps or computes. A process on a computer that is too busy is ready to compute, and does not get
a processor. Only the kernel can tell the two apart.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from bench.base.linux_process import processor_times_s, thread_is_ready


@dataclass
class _Thread:
    """Times of one thread when it was last looked at, and its present wait for a processor."""

    # computed_s, waited_s: By the kernel, s.
    computed_s: float
    waited_s: float
    open_s: float = 0.0  # Wait that was counted before the kernel counted it, s


@dataclass
class Starvation:
    """Adds up how long threads of a process waited for a processor, from the first look.

    times_s: Returns the times computed and waited of a thread, s (`processor_times_s`).
    is_ready: Returns whether a thread computes or waits for a processor (`thread_is_ready`).
    """

    times_s: Callable[[int, int], tuple[float, float] | None] = processor_times_s
    is_ready: Callable[[int, int], bool] = thread_is_ready
    starved_s: float = field(default=0.0, init=False)  # The sum, s
    is_counted: bool = field(default=False, init=False)  # Whether the kernel counts these waits
    _threads: dict[int, _Thread] = field(default_factory=dict, init=False)
    _looked_s: float | None = field(default=None, init=False)

    def look(self, pid: int, threads: Sequence[int], now_s: float) -> float:
        """Look at a process, and add what its threads waited since the last look.

        threads: Numbers of the threads. The one that waited longest since the last look counts.
        now_s: Time of this look, s.
        Returns: Time waited since the first look, s; 0 where the kernel does not count it.
        """
        passed_s = now_s - self._looked_s if self._looked_s is not None else 0.0
        self._looked_s = now_s
        waits_s = [self._waited_s(pid, thread, passed_s) for thread in dict.fromkeys(threads)]
        self.starved_s += min(passed_s, max(waits_s, default=0.0))
        return self.starved_s

    def _waited_s(self, pid: int, thread: int, passed_s: float) -> float:
        times = self.times_s(pid, thread)
        if times is None:
            return 0.0
        self.is_counted = True
        computed_s, waited_s = times
        seen = self._threads.setdefault(thread, _Thread(computed_s, waited_s))
        grown_s = waited_s - seen.waited_s
        stands = grown_s == 0.0 and computed_s == seen.computed_s
        seen.computed_s, seen.waited_s = computed_s, waited_s
        if stands and self.is_ready(pid, thread):  # a wait that has not ended
            seen.open_s += passed_s
            return passed_s
        counted_s, seen.open_s = max(0.0, grown_s - seen.open_s), 0.0
        return counted_s
