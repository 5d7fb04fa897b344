"""Decode EVT3 words in one compiled loop.

An EVT3 word has 16 bits; its upper four are the type. ``_take_single_events`` and ``_take_vectors`` take the words that
nearly all streams consist of, as long as they are as expected. They leave every other word to ``_take_rare``, which
says what is wrong with it, and to ``take_control_word``: rows, clock, triggers, the rate controller. The state is one
int64 array, whose places are named here; a stream may be cut between any two words.

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
0x9  -               0x9999 is padding; no other word of this type exists, nor of 0xB and 0xC
0xA  EXT_TRIGGER     [0] edge (1 = rising), [11:8] channel
0xD  IMU             skipped
0xE  OTHERS          subtype 0x014 / 0x016: events into / out of the rate controller
0xF  CONTINUED_12    12 bits of an OTHERS payload
==== =============== =====================================================================

Source: Prophesee, "EVT 3.0 Format", https://docs.prophesee.ai/stable/data/encoding_formats/evt3.html. Type 0xD and the
subtypes of OTHERS are named in OpenEB's source (evt3_event_types.h); 0x1 is in neither.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numba import njit

from drivers.camera.evt3_state import (
    INNER,
    JIT,
    S,
    StopReason,
    idle_us_of,
    one_tick_later,
    take_control_word,
    take_reports,
    ticks_of,
)

MARGIN: Final = 32
"""Room that the arrays need beyond the last event: three vectors are written at once."""

_BYTES: Final = np.arange(256, dtype=np.uint8)[:, None] >> np.arange(8, dtype=np.uint8) & 1
_ONES: Final = _BYTES.sum(axis=1).astype(np.uint64)
"""Number of bits that are set in each byte."""
_COLUMNS: Final = np.argsort(1 - _BYTES, axis=1, kind="stable").astype(np.uint8)
"""Places of the bits that are set in each byte, lowest first; then of the others."""
_WORDS: Final = np.arange(1 << 16)
_BITS: Final = np.choose(_WORDS >> 12, [0, 0, 1, 0, _WORDS & 0xFFF, _WORDS & 0xFF, *[0] * 10])
_MOST_EVENTS: Final = (_ONES[_BITS & 0xFF] + _ONES[_BITS >> 8]).astype(np.uint8)
"""Number of events that each word may hold."""

_ONE, _TWO, _THREE = np.uint64(1), np.uint64(2), np.uint64(3)  # array indices without a sign are quicker
_BYTE, _EIGHT, _TWELVE = np.uint64(0xFF), np.uint64(8), np.uint64(12)


@njit(**JIT)
def max_event_count(words: Any) -> int:
    """Return an upper bound of the number of events that (N,) uint16 words hold; never too small."""
    n = 0
    for k in range(len(words)):
        n += _MOST_EVENTS[words[k]]
    return n


@njit(**JIT)
def add_events(events: Any, n: int, image: Any) -> None:
    """Add the first n events to an image of counts, (2, height, width) of any integer; none lies outside it."""
    _, x, y, p = events
    for k in range(n):
        image[p[k], y[k], x[k]] += 1


@njit(**INNER, forceinline=True)
def _write_times_and_rows(events: Any, begin: Any, end: Any, t: int, y: int) -> Any:
    """Write what the events from ``begin`` to ``end`` have in common; return ``end``."""
    t_out, _, y_out, _ = events
    for k in range(begin, end):
        t_out[k] = t
    for k in range(begin, end):
        y_out[k] = y
    return end


@njit(**INNER, forceinline=True)
def _write_columns(events: Any, n: Any, x: int, p: int, bits: Any, bytes_: int) -> Any:
    """Write an event for each bit set, lowest first; return the index after the last. 8 places a byte are touched."""
    _, x_out, _, p_out = events
    for k in range(8 * bytes_):
        p_out[n + np.uint64(k)] = p
    for byte in range(bytes_):
        here = bits >> np.uint64(8 * byte) & _BYTE
        for k in range(8):
            x_out[n + np.uint64(k)] = x + 8 * byte + _COLUMNS[here, k]
        n += _ONES[here]
    return n


@njit(**INNER, forceinline=True)
def _vector(words: Any, i: Any, base: int, width: int) -> tuple[Any, int, Any]:
    """Return the bits of the vectors at word i, the number of their columns, and of their words.

    Sensors send triples of 12 + 12 + 8 columns, which are taken at once.
    """
    bits = np.uint64(words[i] & 0xFFF)
    if words[i] >> 12 == 0x5:
        return bits & _BYTE, 8, _ONE
    if base + 32 <= width and i + _TWO < np.uint64(len(words)):
        second, third = words[i + _ONE], words[i + _TWO]
        if second >> 12 == 0x4 and third >> 12 == 0x5:
            upper = np.uint64(second & 0xFFF) << _TWELVE | np.uint64(third & 0xFF) << np.uint64(24)
            return bits | upper, 32, _THREE
    return bits, 12, _ONE


@njit(**INNER, forceinline=True)
def _take_single_events(words: Any, start: int, state: Any, room: int, events: Any) -> int:
    """Take rows, times and single events from word ``start`` on; return the index of the first other, or without room.

    In a sparse stream nothing tells the type of the next word, and each wrong guess costs the processor as much as
    several words. So there is no branch on the type: every word writes an event, and only an event moves on by one.
    Types and ranges are compared at once; bit 11 of an address is no part of its number.
    """
    t_out, x_out, y_out, p_out = events
    same_high, width, height = 0x8000 | state[S.HIGH], np.uint64(state[S.WIDTH]), state[S.HEIGHT]
    row, time = state[S.Y], 0x6000 | state[S.T] & 0xFFF
    t_of_time = state[S.T] - time
    ticks = ticks_of(state[S.IDLE_US])
    i, n = np.uint64(start), np.uint64(state[S.TAKEN])
    end = i + np.uint64(min(len(words) - start, room + 1 - state[S.TAKEN]))
    while i < end:
        word: Any = np.int64(words[i])
        address = word & 0xF7FF
        is_row = address < height
        is_event = np.uint64(address - 0x2000) < width
        is_time = np.uint64(word - time) < np.uint64(0x7000 - time)
        is_tick = word == same_high
        if np.int64(is_row) + np.int64(is_event) + np.int64(is_time) + np.int64(is_tick) == 0:
            break
        row = address if is_row else row
        time = word if is_time else time
        ticks = 0 if is_time else ticks + np.int64(is_tick)
        t_out[n], x_out[n], y_out[n], p_out[n] = t_of_time + time, word & 0x7FF, row, word >> 11 & 1
        n += np.uint64(is_event)
        i += _ONE
    state[S.T], state[S.Y], state[S.IDLE_US] = t_of_time + time, row, idle_us_of(ticks)
    on = 0
    for k in range(np.uint64(state[S.TAKEN]), n):
        on += p_out[k]
    state[S.TAKEN], state[S.ON_EVENTS] = n, state[S.ON_EVENTS] + on
    result: Any = np.int64(i)
    return result


@njit(**INNER)
def _take_vectors(words: Any, start: int, state: Any, room: int, events: Any) -> int:
    """Take usual words, vectors too, from ``start`` on; return the index of the first other, or without room.

    Time and row of events are written when one of them changes.
    """
    _, x_out, _, p_out = events
    high, width, height = state[S.HIGH], state[S.WIDTH], state[S.HEIGHT]
    t, y, base, polarity = state[S.T], state[S.Y], state[S.BASE], state[S.POLARITY]
    idle_us, on, begun = state[S.IDLE_US], np.uint64(state[S.ON_EVENTS]), state[S.FIRST_T] >= 0
    i, n = np.uint64(start), np.uint64(state[S.TAKEN])
    written = n
    while i < np.uint64(len(words)) and n <= np.uint64(room):
        word: Any = np.int64(words[i])
        kind, payload, address = word >> 12, word & 0xFFF, word & 0x7FF
        if kind == 0x2:
            if address >= width:
                break
            x_out[n], p_out[n] = address, word >> 11 & 1
            on += np.uint64(word >> 11 & 1)
            n += _ONE
        elif kind == 0x0:
            if address >= height:
                break
            written, y = _write_times_and_rows(events, written, n, t, y), address
        elif kind == 0x6:
            if payload < t & 0xFFF or not begun:
                break
            written, t, idle_us = _write_times_and_rows(events, written, n, t, y), t & -4096 | payload, 0
        elif kind == 0x3:
            base, polarity = address, word >> 11 & 1
        elif kind in (0x4, 0x5):
            bits, columns, taken = _vector(words, i, base, width)
            beyond = bits >> np.uint64(min(max(width - base, 0), 32))
            if base < 0 or beyond != np.uint64(0):
                break
            before = n
            n = _write_columns(events, n, base, polarity, bits, 4 if columns == 32 else 2)
            base, on = base + columns, on + (n - before) * np.uint64(polarity)
            i += taken
            continue
        elif word == 0x8000 | high:
            idle_us = one_tick_later(idle_us)
        else:
            break
        i += _ONE
    _write_times_and_rows(events, written, n, t, y)
    state[S.T], state[S.Y], state[S.BASE], state[S.POLARITY] = t, y, base, polarity
    state[S.IDLE_US], state[S.TAKEN], state[S.ON_EVENTS] = idle_us, n, on
    result: Any = np.int64(i)
    return result


@njit(**INNER)
def _take_rare(word: int, state: Any, gaps: Any, edges: Any) -> StopReason:
    """Take a word that is none of the usual ones, or not as expected."""
    kind, payload = word >> 12, word & 0xFFF
    if kind == 0x2:
        if payload & 0x7FF >= state[S.WIDTH]:
            return StopReason.COLUMN
    elif kind == 0x3:
        state[S.BASE], state[S.POLARITY] = payload & 0x7FF, payload >> 11
    elif kind in (0x4, 0x5):
        columns = 12 if kind == 0x4 else 8
        bits, base = payload & (1 << columns) - 1, state[S.BASE]
        if bits >> min(max(state[S.WIDTH] - base, 0), 12):
            return StopReason.VECTOR
        state[S.BASE] = base + columns if base >= 0 else -1
    else:
        return take_control_word(state, kind, payload, gaps, edges)
    return StopReason.NONE


@njit(**JIT)
def run(words: Any, start: int, state: Any, gaps: Any, events: Any, edges: Any) -> int:
    """Take words from ``start`` on; return the index of the first not taken. ``state[S.STOP_REASON]`` holds the reason.

    ``words`` is (N,) uint16; ``state``, ``gaps`` and ``edges`` as for ``take_control_word``. MARGIN places after the
    last event may be touched.
    """
    room = len(events[0]) - MARGIN
    state[S.TAKEN] = state[S.TAKEN_EDGES] = 0
    reason = StopReason.NONE
    i = start
    while i < len(words) and reason == StopReason.NONE:
        before = i
        full = state[S.TAKEN] > room
        if min(state[S.T], state[S.Y]) >= 0 and not full:
            begun = state[S.FIRST_T] >= 0
            if begun:
                i = take_reports(words, _take_single_events(words, i, state, room, events), state)
            if i < len(words) and (not begun or 0x3 <= words[i] >> 12 <= 0x5):
                i = _take_vectors(words, i, state, room, events)
        if i == before:
            word: Any = np.int64(words[i])
            reason = StopReason.ROOM if full else _take_rare(word, state, gaps, edges)
            i += reason == StopReason.NONE
    state[S.EVENTS] += state[S.TAKEN]
    state[S.STOP_REASON] = reason
    return i
