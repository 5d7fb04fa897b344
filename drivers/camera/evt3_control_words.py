"""EVT3 words that stand for no event, compiled: rows, the sensor's clock, triggers, the rate controller's reports.

Each is taken with every check, and changes the state alone; ``evt3_kernel`` says which words there are. Knows no
files and no devices.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numba import njit

from drivers.camera.evt3_plain import JIT
from drivers.camera.evt3_state import Fault, S

MAX_BACK_STEP_US: Final = 64
"""TIME_LOW of a busy sensor steps back by some us (11 seen); much more means that words are missing."""
_RATE_IN: Final = 0x014
RATE_OUT: Final = 0x016
_WINDOW_US: Final = 200
"""Between two reports."""
_TICK_US: Final = 16
"""Between two TIME_HIGH, said whether there is anything else to say or not."""
_MOST_TICKS: Final = 1024


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
def silent_us(words: Any, start: int, i: int, state: Any, high_before: int) -> int:
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
        if payload == RATE_OUT:
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
    elif state[S.SUBTYPE] == RATE_OUT:
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
def take_control_word(state: Any, kind: int, payload: int, gaps: Any, edges: Any) -> Fault:
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
