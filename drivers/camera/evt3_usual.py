"""Decode the usual EVT3 words: runs of single events, mixtures with rows and clock words, and triples of vectors.

Nearly all words of a stream are of these types. Their order cannot be predicted, so a loop that looks at one word
after the other loses most of its time at branches. Here 32 words are sorted by type at once, one bit a word, and the
loop goes from event to event. Runs of single events are copied together; their time and row are written when these
change. Three vectors in a row, as sensors send them, are taken at once, and their columns by a table of bytes. All
other words, and every word that is not as expected, are left to ``evt3_kernel``.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any, Final

import numpy as np
from numba import njit

from drivers.camera.word_vectors import (
    BLOCK_WORDS,
    COMPRESSES,
    JIT,
    copy_single_events,
    count_ones,
    four_words,
    highest_place,
    lowest_place,
    word_masks,
    write_columns,
    write_in_force,
    write_singles,
)


class Mode(IntEnum):
    """What is done with an event.

    TALLY: It is counted for the statistics only.
    COUNT: It is added to an image.
    """

    TALLY = 0
    STORE = 1
    COUNT = 2


LONG_RUN: Final = 6
"""Number of single events in a row from which on they are copied together."""

_ALL: Final = np.uint64(0xFFFFFFFF)
_ONE: Final = np.uint64(1)
_ADDRESS: Final = np.uint64(0x7FF)
_P: Final = np.uint64(11)
_TYPES: Final = np.uint64(0xF000F000F000)
_TRIPLE: Final = np.uint64(0x500040004000)
"""The types of VECT_12, VECT_12 and VECT_8 in four words."""


@njit(**JIT, forceinline=True)
def _fill(events: Any, begin: Any, end: Any, t: int, y: int) -> None:
    """Write time and row of the events from ``begin`` to ``end``."""
    t_out, _, y_out, _ = events
    for k in range(begin, end):
        t_out[k] = t
    for k in range(begin, end):
        y_out[k] = y


@njit(**JIT, forceinline=True)
def _take_mixed(
    words: Any, i: Any, mode: int, found: Any, t: int, y: int, n: Any, events: Any, image: Any, scratch: Any
) -> None:
    """Take the single events at the bits of ``found``, each with the row and the TIME_LOW in force before it."""
    t_out, x_out, y_out, p_out = events
    rows, lows = scratch
    if COMPRESSES and mode == Mode.STORE:
        write_singles(words, i, found, t, y, t_out, x_out, y_out, p_out, n)
        return
    write_in_force(words, i, y, t & 0xFFF, rows, lows)
    upper = t & -4096
    while found:
        k = lowest_place(found)
        word = np.uint64(words[i + k])
        x, p = word & _ADDRESS, (word >> _P) & _ONE
        if mode == Mode.STORE:
            t_out[n] = upper | np.int64(lows[k])
            x_out[n] = x
            y_out[n] = rows[k]
            p_out[n] = p
            n += _ONE
        else:
            image[p, np.uint64(rows[k]), x] += 1
        found &= found - _ONE


@njit(**JIT, forceinline=True)
def _in_force(words: Any, i: Any, rows: Any, lows: Any, t: Any, y: Any) -> Any:
    """Return clock and row after words from i on, with the bits of their rows and TIME_LOW words."""
    if lows:
        t = t & -4096 | np.int64(words[i + highest_place(lows)]) & 0xFFF
    if rows:
        y = np.int64(words[i + highest_place(rows)]) & 0x7FF
    return t, y


@njit(**JIT, forceinline=True)
def _take_run(words: Any, i: Any, mode: int, size: Any, y: int, n: Any, events: Any, image: Any) -> None:
    """Take ``size`` single events in a row; 32 places of the arrays are touched."""
    if mode == Mode.STORE:
        copy_single_events(words, i, events[1], events[3], n)
    elif mode == Mode.COUNT:
        for k in range(size):
            word = np.uint64(words[i + k])
            image[(word >> _P) & _ONE, np.uint64(y), word & _ADDRESS] += 1


@njit(**JIT, forceinline=True)
def _take_bits(mode: int, y: int, x: int, p: int, bits: Any, n: Any, events: Any, image: Any) -> None:
    """Take the events of up to 32 columns, a bit each; 32 places of the arrays are touched."""
    _, x_out, _, p_out = events
    if mode == Mode.STORE:
        write_columns(x_out, n, x, bits)
        for k in range(32):
            p_out[n + np.uint64(k)] = p
    elif mode == Mode.COUNT:
        row = image[p, y, x : x + 32]
        for k in range(32):
            row[k] += (bits >> np.uint64(k)) & _ONE


@njit(**JIT, forceinline=True)
def _take_vectors(
    words: Any,
    i: Any,
    mode: int,
    width: int,
    y: int,
    x: int,
    p: int,
    n: Any,
    room: Any,
    events: Any,
    image: Any,
) -> tuple[Any, int, Any]:
    """Take vectors that follow each other; return the next word, the next column, and the next event."""
    while (i + np.uint64(4) <= np.uint64(len(words))) & (n <= room) & (x >= 0) & (x + 32 <= width):
        four = four_words(words, i)
        if four & _TYPES == _TRIPLE:
            upper = (four >> np.uint64(4)) & np.uint64(0xFFF000) | (four >> np.uint64(8)) & np.uint64(
                0xFF000000
            )
            bits = four & np.uint64(0xFFF) | upper
            _take_bits(mode, y, x, p, bits, n, events, image)
            i, x, n = i + np.uint64(3), x + 32, n + count_ones(bits)
            continue
        kind = words[i] >> 12
        if kind not in (0x4, 0x5):
            break
        bits = four & np.uint64(0xFFF if kind == 0x4 else 0xFF)
        _take_bits(mode, y, x, p, bits, n, events, image)
        i, x, n = i + _ONE, x + (12 if kind == 0x4 else 8), n + count_ones(bits)
    return i, x, n


@njit(**JIT, forceinline=True)
def _take_plain_blocks(
    words: Any,
    i: Any,
    mode: int,
    limits: Any,
    t: Any,
    y: Any,
    n: Any,
    on: Any,
    events: Any,
    image: Any,
    scratch: Any,
) -> Any:
    """Take blocks while all their words are plain, without long runs; return next word, next event, ON events, t and y.

    The next block does not depend on what this one holds, so that the processor works on several at once.
    """
    repeated, width, height, most = limits
    while (i + np.uint64(BLOCK_WORDS) <= np.uint64(len(words))) & (n <= np.uint64(most)):
        singles, rows, lows, on_singles, plain = word_masks(words, i, width, height, repeated, t & 0xFFF)
        run = lowest_place(~(singles >> (lowest_place(singles) & np.uint64(63))))
        if (plain != _ALL) | (run >= np.uint64(LONG_RUN)):
            break
        if mode != Mode.TALLY:
            _take_mixed(words, i, mode, singles, t, y, n, events, image, scratch)
        n += count_ones(singles)
        on += count_ones(on_singles)
        t, y = _in_force(words, i, rows, lows, t, y)
        i += np.uint64(BLOCK_WORDS)
    return i, n, on, t, y


@njit(**JIT)
def take_usual_words(
    words: Any,
    start: int,
    mode: int,
    limits: Any,
    place: Any,
    first: int,
    events: Any,
    image: Any,
    scratch: Any,
) -> tuple[int, int, int, int, int, int, int]:
    """Take usual words from ``start`` on, until another word comes, the clock steps back, or few words are left.

    words: (N,) uint16, EVT3 words.
    start: Index of the first word to take.
    mode: A ``Mode``.
    limits: The TIME_HIGH in force as a word, columns and rows (px), and the last index in ``events`` that
      leaves room for MARGIN events.
    place: Clock (us), row (px), column of the next vector (px, -1 if unknown) and polarity of vectors in
      force; clock and row must be known.
    first: Next index in ``events``.
    events: ``Events`` of arrays to fill.
    image: (2, height, width) of any integer type, to add counts to.
    scratch: Two arrays, (BLOCK_WORDS,) uint16.
    Returns: Index of the first word not taken, number of events, number of ON events; and what is then in
      force: clock (us), row (px), column of the next vector (px) and polarity of vectors.
    """
    repeated, width, height, most = limits
    t, y, base, polarity = place
    i, room, on = np.uint64(start), np.uint64(most), np.uint64(0)
    n = filled = np.uint64(first)
    while (i + np.uint64(BLOCK_WORDS) <= np.uint64(len(words))) & (n <= room):
        began = i
        singles, rows, lows, on_singles, plain = word_masks(words, i, width, height, repeated, t & 0xFFF)
        size, next_single = lowest_place(~plain), lowest_place(singles)
        run = lowest_place(~(singles >> (next_single & np.uint64(63))))
        copied = (run >= np.uint64(LONG_RUN)) | (next_single + run == size)
        if copied:
            size = min(size, next_single)
        if size:
            taken = (_ONE << size) - _ONE
            found, rows, lows = singles & taken, rows & taken, lows & taken
            if mode == Mode.STORE:
                _fill(events, filled, n, t, y)
            if found and mode != Mode.TALLY:
                _take_mixed(words, i, mode, found, t, y, n, events, image, scratch)
            n += count_ones(found)
            on += count_ones(on_singles & found)
            t, y = _in_force(words, i, rows, lows, t, y)
            i += size
            if size == np.uint64(BLOCK_WORDS):
                i, n, on, t, y = _take_plain_blocks(
                    words, i, mode, limits, t, y, n, on, events, image, scratch
                )
            filled = n
        if copied & (i - began == next_single) & (n <= room):
            _take_run(words, i, mode, run, y, n, events, image)
            n += run
            on += count_ones(on_singles & (((_ONE << run) - _ONE) << next_single))
            i += run
        if i < np.uint64(len(words)):
            if words[i] >> 12 == 0x3:
                base, polarity = words[i] & 0x7FF, (words[i] >> 11) & 1
                i += _ONE
            before = n
            i, base, n = _take_vectors(words, i, mode, width, y, base, polarity, n, room, events, image)
            on += (n - before) * np.uint64(polarity)
        if i == began:
            break
    if mode == Mode.STORE:
        _fill(events, filled, n, t, y)
    result: Any = np.int64(i), np.int64(n) - first, np.int64(on), t, y, base, polarity
    return result
