"""The loop over EVT3 words, compiled: knows the word types and the sensor clock, no files and no devices.

An EVT3 word has 16 bits; its upper four are the type. State is carried between calls in one int64 array,
so a stream may be cut between any two words.

==== =============== =====================================================================
type name            payload
==== =============== =====================================================================
0x0  ADDR_Y          [10:0] row of the following events, [11] master or slave camera
0x1  ADDR_Y_OTHER    row of events that are not contrast changes: they are skipped
0x2  ADDR_X          [10:0] column, [11] polarity: one event
0x3  VECT_BASE_X     [10:0] first column, [11] polarity of the vectors that follow
0x4  VECT_12         one bit a column; the base then moves on by 12
0x5  VECT_8          the same for 8 columns
0x6  TIME_LOW        lower 12 bits of the clock, us
0x7  CONTINUED_4     last 4 bits of an OTHERS payload (some sensors leave it out)
0x8  TIME_HIGH       upper 12 bits of the clock: it wraps every 2^24 us
0xA  EXT_TRIGGER     [0] edge (1 = rising), [11:8] channel
0xD  IMU             skipped
0xE  OTHERS          subtype 0x014 / 0x016: events into / out of the rate controller
0xF  CONTINUED_12    12 bits of an OTHERS payload
==== =============== =====================================================================
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

VECTOR_COLUMNS: Final = 12
"""Columns of the widest vector: room that output arrays need for one more word."""

MAX_BACK_STEP_US: Final = 64
"""TIME_LOW of a busy sensor steps back by some us (11 seen); much more means that words are missing."""

_RATE_IN: Final = 0x014
_RATE_OUT: Final = 0x016


class Fault(IntEnum):
    """Why the loop stopped before the end of the words."""

    NONE = 0
    ROOM = 1
    ROW = 2
    COLUMN = 3
    VECTOR = 4
    CLOCK = 5
    RESERVED = 6


class Mode(IntEnum):
    """What becomes of an event."""

    TALLY = 0
    STORE = 1
    COUNT = 2


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
    RATE_WINDOWS = 14
    """OTHERS words of subtype 0x016: one for each window of the rate controller."""
    GAPS = 15
    UNPLACED = 16
    """Events without a time, a row or a vector base: the stream was joined in its middle."""
    BACK_STEPS = 17
    FAULT = 18
    STORED = 19
    """Events written in this call."""
    STORED_TRIGGERS = 20
    WIDTH = 21
    HEIGHT = 22


def new_state(width: int, height: int) -> NDArray[np.int64]:
    """State before the first word of a stream."""
    state = np.zeros(len(S), np.int64)
    state[[S.HIGH, S.T, S.Y, S.BASE, S.FIRST_T]] = -1
    state[S.WIDTH], state[S.HEIGHT] = width, height
    return state


@njit(cache=True, nogil=True)
def _time_high(state: Any, high: int, gaps: Any) -> Fault:
    """Move the clock on; returns a Fault. A step of more than one is a gap, one back by 2048 a wrap."""
    old = state[S.HIGH]
    before = state[S.T]
    if old >= 0 and high < old:
        if high > old - 2048:
            return Fault.CLOCK
        state[S.LOOPS_US] += 1 << 24
    state[S.HIGH] = high
    state[S.T] = state[S.LOOPS_US] + (high << 12)
    if old >= 0 and (state[S.T] >> 12) - (before >> 12) > 1:
        if state[S.GAPS] < len(gaps):
            gaps[state[S.GAPS], 0] = before
            gaps[state[S.GAPS], 1] = state[S.T]
        state[S.GAPS] += 1
    return Fault.NONE


@njit(cache=True, nogil=True)
def _time_low(state: Any, low: int) -> Fault:
    """Set the lower part of the clock; returns a Fault."""
    if state[S.HIGH] < 0:
        return Fault.NONE
    t = ((state[S.T] >> 12) << 12) | low
    back = state[S.T] - t
    if back > 0:
        if back > MAX_BACK_STEP_US:
            return Fault.CLOCK
        state[S.BACK_STEPS] += 1
    elif state[S.FIRST_T] < 0:
        state[S.FIRST_T] = t
    state[S.T] = t
    return Fault.NONE


@njit(cache=True, nogil=True)
def _rate_controller(state: Any, kind: int, payload: int) -> None:
    """Add an OTHERS word, or a part of its payload, to the rate controller's counters.

    Parts are added as they come, so that a payload without its last four bits counts as well.
    """
    if kind == 0xE:
        state[S.SUBTYPE] = payload
        state[S.PARTS] = 0
        if payload == _RATE_OUT:
            state[S.RATE_WINDOWS] += 1
        return
    parts = state[S.PARTS]
    state[S.PARTS] = parts + 1
    if parts > 2 or (kind == 0x7) != (parts == 2):
        return
    value = (payload & 0xF if kind == 0x7 else payload) << (12 * parts)
    if state[S.SUBTYPE] == _RATE_IN:
        state[S.RATE_IN] += value
    elif state[S.SUBTYPE] == _RATE_OUT:
        state[S.RATE_OUT] += value


@njit(cache=True, nogil=True)
def _trigger(state: Any, payload: int, triggers: Any) -> Fault:
    """Store a trigger edge; returns a Fault."""
    if state[S.T] < 0:
        state[S.UNPLACED] += 1
        return Fault.NONE
    n = state[S.STORED_TRIGGERS]
    if n == len(triggers.t):
        return Fault.ROOM
    triggers.t[n] = state[S.T]
    triggers.value[n] = payload & 1
    triggers.id[n] = payload >> 8
    state[S.STORED_TRIGGERS] = n + 1
    state[S.TRIGGERS] += 1
    return Fault.NONE


@njit(cache=True, nogil=True)
def _other_word(state: Any, kind: int, payload: int, gaps: Any, triggers: Any) -> Fault:
    """Take a word of the rarer types; returns a Fault."""
    if kind == 0x8:
        return _time_high(state, payload, gaps)
    if kind == 0xA:
        return _trigger(state, payload, triggers)
    if kind in (0xE, 0xF, 0x7):
        _rate_controller(state, kind, payload)
        return Fault.NONE
    return Fault.NONE if kind == 0xD else Fault.RESERVED


@njit(cache=True, nogil=True)
def _event(mode: int, out: Any, image: Any, n: int, t: int, y: int, x: int, polarity: int) -> int:
    """Take one event as the nth of this call; returns n + 1."""
    if mode == Mode.STORE:
        out.t[n] = t
        out.x[n] = x
        out.y[n] = y
        out.p[n] = polarity
    elif mode == Mode.COUNT:
        image[polarity, y, x] += 1
    return n + 1


@njit(cache=True, nogil=True)
def _vector(
    mode: int, out: Any, image: Any, n: int, t: int, y: int, base: int, polarity: int, bits: int
) -> int:
    """Take the events of a vector, from the nth of this call on; returns n plus how many they are.

    When storing, twelve places are always written and the next one moves on by each bit: nothing to
    mispredict.
    """
    if mode == Mode.STORE:
        for k in range(VECTOR_COLUMNS):
            out.t[n + k] = t
            out.y[n + k] = y
            out.p[n + k] = polarity
        for k in range(VECTOR_COLUMNS):
            out.x[n] = base + k
            n += (bits >> k) & 1
        return n
    if mode == Mode.COUNT:
        for k in range(min(VECTOR_COLUMNS, image.shape[2] - base)):
            image[polarity, y, base + k] += (bits >> k) & 1
    for k in range(VECTOR_COLUMNS):
        n += (bits >> k) & 1
    return n


@njit(cache=True, nogil=True)
def run(  # noqa: PLR0912, PLR0915 - one switch over the word types, in one loop that keeps its state in registers
    words: Any, start: int, mode: int, state: Any, gaps: Any, out: Any, image: Any, triggers: Any
) -> int:
    """Take words from ``start`` on; returns where it stopped: ``state[S.FAULT]`` says why.

    Parameters
    ----------
    words
        (N,) uint16.
    mode
        A ``Mode``: events are only tallied, stored in ``out``, or counted in ``image``.
    state, gaps
        As of ``new_state``; (G, 2) int64, clock before and after the first G gaps.
    out, image, triggers
        ``Events`` and ``Triggers`` of arrays to fill; (2, height, width) of any integer type.
    """
    width, height = state[S.WIDTH], state[S.HEIGHT]
    room = len(out.t) - VECTOR_COLUMNS if mode == Mode.STORE else 1 << 62
    t, y, base, polarity = state[S.T], state[S.Y], state[S.BASE], state[S.POLARITY]
    n = on = 0
    state[S.STORED_TRIGGERS] = 0
    fault = Fault.NONE
    i = start
    while i < len(words):
        word: Any = np.int64(words[i])
        kind = word >> 12
        payload = word & 0xFFF
        if kind in (0x2, 0x4, 0x5) and n > room:
            fault = Fault.ROOM
        elif kind == 0x2:
            x = payload & 0x7FF
            if x >= width:
                fault = Fault.COLUMN
            elif (y | t) < 0:
                state[S.UNPLACED] += 1
            else:
                n = _event(mode, out, image, n, t, y, x, payload >> 11)
                on += payload >> 11
        elif kind in (0x4, 0x5):
            columns = 12 if kind == 0x4 else 8
            bits = payload & ((1 << columns) - 1)
            if base + columns > width and bits >> max(width - base, 0):
                fault = Fault.VECTOR
            elif (y | t | base) < 0:
                state[S.UNPLACED] += _vector(Mode.TALLY, out, image, 0, t, y, base, polarity, bits)
            else:
                before = n
                n = _vector(mode, out, image, n, t, y, base, polarity, bits)
                on += polarity * (n - before)
            if fault == Fault.NONE and base >= 0:
                base += columns
        elif kind <= 0x1:
            y = payload & 0x7FF
            if y >= height:
                fault = Fault.ROW
            if kind == 0x1:
                y = np.int64(-1)
        elif kind == 0x3:
            base = payload & 0x7FF
            polarity = payload >> 11
        elif kind == 0x6:
            fault = _time_low(state, payload)
            t = state[S.T]
        elif kind != 0x8 or payload != state[S.HIGH]:  # most TIME_HIGH only repeat the last one
            fault = _other_word(state, kind, payload, gaps, triggers)
            t = state[S.T]
        if fault != Fault.NONE:
            break
        i += 1
    state[S.Y], state[S.BASE], state[S.POLARITY] = y, base, polarity
    state[S.STORED] = n
    state[S.EVENTS] += n
    state[S.ON_EVENTS] += on
    state[S.FAULT] = fault
    return i
