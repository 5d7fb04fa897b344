"""The state of the EVT3 decoder, and the words that change nothing else: rows, clock, triggers, the rate controller."""

from __future__ import annotations

from enum import IntEnum
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

_DECODER: Final[dict[str, Any]] = {"nogil": True, "_nrt": False, "no_cfunc_wrapper": True}
JIT: Final[dict[str, Any]] = {"cache": True, **_DECODER}
"""How the decoder's loops are compiled: without reference counts of arrays (``_nrt``). The loops allocate no arrays,
and counting references took most of the time of the rarer words.
"""
INNER: Final[dict[str, Any]] = {"no_cpython_wrapper": True, **_DECODER}
"""The same of a function that only loops call: a call from Python would crash the process."""

MAX_BACK_STEP_US: Final = 64
"""TIME_LOW of a busy sensor steps back by some microseconds (11 were seen); a much larger step means missing words."""
_PADDING: Final = 0x9999
"""Word that some cameras (Lucid Triton2) send to fill their packets."""
_RATE_IN: Final = 0x014  # Subtypes of OTHERS words: counts before and after the rate controller
_RATE_OUT: Final = 0x016
_WINDOW_US: Final = 200
"""Time between two reports of the rate controller."""
_TICK_US: Final = 16
"""Time between two TIME_HIGH words; the sensor sends them also when it sends nothing else."""
_MAX_TICKS: Final = 1024  # More words than this: the time is unknown


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
    STOP_REASON = 15
    TAKEN = 16
    """Number of events taken in this call."""
    TAKEN_EDGES = 17
    """Number of trigger edges taken in this call."""
    WIDTH = 18
    HEIGHT = 19
    EVENTS_AT_REPORT = 20
    """Number of events of the stream at the last report of the rate controller; -1 before the first report."""
    ARRIVED = 21
    """Number of events between the report that is being read and the one before it; -1 for the first report."""
    REPORTED = 22
    """Number of events that the report being read states for its window."""
    LOST = 23
    """Number of events that the sensor counted in its windows and that did not arrive."""
    MISMATCHED_WINDOWS = 24
    """Number of windows in which the sensor's count differs from the number of events that arrived."""
    REPORT_T = 25
    """Clock at the last report, us; -1 if it is not known."""
    MISSING_WINDOWS = 26
    """Number of windows whose report has not arrived, computed from the time between two reports that have."""
    IDLE_US = 27
    """Time for which only TIME_HIGH words have come, us; -1 if it is not known."""
    UNKNOWN = 28
    """Number of words left out because their type does not exist; -1 if such a word stops the loop."""


def new_state(width: int, height: int) -> NDArray[np.int64]:
    """Return the state before the first word of a stream: (29,) int64, indexed by ``S``."""
    state = np.zeros(len(S), np.int64)
    state[[S.HIGH, S.T, S.Y, S.BASE, S.FIRST_T, S.EVENTS_AT_REPORT, S.REPORT_T, S.IDLE_US, S.UNKNOWN]] = -1
    state[S.WIDTH], state[S.HEIGHT] = width, height
    return state


@njit(**INNER)
def _time_high(state: Any, high: int, gaps: Any) -> StopReason:
    """Advance the clock. A step of more than one is a gap; a step back by at least 2048 is a wrap."""
    old = state[S.HIGH]
    before = state[S.T]
    if high == old:
        state[S.IDLE_US] = one_tick_later(state[S.IDLE_US])
        return StopReason.NONE
    if high < old:
        if high > old - 2048:
            return StopReason.CLOCK
        state[S.WRAPS_US] += 1 << 24
    state[S.HIGH] = high
    state[S.T] = state[S.WRAPS_US] + (high << 12)
    state[S.IDLE_US] = 0
    if old >= 0 and (state[S.T] >> 12) - (before >> 12) > 1:
        if state[S.GAPS] < len(gaps):
            gaps[state[S.GAPS], 0] = before
            gaps[state[S.GAPS], 1] = state[S.T]
        state[S.GAPS] += 1
    return StopReason.NONE


@njit(**INNER)
def _time_low(state: Any, low: int) -> StopReason:
    """Set the lower part of the clock."""
    if state[S.HIGH] < 0:
        return StopReason.NONE
    t = ((state[S.T] >> 12) << 12) | low
    back = state[S.T] - t
    if back > 0:
        if back > MAX_BACK_STEP_US:
            return StopReason.CLOCK
    elif state[S.FIRST_T] < 0:
        state[S.FIRST_T] = t
    state[S.T], state[S.IDLE_US] = t, 0
    return StopReason.NONE


@njit(**INNER, forceinline=True)
def one_tick_later(idle_us: int) -> int:
    """Return for how long only TIME_HIGH words have come, after one more, us; -1 if it is not known.

    In a stream without events the time stands still until the next TIME_LOW; TIME_HIGH comes every 16 us all the same.
    """
    return idle_us + _TICK_US if 0 <= idle_us < _TICK_US * _MAX_TICKS else -1


@njit(**INNER, forceinline=True)
def ticks_of(idle_us: int) -> int:
    """Return the number of TIME_HIGH words that idled for so long; more than any known one if it is not known."""
    return idle_us // _TICK_US if idle_us >= 0 else _MAX_TICKS + 1


@njit(**INNER, forceinline=True)
def idle_us_of(ticks: int) -> int:
    """Return for how long so many TIME_HIGH words idled, us; -1 if it is not known."""
    return _TICK_US * ticks if ticks <= _MAX_TICKS else -1


@njit(**INNER)
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
        if payload == _RATE_OUT:
            sent = state[S.EVENTS] + state[S.TAKEN]
            state[S.ARRIVED] = sent - state[S.EVENTS_AT_REPORT] if state[S.EVENTS_AT_REPORT] >= 0 else -1
            now = state[S.T] + state[S.IDLE_US] if min(state[S.T], state[S.IDLE_US]) >= 0 else -1
            if min(now, state[S.REPORT_T]) >= 0 and state[S.EVENTS_AT_REPORT] >= 0:
                since_us = now - state[S.REPORT_T]
                if since_us >= 3 * _WINDOW_US // 2:  # a division costs as much as the rest of the report
                    state[S.MISSING_WINDOWS] += (since_us + _WINDOW_US // 2) // _WINDOW_US - 1
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
    elif state[S.SUBTYPE] == _RATE_OUT:
        state[S.RATE_OUT] += value
        state[S.REPORTED] += value
        if parts == 1 and state[S.ARRIVED] >= 0 and state[S.REPORTED] != state[S.ARRIVED]:
            state[S.MISMATCHED_WINDOWS] += 1
            state[S.LOST] += max(state[S.REPORTED] - state[S.ARRIVED], 0)


@njit(**INNER, forceinline=True)
def take_reports(words: Any, i: int, state: Any) -> int:
    """Take reports of the rate controller from word ``i`` on; return the index of the first other word."""
    while i < len(words) and words[i] >> 12 in (0x7, 0xE, 0xF):
        word: Any = np.int64(words[i])
        _rate_controller(state, word >> 12, word & 0xFFF)
        i += 1
    return i


@njit(**INNER)
def _trigger(state: Any, payload: int, edges: Any) -> StopReason:
    """Store a trigger edge."""
    if state[S.T] < 0:
        return StopReason.NONE  # the stream was joined in its middle
    n = state[S.TAKEN_EDGES]
    if n == len(edges):
        return StopReason.ROOM
    edges[n, 0] = state[S.T]
    edges[n, 1] = payload & 1
    edges[n, 2] = payload >> 8
    state[S.TAKEN_EDGES] = n + 1
    state[S.TRIGGERS] += 1
    return StopReason.NONE


@njit(**INNER)
def take_control_word(state: Any, kind: int, payload: int, gaps: Any, edges: Any) -> StopReason:
    """Take a word that holds no event, with every check; return NONE, or why it cannot be taken.

    ``state`` is (29,) int64 as of ``new_state``; changed. ``kind`` and ``payload`` are the upper 4 and lower 12 bits.
    To fill: ``gaps``, (G, 2) int64, us: clock before and after each of the first G gaps; ``edges``, (E, 3) int64: time
    (us), value and channel.
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
    elif kind != 0xD and (kind << 12 | payload) != _PADDING:
        if state[S.UNKNOWN] < 0:
            return StopReason.RESERVED
        state[S.UNKNOWN] += 1
    return StopReason.NONE
