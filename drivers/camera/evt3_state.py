"""The state that the EVT3 decoder carries from one piece of a stream to the next.

The state is one int64 array, whose places are named here. A stream may be cut between any two words.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray


class StopReason(IntEnum):
    """Why the loop over the words stopped.

    VECTOR: A vector holds an event beyond the last column.
    CLOCK: The sensor's clock steps back too far.
    RESERVED: The type of the word does not exist.
    """

    NONE = 0
    ROOM = 1
    ROW = 2
    COLUMN = 3
    VECTOR = 4
    CLOCK = 5
    RESERVED = 6


class S(IntEnum):
    """Index in the state array."""

    HIGH = 0
    """Last TIME_HIGH; -1 before the first."""
    WRAPS_US = 1
    """Full turns of the 24-bit clock, us."""
    T = 2
    """Clock, us, unwrapped; -1 before the first TIME_HIGH."""
    Y = 3
    """Row; -1 before the first, and in rows of other events."""
    BASE = 4
    """Column of the next vector; -1 before the first vector base."""
    POLARITY = 5
    SUBTYPE = 6
    """Subtype of the OTHERS word whose payload is being read."""
    PARTS = 7
    """Number of 12-bit parts of that payload that have arrived."""
    FIRST_T = 8
    """Clock at the first TIME_LOW after a TIME_HIGH, us; -1 before it."""
    EVENTS = 9
    ON_EVENTS = 10
    TRIGGERS = 11
    RATE_IN = 12
    RATE_OUT = 13
    GAPS = 14
    UNPLACED = 15
    """Number of events without a time, a row or a vector base: the stream was joined in its middle."""
    BACK_STEPS = 16
    STOP_REASON = 17
    TAKEN = 18
    """Number of events taken in this call."""
    TAKEN_EDGES = 19
    """Number of trigger edges taken in this call."""
    WIDTH = 20
    HEIGHT = 21
    EVENTS_AT_REPORT = 22
    """Number of events of the stream at the last report of the rate controller; -1 before the first report."""
    ARRIVED = 23
    """Number of events between the report that is being read and the one before it; -1 for the first report."""
    REPORTED = 24
    """Number of events that the report being read states for its window."""
    LOST = 25
    """Number of events that the sensor counted in its windows and that did not arrive."""
    MISMATCHED_WINDOWS = 26
    """Number of windows in which the sensor's count differs from the number of events that arrived."""
    REPORT_T = 27
    """Clock at the last report, us; -1 if it is not known."""
    MISSING_WINDOWS = 28
    """Number of windows whose report has not arrived, computed from the time between two reports that have."""
    IDLE_US = 29
    """Time for which only TIME_HIGH words have come, us, at a report and between calls; -1 if it is not known."""


def new_state(width: int, height: int) -> NDArray[np.int64]:
    """Return the state before the first word of a stream.

    width, height: Size of the sensor, px.
    Returns: (30,) int64, indexed by ``S``.
    """
    state = np.zeros(len(S), np.int64)
    state[[S.HIGH, S.T, S.Y, S.BASE, S.FIRST_T, S.EVENTS_AT_REPORT, S.REPORT_T, S.IDLE_US]] = -1
    state[S.WIDTH], state[S.HEIGHT] = width, height
    return state
