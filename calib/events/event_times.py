"""Events by their time: hundreds share a microsecond, and what depends on it is computed once; no pixel positions."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from calib.compiled import KERNEL


class EventTimes(NamedTuple):
    """The K different times of N events."""

    t: NDArray[np.int64]  # (K,) int64, us, ascending
    first: NDArray[np.int64]  # (K + 1,) int64, number of the first event at each time; the last value is N
    on: NDArray[np.int64]  # (K,) int64, number of ON events at each time

    @property
    def off(self) -> NDArray[np.int64]:
        """(K,) int64, number of OFF events at each time."""
        return np.diff(self.first) - self.on


def event_times(t: NDArray[np.int64], p: NDArray[np.integer]) -> EventTimes:
    """Gather (N,) events by their time, each time once; times are us, ascending, N >= 1; polarity 1 is ON."""
    is_on = p if p.dtype == np.uint8 else (p > 0).astype(np.uint8)
    return EventTimes(*_gathered(np.ascontiguousarray(t, np.int64), np.ascontiguousarray(is_on)))


@njit(**KERNEL)
def _gathered(t: Any, p: Any) -> tuple[Any, Any, Any]:
    """Return the fields of `EventTimes`.

    The end of each run of equal times is found by doubling steps, then by bisection (Bentley and Yao, 1976).
    """
    n = t.size
    room = min(n, t[n - 1] - t[0] + 1)
    times, first, on = np.empty(room, np.int64), np.empty(room + 1, np.int64), np.empty(room, np.int64)
    k = i = 0
    while i < n:
        low, high, step = i, i + 1, 1
        while high < n and t[high] == t[i]:
            step *= 2
            low, high = high, high + step
        high = min(high, n)
        while high - low > 1:
            middle = (low + high) // 2
            if t[middle] == t[i]:
                low = middle
            else:
                high = middle
        bright = 0
        for j in range(i, high):
            bright += p[j] > 0
        times[k], first[k], on[k] = t[i], i, bright
        k += 1
        i = high
    first[k] = n
    return times[:k], first[: k + 1], on[:k]
