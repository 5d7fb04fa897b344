"""Events by their time: hundreds share a microsecond, and what depends on it is computed once; no pixel positions."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.arrays import Ints


class EventTimes(NamedTuple):
    """The K different times of N events."""

    t: Ints  # (K,) int64, us, ascending
    first: Ints  # (K + 1,) int64, number of the first event at each time; the last value is N
    on: Ints  # (K,) int64, number of ON events at each time

    @property
    def off(self) -> Ints:
        """(K,) int64, number of OFF events at each time."""
        return np.diff(self.first) - self.on

    def between(self, start_us: float, end_us: float) -> EventTimes:
        """Return the times from a start to before an end, us; events keep their numbers."""
        begin, end = np.searchsorted(self.t, [math.ceil(start_us), math.ceil(end_us)])
        return EventTimes(self.t[begin:end], self.first[begin : end + 1], self.on[begin:end])


def event_times(t: Ints, p: NDArray[np.integer]) -> EventTimes:
    """Gather (N,) events by their time, each time once; times are us, ascending; polarity 1 is ON."""
    is_new = np.ones(len(t), np.bool_)
    np.not_equal(t[1:], t[:-1], out=is_new[1:])
    first = np.append(np.flatnonzero(is_new), len(t))
    on = np.add.reduceat(p > 0, first[:-1], dtype=np.int64)
    return EventTimes(t[first[:-1]].astype(np.int64), first, on)
