"""Take EVT3 control words in the compiled loop: rows, the sensor's clock, triggers, the rate controller's reports.

A control word holds no event. Each is checked completely, and changes only the state. ``evt3_kernel`` lists the words.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numba import njit

from drivers.camera.evt3_state import S, StopReason
from drivers.camera.word_vectors import JIT

MAX_BACK_STEP_US: Final = 64
"""TIME_LOW of a busy sensor steps back by some microseconds (11 were seen); a much larger step means missing words."""
_RATE_IN: Final = 0x014
RATE_OUT: Final = 0x016
_WINDOW_US: Final = 200
"""Time between two reports of the rate controller."""
_TICK_US: Final = 16
"""Time between two TIME_HIGH words; the sensor sends them also when it sends nothing else."""
_MAX_TICKS: Final = 1024


@njit(**JIT)
def _time_high(state: Any, high: int, gaps: Any) -> StopReason:
    """Advance the clock. A step of more than one is a gap; a step back by at least 2048 is a wrap."""
    old = state[S.HIGH]
    before = state[S.T]
    if high == old:
        return StopReason.NONE
    if high < old:
        if high > old - 2048:
            return StopReason.CLOCK
        state[S.WRAPS_US] += 1 << 24
    state[S.HIGH] = high
    state[S.T] = state[S.WRAPS_US] + (high << 12)
    if old >= 0 and (state[S.T] >> 12) - (before >> 12) > 1:
        if state[S.GAPS] < len(gaps):
            gaps[state[S.GAPS], 0] = before
            gaps[state[S.GAPS], 1] = state[S.T]
        state[S.GAPS] += 1
    return StopReason.NONE


@njit(**JIT)
def _time_low(state: Any, low: int) -> StopReason:
    """Set the lower part of the clock."""
    if state[S.HIGH] < 0:
        return StopReason.NONE
    t = ((state[S.T] >> 12) << 12) | low
    back = state[S.T] - t
    if back > 0:
        if back > MAX_BACK_STEP_US:
            return StopReason.CLOCK
        state[S.BACK_STEPS] += 1
    elif state[S.FIRST_T] < 0:
        state[S.FIRST_T] = t
    state[S.T] = t
    return StopReason.NONE


@njit(**JIT)
def idle_us(words: Any, start: int, i: int, state: Any, high_before: int) -> int:
    """Return for how long only TIME_HIGH words have come before word i.

    In a stream without events the time stands still until the next TIME_LOW; TIME_HIGH comes every 16 us all the same.
    The state holds the value from before ``start``, so the result does not depend on how a stream is cut.

    words: (N,) uint16, EVT3 words.
    start: Index of the first word of this call.
    state: (30,) int64 as of ``new_state``; not changed.
    high_before: TIME_HIGH in force at ``start``.
    Returns: Time, us; -1 if it is not known.
    """
    ticks = 0
    for j in range(i - 1, start - 1, -1):
        word: Any = np.int64(words[j])
        if word >> 12 == 0x6:
            return _TICK_US * ticks
        if word >> 12 == 0x8:
            if word & 0xFFF != state[S.HIGH]:  # the TIME_HIGH after it set the time
                return _TICK_US * max(ticks - 1, 0)
            ticks += 1
            if ticks > _MAX_TICKS:
                return -1
    if state[S.HIGH] != high_before:
        return _TICK_US * max(ticks - 1, 0)
    silent = state[S.IDLE_US]
    return -1 if silent < 0 or silent > _TICK_US * (_MAX_TICKS - ticks) else silent + _TICK_US * ticks


@njit(**JIT)
def _rate_controller(state: Any, kind: int, payload: int) -> None:
    """Add an OTHERS word, or a part of its payload, to the counters of the rate controller.

    Parts are added as they come, so that a payload without its last four bits counts as well. (The last four bits stay
    zero below 16 million events in 200 us.) The sensor counts exactly the events that it sends between two reports, so
    events that did not arrive are noticed. A report that follows missing reports counts its own window only, but the
    events that arrived since the report before it belong to all these windows: more events are then lost than counted.
    """
    if kind == 0xE:
        state[S.SUBTYPE] = payload
        state[S.PARTS] = 0
        if payload == RATE_OUT:
            sent = state[S.EVENTS] + state[S.TAKEN]
            state[S.ARRIVED] = sent - state[S.EVENTS_AT_REPORT] if state[S.EVENTS_AT_REPORT] >= 0 else -1
            now = state[S.T] + state[S.IDLE_US] if min(state[S.T], state[S.IDLE_US]) >= 0 else -1
            if min(now, state[S.REPORT_T]) >= 0 and state[S.EVENTS_AT_REPORT] >= 0:
                windows = (now - state[S.REPORT_T] + _WINDOW_US // 2) // _WINDOW_US
                state[S.MISSING_WINDOWS] += max(windows - 1, 0)
            state[S.EVENTS_AT_REPORT] = sent
            state[S.REPORT_T] = now
            state[S.REPORTED] = 0
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
        state[S.REPORTED] += value
        if parts == 1 and state[S.ARRIVED] >= 0 and state[S.REPORTED] != state[S.ARRIVED]:
            state[S.MISMATCHED_WINDOWS] += 1
            state[S.LOST] += max(state[S.REPORTED] - state[S.ARRIVED], 0)


@njit(**JIT)
def _trigger(state: Any, payload: int, edges: Any) -> StopReason:
    """Store a trigger edge."""
    if state[S.T] < 0:
        state[S.UNPLACED] += 1
        return StopReason.NONE
    n = state[S.TAKEN_EDGES]
    if n == len(edges):
        return StopReason.ROOM
    edges[n, 0] = state[S.T]
    edges[n, 1] = payload & 1
    edges[n, 2] = payload >> 8
    state[S.TAKEN_EDGES] = n + 1
    state[S.TRIGGERS] += 1
    return StopReason.NONE


@njit(**JIT)
def take_control_word(state: Any, kind: int, payload: int, gaps: Any, edges: Any) -> StopReason:
    """Take a word that holds no event, with every check.

    state: (30,) int64 as of ``new_state``; changed.
    kind: Type of the word, its upper 4 bits.
    payload: Lower 12 bits of the word.
    gaps: (G, 2) int64 to fill, us: clock before and after each of the first G gaps.
    edges: (E, 3) int64 to fill: time (us), value and channel of trigger edges.
    Returns: NONE, or why the word cannot be taken.
    """
    if kind <= 0x1:
        address = payload & 0x7FF
        if address >= state[S.HEIGHT]:
            return StopReason.ROW
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
        return StopReason.RESERVED
    return StopReason.NONE
