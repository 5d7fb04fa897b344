"""Decode EVT3 words in one compiled loop.

An EVT3 word has 16 bits; its upper four are the type. ``evt3_vectors`` reads the words of events, ``evt3_plain``
runs of words that hold only single events, rows and clock words, and ``evt3_control_words`` all others. ``evt3_state``
holds what is carried from word to word, and between calls. Parts of the loop are pasted into it (``inline``), so that
it keeps its state in registers and is as fast as one piece.

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

from typing import Any

import numpy as np
from numba import njit

from drivers.camera.evt3_control_words import RATE_OUT, idle_us, take_control_word
from drivers.camera.evt3_plain import (
    BLOCK_WORDS,
    JIT,
    MAX_WAIT_WORDS,
    MIN_WAIT_WORDS,
    Mode,
    decode_plain_words,
    popcount,
)
from drivers.camera.evt3_state import S, StopReason
from drivers.camera.evt3_vectors import MARGIN, count_bits, read_event_word, store_bits


@njit(**JIT)
def max_event_count(words: Any) -> int:
    """Return an upper bound of the number of events that words hold, without decoding them.

    Parameters
    ----------
    words
        (N,) uint16, EVT3 words.

    Returns
    -------
    int
        The number of events if all have a time and a place; never too small.
    """
    n = 0
    for i in range(len(words)):
        word: Any = np.int64(words[i])
        kind = word >> 12
        n += (kind == 0x2) + popcount(word & (0xFFF if kind == 0x4 else 0xFF if kind == 0x5 else 0))
    return n


@njit(**JIT, inline="always")
def _put(mode: int, events: Any, image: Any, n: int, t: int, y: int, x: int, p: int, is_event: bool) -> None:
    """Store or count an event if the word is one. There is no branch, so an output place is touched in any case."""
    t_out, x_out, y_out, p_out = events
    if mode == Mode.STORE:
        t_out[n] = t
        x_out[n] = x
        y_out[n] = y
        p_out[n] = p
    elif mode == Mode.COUNT:
        image[p & is_event, y, x if is_event else 0] += is_event


@njit(**JIT, inline="always")
def _take_events(
    words: Any, i: int, mode: int, state: Any, t: int, y: int, n: int, events: Any, image: Any
) -> tuple[StopReason, int, int, int]:
    """Take the single event or the vector at word i; return stop reason, words taken, events, and how many are ON."""
    word: Any = np.int64(words[i])
    second: Any = np.int64(words[i + 1]) if i + 2 < len(words) else 0
    third: Any = np.int64(words[i + 2]) if i + 2 < len(words) else 0
    reason, taken, x, p, bits = read_event_word(state, word, second, third)
    if reason == StopReason.NONE:
        if (t | y | x) < 0:
            state[S.UNPLACED] += popcount(bits)
            bits = 0
        if mode == Mode.STORE:
            store_bits(events, n, t, y, x, p, bits)
        elif mode == Mode.COUNT and bits:
            count_bits(image, y, x, p, bits)
    found = popcount(bits)
    return reason, taken, found, p * found


@njit(**JIT, inline="always")
def _take_control(
    words: Any,
    start: int,
    i: int,
    state: Any,
    t: int,
    y: int,
    n: int,
    gaps: Any,
    edges: Any,
    high_before: int,
) -> StopReason:
    """Take word i, which holds no event. Clock and row are passed in, and come back in the state."""
    word: Any = np.int64(words[i])
    state[S.T], state[S.Y], state[S.TAKEN] = t, y, n
    carried = state[S.IDLE_US]
    if word == 0xE000 | RATE_OUT:
        state[S.IDLE_US] = idle_us(words, start, i, state, high_before)
    reason = take_control_word(state, word >> 12, word & 0xFFF, gaps, edges)
    state[S.IDLE_US] = carried
    return reason


@njit(**JIT)
def run(  # noqa: PLR0915 - one loop that keeps its state in registers
    words: Any, start: int, mode: int, state: Any, gaps: Any, events: Any, image: Any, edges: Any, packed: Any
) -> int:
    """Take words from ``start`` on; return where it stopped. ``state[S.STOP_REASON]`` holds the reason.

    ``evt3_plain`` takes runs of single events, rows and clock words. Between vectors these words follow each other in
    no predictable order either, so they are taken without a branch: everything that any of them may change is computed,
    and kept if the word is of its type. Vectors, the rarer words, and words that need a check take the slower way.
    Runs are tried less and less often where there are none.

    Parameters
    ----------
    words
        (N,) uint16, EVT3 words.
    start
        Index of the first word to take.
    mode
        A ``Mode``: events are only tallied, stored in ``events``, or counted in ``image``.
    state
        (30,) int64 as of ``new_state``; changed.
    gaps
        (G, 2) int64 to fill, us: clock before and after each of the first G gaps.
    events
        ``Events`` of arrays to fill.
    image
        (2, height, width) of any integer type, to add counts to.
    edges
        (E, 3) int64 to fill: time (us), value and channel of trigger edges.
    packed
        (PACKED_EVENTS,) uint32, scratch of ``decode_plain_words``.

    Returns
    -------
    int
        Index of the first word not taken.
    """
    room = len(events[0]) - MARGIN if mode == Mode.STORE else 1 << 62
    width, height = state[S.WIDTH], state[S.HEIGHT]
    t, y = state[S.T], state[S.Y]
    n = on = 0
    state[S.TAKEN_EDGES] = 0
    reason = StopReason.NONE
    repeated, begun = 0x8000 | state[S.HIGH], state[S.FIRST_T]
    high_before = state[S.HIGH]
    i = tried = start
    wait = MIN_WAIT_WORDS
    while i < len(words):
        if i >= tried:
            before = i
            if (y | begun) >= 0:
                limits = (repeated, width, height, room)
                i, here, on_here, t, y = decode_plain_words(
                    words, i, mode, limits, t, y, n, events, image, packed
                )
                n += here
                on += on_here
            wait = MIN_WAIT_WORDS if i - before >= BLOCK_WORDS else min(2 * wait, MAX_WAIT_WORDS)
            tried = i + wait
        if i == len(words):
            break
        word: Any = np.int64(words[i])
        kind, p, address = word >> 12, (word >> 11) & 1, word & 0x7FF
        is_event, is_row, is_low = kind == 0x2, kind == 0x0, kind == 0x6
        moved = (t & -4096) | (word & 0xFFF)
        usual = is_event & (address < width) | is_row & (address < height) | is_low & (moved >= t)
        if (usual | (word == repeated)) & ((y | begun) >= 0) & (n <= room):
            _put(mode, events, image, n, t, y, address, p, is_event)
            n += is_event
            on += p & is_event
            y = address if is_row else y
            t = moved if is_low else t
        elif kind == 0x3:
            state[S.BASE], state[S.POLARITY] = address, p
        elif kind in (0x2, 0x4, 0x5):
            if n > room:
                reason = StopReason.ROOM
                break
            reason, taken, here, on_here = _take_events(words, i, mode, state, t, y, n, events, image)
            if reason != StopReason.NONE:
                break
            n += here
            on += on_here
            i += taken - 1
        else:
            reason = _take_control(words, start, i, state, t, y, n, gaps, edges, high_before)
            t, y = state[S.T], state[S.Y]
            repeated, begun = 0x8000 | state[S.HIGH], state[S.FIRST_T]
            if reason != StopReason.NONE:
                break
        i += 1
    state[S.IDLE_US] = idle_us(words, start, i, state, high_before)
    state[S.T], state[S.Y], state[S.TAKEN] = t, y, n
    state[S.EVENTS] += n
    state[S.ON_EVENTS] += on
    state[S.STOP_REASON] = reason
    return i
