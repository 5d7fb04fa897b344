"""The loop over EVT3 words, compiled: knows the word types and the sensor clock, no files and no devices.

An EVT3 word has 16 bits; its upper four are the type. ``evt3_vectors`` reads the words of events, ``evt3_plain``
stretches that hold only single events, rows and clock words, and ``evt3_control_words`` all others. ``evt3_state``
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
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from drivers.camera.evt3_control_words import RATE_OUT, silent_us, take_control_word
from drivers.camera.evt3_plain import JIT, LONGEST_WAIT, SHORTEST_WAIT, STRETCH, Mode, ones, take_plain
from drivers.camera.evt3_state import Fault, S
from drivers.camera.evt3_vectors import MARGIN, count, events_of, store


@njit(**JIT)
def most_events(words: Any) -> int:
    """How many events the words stand for if all have a place: fast, and never too few."""
    n = 0
    for i in range(len(words)):
        word: Any = np.int64(words[i])
        kind = word >> 12
        n += (kind == 0x2) + ones(word & (0xFFF if kind == 0x4 else 0xFF if kind == 0x5 else 0))
    return n


@njit(**JIT, inline="always")
def _put(mode: int, events: Any, image: Any, n: int, t: int, y: int, x: int, p: int, is_event: bool) -> None:
    """Store or count an event, if the word is one; without a branch, so a place is touched in any case."""
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
) -> tuple[Fault, int, int, int]:
    """Take the single event or the vector at word i: fault, words taken, events, how many of them ON."""
    word: Any = np.int64(words[i])
    second: Any = np.int64(words[i + 1]) if i + 2 < len(words) else 0
    third: Any = np.int64(words[i + 2]) if i + 2 < len(words) else 0
    fault, taken, x, p, bits = events_of(state, word, second, third)
    if fault == Fault.NONE:
        if (t | y | x) < 0:
            state[S.UNPLACED] += ones(bits)
            bits = 0
        if mode == Mode.STORE:
            store(events, n, t, y, x, p, bits)
        elif mode == Mode.COUNT and bits:
            count(image, y, x, p, bits)
    found = ones(bits)
    return fault, taken, found, p * found


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
) -> Fault:
    """Take word i, which stands for no event; clock and row are then those of the state."""
    word: Any = np.int64(words[i])
    state[S.T], state[S.Y], state[S.TAKEN] = t, y, n
    carried = state[S.SILENT_US]
    if word == 0xE000 | RATE_OUT:
        state[S.SILENT_US] = silent_us(words, start, i, state, high_before)
    fault = take_control_word(state, word >> 12, word & 0xFFF, gaps, edges)
    state[S.SILENT_US] = carried
    return fault


@njit(**JIT)
def run(  # noqa: PLR0915 - one loop that keeps its state in registers
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
    room = len(events[0]) - MARGIN if mode == Mode.STORE else 1 << 62
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
            _put(mode, events, image, n, t, y, address, p, is_event)
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
            fault, taken, here, on_here = _take_events(words, i, mode, state, t, y, n, events, image)
            if fault != Fault.NONE:
                break
            n += here
            on += on_here
            i += taken - 1
        else:
            fault = _take_control(words, start, i, state, t, y, n, gaps, edges, high_before)
            t, y = state[S.T], state[S.Y]
            repeated, begun = 0x8000 | state[S.HIGH], state[S.FIRST_T]
            if fault != Fault.NONE:
                break
        i += 1
    state[S.SILENT_US] = silent_us(words, start, i, state, high_before)
    state[S.T], state[S.Y], state[S.TAKEN] = t, y, n
    state[S.EVENTS] += n
    state[S.ON_EVENTS] += on
    state[S.FAULT] = fault
    return i
