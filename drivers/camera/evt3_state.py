"""What is carried from one piece of an EVT3 stream to the next: one int64 array, its places named here.

So a stream may be cut between any two words. Knows no words, no files and no devices.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray


class Fault(IntEnum):
    """Why the loop stopped before the end of the words."""

    NONE = 0
    ROOM = 1
    ROW = 2
    COLUMN = 3
    VECTOR = 4
    CLOCK = 5
    RESERVED = 6


class S(IntEnum):
    """Places in the state array."""

    HIGH = 0
    """Last TIME_HIGH, -1 before the first."""
    LOOPS_US = 1
    """Full turns of the 24-bit clock, us."""
    T = 2
    """Clock, us, unwrapped; -1 before the first TIME_HIGH."""
    Y = 3
    """Row, -1 before the first and in rows of other events."""
    BASE = 4
    """Column of the next vector, -1 before the first."""
    POLARITY = 5
    SUBTYPE = 6
    """Subtype of the OTHERS word whose payload is being read."""
    PARTS = 7
    """How many 12-bit parts of it have come."""
    FIRST_T = 8
    """Clock at the first TIME_LOW after a TIME_HIGH, -1 before."""
    EVENTS = 9
    ON_EVENTS = 10
    TRIGGERS = 11
    RATE_IN = 12
    RATE_OUT = 13
    GAPS = 14
    UNPLACED = 15
    """Events without a time, a row or a vector base: the stream was joined in its middle."""
    BACK_STEPS = 16
    FAULT = 17
    TAKEN = 18
    """Events taken in this call."""
    TAKEN_EDGES = 19
    WIDTH = 20
    HEIGHT = 21
    REPORTED_AT = 22
    """Events of the stream at the last report of the rate controller, -1 before the first."""
    WINDOW = 23
    """Events between the report that is being read and the one before it, -1 for the first."""
    COUNTED = 24
    """Events that this report tells of its window."""
    LOST = 25
    """Events that the sensor counted in its windows and that did not arrive."""
    ODD_WINDOWS = 26
    """Windows in which the sensor's count is not that of the events that arrived."""
    REPORT_T = 27
    """Clock at the last report, us; -1 where it is not known."""
    MISSING_WINDOWS = 28
    """Windows whose report has not arrived, by the time between two that have."""
    SILENT_US = 29
    """For how long the clock has said nothing but TIME_HIGH, at a report and between calls; -1: nobody knows."""


def new_state(width: int, height: int) -> NDArray[np.int64]:
    """State before the first word of a stream."""
    state = np.zeros(len(S), np.int64)
    state[[S.HIGH, S.T, S.Y, S.BASE, S.FIRST_T, S.REPORTED_AT, S.REPORT_T, S.SILENT_US]] = -1
    state[S.WIDTH], state[S.HEIGHT] = width, height
    return state
