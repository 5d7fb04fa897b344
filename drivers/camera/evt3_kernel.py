"""Decode EVT3 words in one compiled loop.

An EVT3 word has 16 bits; its upper four are the type. ``evt3_usual`` decodes nearly all words, many at a time. Here the
others are taken one by one, with every check: ``evt3_vectors`` reads those that hold events, ``evt3_control_words`` all
others. ``evt3_state`` holds what is carried from word to word, and between calls.

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

References
----------
Prophesee, "EVT 3.0 Format", https://docs.prophesee.ai/stable/data/encoding_formats/evt3.html. Type 0xD and the subtypes
of OTHERS are named in OpenEB's source (evt3_event_types.h); 0x1 is in neither.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numba import njit

from drivers.camera.evt3_control_words import RATE_OUT, idle_us, take_control_word
from drivers.camera.evt3_state import S, StopReason
from drivers.camera.evt3_usual import Mode, take_usual_words
from drivers.camera.evt3_vectors import MARGIN, count_bits, popcount, read_event_word, store_bits
from drivers.camera.word_vectors import JIT, count_ones

_USUAL: Final = np.isin(np.arange(16), (0x0, 0x2, 0x3, 0x4, 0x6, 0x8))
"""The types of words that ``take_usual_words`` may take."""
_COUNTED_TOGETHER: Final = 4096
"""Number of words whose events are counted in 16 bits; each holds at most 12."""


@njit(**JIT)
def max_event_count(words: Any) -> int:
    """Return an upper bound of the number of events that words hold, without decoding them.

    words: (N,) uint16, EVT3 words.
    Returns: The number of events if all have a time and a place; never too small.
    """
    n = 0
    for begin in range(0, len(words), _COUNTED_TOGETHER):
        part = words[begin : begin + _COUNTED_TOGETHER]
        found = np.uint16(0)  # the loop compiles to vector instructions for this type only
        for k in range(len(part)):
            kind = np.uint16(part[k] >> np.uint16(12))
            mask = np.uint16(0xFFF if kind == 0x4 else 0xFF if kind == 0x5 else 0)
            bits = np.uint16(1 if kind == 0x2 else part[k] & mask)
            found = np.uint16(found + count_ones(bits))
        n += int(found)
    return n


@njit(**JIT, forceinline=True)
def _take_events(
    words: Any, i: int, mode: int, state: Any, room: int, n: int, events: Any, image: Any
) -> tuple[StopReason, int, int, int]:
    """Take the single event or the vector at word i; return stop reason, words taken, events, and how many are ON."""
    if n > room:
        return StopReason.ROOM, 0, 0, 0
    word: Any = np.int64(words[i])
    second: Any = np.int64(words[i + 1]) if i + 2 < len(words) else 0
    third: Any = np.int64(words[i + 2]) if i + 2 < len(words) else 0
    reason, taken, x, p, bits = read_event_word(state, word, second, third)
    if reason != StopReason.NONE:
        return reason, 0, 0, 0
    t, y = state[S.T], state[S.Y]
    found = popcount(bits)
    if (t | y | x) < 0:
        state[S.UNPLACED] += found
        return reason, taken, 0, 0
    if mode == Mode.STORE:
        store_bits(events, n, t, y, x, p, bits)
    elif mode == Mode.COUNT and bits:
        count_bits(image, y, x, p, bits)
    return reason, taken, found, p * found


@njit(**JIT, forceinline=True)
def _take_control(
    words: Any, start: int, i: int, state: Any, n: int, gaps: Any, edges: Any, high_before: int
) -> StopReason:
    """Take word i, which holds no event."""
    word: Any = np.int64(words[i])
    state[S.TAKEN] = n
    carried = state[S.IDLE_US]
    if word == 0xE000 | RATE_OUT:
        state[S.IDLE_US] = idle_us(words, start, i, state, high_before)
    reason = take_control_word(state, word >> 12, word & 0xFFF, gaps, edges)
    state[S.IDLE_US] = carried
    return reason


@njit(**JIT)
def run(
    words: Any,
    start: int,
    mode: int,
    state: Any,
    gaps: Any,
    events: Any,
    image: Any,
    edges: Any,
    scratch: Any,
) -> int:
    """Take words from ``start`` on; return where it stopped. ``state[S.STOP_REASON]`` holds the reason.

    ``evt3_usual`` takes nearly all words. The others are taken one by one, with every check.

    words: (N,) uint16, EVT3 words.
    start: Index of the first word to take.
    mode: A ``Mode``: events are only tallied, stored in ``events``, or counted in ``image``.
    state: (30,) int64 as of ``new_state``; changed.
    gaps: (G, 2) int64 to fill, us: clock before and after each of the first G gaps.
    events: ``Events`` of arrays to fill.
    image: (2, height, width) of any integer type, to add counts to.
    edges: (E, 3) int64 to fill: time (us), value and channel of trigger edges.
    scratch: Two arrays, (BLOCK_WORDS,) uint16.
    Returns: Index of the first word not taken.
    """
    room = len(events[0]) - MARGIN if mode == Mode.STORE else 1 << 62
    n = on = state[S.TAKEN_EDGES] = 0
    reason = StopReason.NONE
    high_before = state[S.HIGH]
    i = start
    while i < len(words) and reason == StopReason.NONE:
        t, y = state[S.T], state[S.Y]
        if (y | state[S.FIRST_T]) >= 0 and _USUAL[words[i] >> 12]:
            columns, rows = min(state[S.WIDTH], 1 << 11), min(state[S.HEIGHT], 1 << 11)
            limits = (0x8000 | state[S.HIGH], columns, rows, room)
            place = (t, y, state[S.BASE], state[S.POLARITY])
            i, here, on_here, t, y, base, p = take_usual_words(
                words, i, mode, limits, place, n, events, image, scratch
            )
            state[S.T], state[S.Y], state[S.BASE], state[S.POLARITY] = t, y, base, p
            n, on = n + here, on + on_here
            if i == len(words):
                break
        kind = words[i] >> 12
        if kind == 0x3:
            state[S.BASE], state[S.POLARITY] = words[i] & 0x7FF, (words[i] >> 11) & 1
            i += 1
        elif kind in (0x2, 0x4, 0x5):
            reason, taken, here, on_here = _take_events(words, i, mode, state, room, n, events, image)
            i, n, on = i + taken, n + here, on + on_here
        else:
            reason = _take_control(words, start, i, state, n, gaps, edges, high_before)
            i += reason == StopReason.NONE
    state[S.IDLE_US] = idle_us(words, start, i, state, high_before)
    state[S.TAKEN] = n
    state[S.EVENTS] += n
    state[S.ON_EVENTS] += on
    state[S.STOP_REASON] = reason
    return i
