"""Stretches of EVT3 words that hold nothing but single events, rows and clock words, taken without a branch.

Sparse streams are made of little else, and the three follow each other in no predictable order: a processor that
guesses which comes next is wrong at every second event. So a stretch is first looked at as a whole, which
becomes vector instructions; then each of its words is kept or passed over by masks looked up by its type. (Masks
computed by comparing would be turned back into branches by the compiler.) Knows the word types; the stream's
state, and all other words, are ``evt3_kernel``'s.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any, Final

import numpy as np
from numba import njit

JIT: Final[dict[str, Any]] = {"cache": True, "nogil": True, "_nrt": False}
"""How the decoder's loops are compiled: arrays are not counted references (``_nrt``). The loops make none, and
counting them took most of the time of the rarer words."""


class Mode(IntEnum):
    """What becomes of an event."""

    TALLY = 0
    STORE = 1
    COUNT = 2


STRETCH: Final = 32
"""Words looked at together, and events that they may stand for."""
PACKED: Final = 1024
"""Events that wait to be counted together."""
SHORTEST_WAIT: Final = 8
"""Words after which the next stretch is tried: as many as the two reports of the rate controller have."""
LONGEST_WAIT: Final = 512
"""Words after which one is tried in any case, however often that was in vain."""

_TOLD: Final = np.zeros(16, np.uint32)
"""What a word of each type tells of row (lower half) and clock (upper half), both of which it stands in twice."""
_TOLD[0x0], _TOLD[0x6] = 0x7FF, 0xFFF << 16
_KEPT: Final = np.full(16, 0xFFFFFFFF, np.uint32)
"""What it leaves of them."""
_KEPT[0x0], _KEPT[0x6] = 0xFFFF0000, 0xFFFF
_TWICE: Final = np.uint32(0x10001)
_HALF: Final = np.uint32(16)
_ROW: Final = np.uint32(0xFFFF)
_X: Final = np.uint32(0x7FF)
_P: Final = np.uint32(11)


@njit(**JIT)
def ones(bits: int) -> int:
    """How many of 32 bits are set: sums of neighbours, of pairs, of fours, of bytes."""
    bits -= (bits >> 1) & 0x55555555
    bits = (bits & 0x33333333) + ((bits >> 2) & 0x33333333)
    bits = (bits + (bits >> 4)) & 0x0F0F0F0F
    return (bits * 0x01010101 >> 24) & 0xFF


@njit(**JIT)
def _plain_words(stretch: Any, repeated: int, width: int, height: int) -> tuple[int, int]:
    """How many of STRETCH words are plain before any other, and how many of these are ON events.

    Plain are single events and rows within the sensor, TIME_LOW, and the TIME_HIGH in force said again.
    """
    high, columns, rows = np.uint16(repeated), np.uint16(width), np.uint16(height)
    odd, on = np.uint32(0), np.uint32(0)
    for k in range(STRETCH):
        word = stretch[k]
        kind, address = np.uint16(word >> np.uint16(12)), np.uint16(word & np.uint16(0x7FF))
        event, row = (kind == np.uint16(2)) & (address < columns), (kind == np.uint16(0)) & (address < rows)
        fine = event | row | (kind == np.uint16(6)) | (word == high)
        bit = np.uint32(np.uint32(1) << np.uint32(k))
        odd |= np.uint32(0) if fine else bit
        on |= bit if np.uint16(word >> np.uint16(11)) == np.uint16(5) else np.uint32(0)
    before = np.uint32((odd & (~odd + np.uint32(1))) - np.uint32(1))  # the bits below the lowest set one
    return ones(np.int64(before)), ones(np.int64(on & before))


@njit(**JIT)
def _store(words: Any, t: int, y: int, t_out: Any, x_out: Any, y_out: Any, p_out: Any, first: int) -> Any:
    """Write the events of at most STRETCH plain words from place ``first`` on: as many places are touched.

    Returns whether the clock never steps back (bool), how many events, and the clock and the row after the words (int).
    """
    n = np.uint64(first)
    upper = t & -4096
    now, back = np.uint32((t & 0xFFF) << 16 | y), np.uint32(0)
    for k in range(len(words)):
        word = np.uint32(words[k])
        kind = word >> np.uint32(12)
        t_out[n] = upper | np.int64(now >> _HALF)
        x_out[n] = word & _X
        y_out[n] = now & _ROW
        p_out[n] = (word >> _P) & np.uint32(1)
        n += np.uint64(kind == np.uint32(2))
        later = np.uint32((now & _KEPT[kind]) | (word * _TWICE & _TOLD[kind]))
        back |= np.uint32((later | _ROW) - now)
        now = later
    return np.int32(back) >= 0, np.int64(n) - first, upper | np.int64(now >> _HALF), np.int64(now & _ROW)


@njit(**JIT)
def _pack(words: Any, t: int, y: int, packed: Any, first: int) -> Any:
    """Write the events of at most STRETCH plain words to ``packed``: a word each, row before column; no times.

    Places and results are as of ``_store``.
    """
    n = np.uint64(first)
    now, back = np.uint32((t & 0xFFF) << 16 | y), np.uint32(0)
    for k in range(len(words)):
        word = np.uint32(words[k])
        kind = word >> np.uint32(12)
        packed[n] = np.uint32(now << _HALF) | word
        n += np.uint64(kind == np.uint32(2))
        later = np.uint32((now & _KEPT[kind]) | (word * _TWICE & _TOLD[kind]))
        back |= np.uint32((later | _ROW) - now)
        now = later
    return (
        np.int32(back) >= 0,
        np.int64(n) - first,
        (t & -4096) | np.int64(now >> _HALF),
        np.int64(now & _ROW),
    )


@njit(**JIT)
def _count(image: Any, packed: Any, n: int) -> None:
    """Add n packed events to the image."""
    for k in range(n):
        event = packed[k]
        image[(event >> _P) & np.uint32(1), event >> _HALF, event & _X] += 1


@njit(**JIT)
def take_plain(
    words: Any,
    start: int,
    mode: int,
    limits: Any,
    t: int,
    y: int,
    n: int,
    events: Any,
    image: Any,
    packed: Any,
) -> tuple[int, int, int, int, int]:
    """Take plain words from ``start`` on, until another comes, the clock steps back, or few are left.

    Parameters
    ----------
    words, start, mode, events, image
        As ``evt3_kernel.run`` has them.
    limits
        The TIME_HIGH in force as a word, columns, rows, and the last place from which MARGIN events may be stored.
    t, y, n
        Clock and row in force (there must be both), and the next place in ``events``.
    packed
        (PACKED,) uint32, scratch.

    Returns
    -------
    Where it stopped, how many events that was, how many of them ON, and the clock and the row there.
    """
    repeated, width, height, room = limits
    t_out, x_out, y_out, p_out = events
    i, found, on, waiting = start, 0, 0, 0
    while (n + found <= room) & (i + STRETCH <= len(words)):
        size, on_here = _plain_words(words[i : i + STRETCH], repeated, width, height)
        part = words[i : i + size]
        if mode == Mode.STORE:
            onward, here, t_here, y_here = _store(part, t, y, t_out, x_out, y_out, p_out, n + found)
        else:
            if waiting > PACKED - STRETCH:
                _count(image, packed, waiting)
                waiting = 0
            onward, here, t_here, y_here = _pack(part, t, y, packed, waiting)
        if not onward:
            break
        if mode == Mode.COUNT:
            waiting += here
        i, found, on, t, y = i + size, found + here, on + on_here, t_here, y_here
        if size < STRETCH:
            break
    _count(image, packed, waiting)
    return i, found, on, t, y


@njit(**JIT)
def add_events(x: Any, y: Any, p: Any, image: Any) -> bool:
    """Add events to an image (2, height, width), unless one lies outside it; return whether they were added."""
    polarities, height, width = image.shape
    outside = False
    for k in range(len(x)):
        outside |= (x[k] >= width) | (y[k] >= height) | (p[k] >= polarities)
    if outside:
        return False
    for k in range(len(x)):
        image[p[k], y[k], x[k]] += 1
    return True
