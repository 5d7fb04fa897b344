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

from drivers.camera.evt3_plain import (
    JIT,
    LONGEST_WAIT,
    SHORTEST_WAIT,
    STRETCH,
    Mode,
    ones,
    take_plain,
)

MARGIN: Final = 32
"""Events that three vectors in a row can hold: room that output arrays need to take them."""

MAX_BACK_STEP_US: Final = 64
"""TIME_LOW of a busy sensor steps back by some us (11 seen); much more means that words are missing."""

_DE_BRUIJN: Final = 0x077CB531
"""Shifted left by k and cut to 32 bits, its upper five bits differ for every k."""
_PLACE: Final = np.array(
    [k for _, k in sorted(((_DE_BRUIJN << k) >> 27 & 31, k) for k in range(32))], np.uint8
)
"""The k of those five bits."""

_RATE_IN: Final = 0x014
_RATE_OUT: Final = 0x016
_WINDOW_US: Final = 200
"""Between two reports."""
_TICK_US: Final = 16
"""Between two TIME_HIGH, said whether there is anything else to say or not."""
_MOST_TICKS: Final = 1024


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


@njit(**JIT)
def _time_high(state: Any, high: int, gaps: Any) -> Fault:
    """Move the clock on; returns a Fault. A step of more than one is a gap, one back by 2048 a wrap."""
    old = state[S.HIGH]
    before = state[S.T]
    if high == old:
        return Fault.NONE
    if high < old:
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


@njit(**JIT)
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


@njit(**JIT)
def _silent_us(words: Any, start: int, i: int, state: Any, high_before: int) -> int:
    """Return for how long the clock has said nothing but TIME_HIGH before word i, us; -1 where nobody knows.

    In a stream without events the time stands still until the next TIME_LOW; TIME_HIGH comes every 16 us all the
    same. What was so before ``start`` stands in the state, so that it is no matter how a stream is cut.
    """
    ticks = 0
    for j in range(i - 1, start - 1, -1):
        word: Any = np.int64(words[j])
        if word >> 12 == 0x6:
            return _TICK_US * ticks
        if word >> 12 == 0x8:
            if word & 0xFFF != state[S.HIGH]:  # the one after it set the time
                return _TICK_US * max(ticks - 1, 0)
            ticks += 1
            if ticks > _MOST_TICKS:
                return -1
    if state[S.HIGH] != high_before:
        return _TICK_US * max(ticks - 1, 0)
    silent = state[S.SILENT_US]
    return -1 if silent < 0 or silent > _TICK_US * (_MOST_TICKS - ticks) else silent + _TICK_US * ticks


@njit(**JIT)
def _rate_controller(state: Any, kind: int, payload: int) -> None:
    """Add an OTHERS word, or a part of its payload, to the rate controller's counters.

    Parts are added as they come, so that a payload without its last four bits counts as well. The sensor
    counts exactly the events that it sends between two reports, so what did not arrive is noticed. (The last
    four bits stay zero below 16 million events in 200 us.) Where reports are missing, the one that follows is of
    the last window alone, and what arrived since the report before is of all of them: the events lost are then
    more than counted.
    """
    if kind == 0xE:
        state[S.SUBTYPE] = payload
        state[S.PARTS] = 0
        if payload == _RATE_OUT:
            sent = state[S.EVENTS] + state[S.TAKEN]
            state[S.WINDOW] = sent - state[S.REPORTED_AT] if state[S.REPORTED_AT] >= 0 else -1
            now = state[S.T] + state[S.SILENT_US] if min(state[S.T], state[S.SILENT_US]) >= 0 else -1
            if min(now, state[S.REPORT_T]) >= 0 and state[S.REPORTED_AT] >= 0:
                windows = (now - state[S.REPORT_T] + _WINDOW_US // 2) // _WINDOW_US
                state[S.MISSING_WINDOWS] += max(windows - 1, 0)
            state[S.REPORTED_AT] = sent
            state[S.REPORT_T] = now
            state[S.COUNTED] = 0
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
        state[S.COUNTED] += value
        if parts == 1 and state[S.WINDOW] >= 0 and state[S.COUNTED] != state[S.WINDOW]:
            state[S.ODD_WINDOWS] += 1
            state[S.LOST] += max(state[S.COUNTED] - state[S.WINDOW], 0)


@njit(**JIT)
def _trigger(state: Any, payload: int, edges: Any) -> Fault:
    """Store a trigger edge; returns a Fault."""
    if state[S.T] < 0:
        state[S.UNPLACED] += 1
        return Fault.NONE
    n = state[S.TAKEN_EDGES]
    if n == len(edges):
        return Fault.ROOM
    edges[n, 0] = state[S.T]
    edges[n, 1] = payload & 1
    edges[n, 2] = payload >> 8
    state[S.TAKEN_EDGES] = n + 1
    state[S.TRIGGERS] += 1
    return Fault.NONE


@njit(**JIT)
def _events_of(state: Any, word: int, second: int, third: int) -> tuple[Fault, int, int, int, int]:
    """Read a single event or a vector: fault, words taken, first column, polarity, one bit a column from there.

    Sensors send vectors as triples of 12 + 12 + 8 columns: these are taken at once, with the two words that
    follow. (They are passed as numbers: an array would have its references counted.)
    """
    kind = word >> 12
    if kind == 0x2:
        x = word & 0x7FF
        return Fault.COLUMN if x >= state[S.WIDTH] else Fault.NONE, 1, x, (word >> 11) & 1, 1
    x = state[S.BASE]
    room = state[S.WIDTH] - x
    if (kind == 0x4) & (second >> 12 == 0x4) & (third >> 12 == 0x5) & (room >= 32):
        taken, columns = 3, 32
        bits = (word & 0xFFF) | (second & 0xFFF) << 12 | (third & 0xFF) << 24
    else:
        taken, columns = 1, 12 if kind == 0x4 else 8
        bits = word & ((1 << columns) - 1)
        if room < columns and bits >> max(room, 0):
            return Fault.VECTOR, taken, x, 0, 0
    if x >= 0:
        state[S.BASE] = x + columns
    return Fault.NONE, taken, x, state[S.POLARITY], bits


@njit(**JIT)
def most_events(words: Any) -> int:
    """How many events the words stand for if all have a place: fast, and never too few."""
    n = 0
    for i in range(len(words)):
        word: Any = np.int64(words[i])
        kind = word >> 12
        n += (kind == 0x2) + ones(word & (0xFFF if kind == 0x4 else 0xFF if kind == 0x5 else 0))
    return n


@njit(**JIT)
def _other_word(state: Any, kind: int, payload: int, gaps: Any, edges: Any) -> Fault:
    """Take a word that stands for no event, with every check; returns a Fault."""
    if kind <= 0x1:
        address = payload & 0x7FF
        if address >= state[S.HEIGHT]:
            return Fault.ROW
        state[S.Y] = address if kind == 0x0 else -1
    elif kind == 0x6:
        return _time_low(state, payload)
    elif kind == 0x8:
        return _time_high(state, payload, gaps)
    elif kind == 0xA:
        return _trigger(state, payload, edges)
    elif kind in (0xE, 0xF, 0x7):
        _rate_controller(state, kind, payload)
    elif kind != 0xD:
        return Fault.RESERVED
    return Fault.NONE


@njit(**JIT)
def _store(
    t_out: Any, x_out: Any, y_out: Any, p_out: Any, n: int, t: int, y: int, x: int, p: int, bits: int
) -> None:
    """Write the events of the bits set, lowest first, from place n on."""
    while bits:
        t_out[n] = t
        x_out[n] = x + _PLACE[((bits & -bits) * _DE_BRUIJN >> 27) & 31]
        y_out[n] = y
        p_out[n] = p
        n += 1
        bits &= bits - 1


@njit(**JIT)
def _count(image: Any, y: int, x: int, p: int, bits: int) -> None:
    """Add the events of the bits set to the image; all columns at once where there are as many."""
    if x + 32 <= image.shape[2]:
        row = image[p, y, x : x + 32]
        for k in range(32):
            row[k] += (bits >> k) & 1
    else:
        while bits:
            image[p, y, x + _PLACE[((bits & -bits) * _DE_BRUIJN >> 27) & 31]] += 1
            bits &= bits - 1


@njit(**JIT)
def run(  # noqa: PLR0912, PLR0915 - one loop that keeps its state in registers
    words: Any, start: int, mode: int, state: Any, gaps: Any, events: Any, image: Any, edges: Any, packed: Any
) -> int:
    """Take words from ``start`` on; returns where it stopped: ``state[S.FAULT]`` says why.

    Stretches of single events, rows and clock words are ``evt3_plain``'s. Between vectors these follow each other in
    no predictable order either, so they are taken without a branch: all that any of them may change is computed,
    and kept if the word is of its type. Vectors and the rarer words, and these where they need a look, go the
    longer way. Stretches are tried again less and less often where there are none.

    Parameters
    ----------
    words
        (N,) uint16.
    mode
        A ``Mode``: events are only tallied, stored in ``events``, or counted in ``image``.
    state, gaps
        As of ``new_state``; (G, 2) int64, clock before and after the first G gaps.
    events, image
        ``Events`` of arrays to fill; (2, height, width) of any integer type.
    edges
        (E, 3) int64 to fill: time, value and channel of trigger edges.
    packed
        Scratch, as ``take_plain`` has it.
    """
    t_out, x_out, y_out, p_out = events  # once: in the loop, each access through the tuple counts references
    room = len(t_out) - MARGIN if mode == Mode.STORE else 1 << 62
    width, height = state[S.WIDTH], state[S.HEIGHT]
    t, y = state[S.T], state[S.Y]
    n = on = 0
    state[S.TAKEN_EDGES] = 0
    fault = Fault.NONE
    repeated, begun = 0x8000 | state[S.HIGH], state[S.FIRST_T]
    high_before = state[S.HIGH]
    i = tried = start
    wait = SHORTEST_WAIT
    while i < len(words):
        if i >= tried:
            before = i
            if (y | begun) >= 0:
                limits = (repeated, width, height, room)
                i, here, on_here, t, y = take_plain(words, i, mode, limits, t, y, n, events, image, packed)
                n += here
                on += on_here
            wait = SHORTEST_WAIT if i - before >= STRETCH else min(2 * wait, LONGEST_WAIT)
            tried = i + wait
        if i == len(words):
            break
        word: Any = np.int64(words[i])
        kind, p, address = word >> 12, (word >> 11) & 1, word & 0x7FF
        is_event, is_row, is_low = kind == 0x2, kind == 0x0, kind == 0x6
        moved = (t & -4096) | (word & 0xFFF)
        usual = is_event & (address < width) | is_row & (address < height) | is_low & (moved >= t)
        if (usual | (word == repeated)) & ((y | begun) >= 0) & (n <= room):
            if mode == Mode.STORE:
                t_out[n] = t
                x_out[n] = address
                y_out[n] = y
                p_out[n] = p
            elif mode == Mode.COUNT:
                image[p & is_event, y, address if is_event else 0] += is_event
            n += is_event
            on += p & is_event
            y = address if is_row else y
            t = moved if is_low else t
        elif kind == 0x3:
            state[S.BASE], state[S.POLARITY] = address, p
        elif kind in (0x2, 0x4, 0x5):
            if n > room:
                fault = Fault.ROOM
                break
            second: Any = np.int64(words[i + 1]) if i + 2 < len(words) else 0
            third: Any = np.int64(words[i + 2]) if i + 2 < len(words) else 0
            fault, taken, x, p, bits = _events_of(state, word, second, third)
            if fault != Fault.NONE:
                break
            if (t | y | x) < 0:
                state[S.UNPLACED] += ones(bits)
                bits = 0
            if mode == Mode.STORE:
                _store(t_out, x_out, y_out, p_out, n, t, y, x, p, bits)
            elif mode == Mode.COUNT and bits:
                _count(image, y, x, p, bits)
            n += ones(bits)
            on += p * ones(bits)
            i += taken - 1
        else:
            state[S.T], state[S.Y], state[S.TAKEN] = t, y, n
            carried = state[S.SILENT_US]
            if word == 0xE000 | _RATE_OUT:
                state[S.SILENT_US] = _silent_us(words, start, i, state, high_before)
            fault = _other_word(state, kind, word & 0xFFF, gaps, edges)
            t, y, state[S.SILENT_US] = state[S.T], state[S.Y], carried
            repeated, begun = 0x8000 | state[S.HIGH], state[S.FIRST_T]
            if fault != Fault.NONE:
                break
        i += 1
    state[S.SILENT_US] = _silent_us(words, start, i, state, high_before)
    state[S.T], state[S.Y], state[S.TAKEN] = t, y, n
    state[S.EVENTS] += n
    state[S.ON_EVENTS] += on
    state[S.FAULT] = fault
    return i
