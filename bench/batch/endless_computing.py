"""How long the work of another process has computed without using its clock. Reads ``/proc`` only; touches no process.

Work with devices uses its clock after some milliseconds of processor time: the longest piece that was measured needs
11 ms. So work that has used ``COMPUTED_S`` of processor time without using its clock does not come back. A process that
gets no processor uses none, so that it is not mistaken for such work. Elapsed time alone cannot tell the two apart.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from bench.base.linux_process import processor_times_s
from bench.base.work_moment import read_work_moment

COMPUTED_S = 0.4
"""Work computes without end if it has used this processor time without using its clock, s."""
_MOST_IN_A_LOOK_S = 0.1
"""So much processor time counts between two looks at most, s. Some virtual machines count time in which they stood
still, and a single pause must not reach ``COMPUTED_S``."""
_MOST_BETWEEN_LOOKS_S = 0.5
"""So much elapsed time counts between two looks at most, s, for the same reason."""


@dataclass
class EndlessComputing:
    """Adds up processor time and elapsed time since the work was last seen to use its clock.

    times_s: Returns the times computed and waited of a thread, s (`processor_times_s`).
    moment_s: Returns when the work of a process last used its clock (`read_work_moment`).
    """

    times_s: Callable[[int, int], tuple[float, float] | None] = processor_times_s
    moment_s: Callable[[int, int], float | None] = read_work_moment
    computed_s: float = field(default=0.0, init=False)  # Processor time of the work's thread, s
    passed_s: float = field(default=0.0, init=False)  # Elapsed time, s
    _seen: tuple[float, float, float] | None = field(default=None, init=False)
    """Moment of the last use, processor time, and time of the last look, s."""

    def look(self, pid: int, number: int, now_s: float) -> None:
        """Look at a process.

        pid: Number of the process; its main thread does the work.
        number: Where it writes the moment (`bench.base.work_moment.WorkMoment.number`).
        now_s: Time of this look, s.
        """
        moment_s, times = self.moment_s(pid, number), self.times_s(pid, pid)
        if moment_s is None or times is None:
            self.forget()
            return
        if self._seen is None or self._seen[0] != moment_s:
            self.forget()
        else:
            self.computed_s += min(_MOST_IN_A_LOOK_S, times[0] - self._seen[1])
            self.passed_s += min(_MOST_BETWEEN_LOOKS_S, now_s - self._seen[2])
        self._seen = moment_s, times[0], now_s

    def forget(self) -> None:
        """Begin anew: the work was seen to go on, or it cannot be judged now."""
        self.computed_s = self.passed_s = 0.0
        self._seen = None

    def is_endless(self, limit_s: float) -> bool:
        """Return whether the work does not come back.

        limit_s: Elapsed time that is given in any case, s.
        Returns: False where it cannot be known.
        """
        return self.computed_s >= COMPUTED_S and self.passed_s > limit_s
