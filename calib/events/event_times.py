"""Events by their time: hundreds share a microsecond, and what depends on it is computed once; no pixel positions."""

from __future__ import annotations

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


def event_times(t: Ints, p: NDArray[np.integer]) -> EventTimes:
    """Gather (N,) events by their time, each time once; times are us, ascending, N >= 1; polarity 1 is ON."""
    first = np.concatenate([[0], np.flatnonzero(t[1:] != t[:-1]) + 1, [len(t)]])
    on = np.add.reduceat(p > 0, first[:-1], dtype=np.int64)
    return EventTimes(t[first[:-1]].astype(np.int64), first, on)
