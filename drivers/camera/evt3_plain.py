"""Decode runs of EVT3 words that hold only single events, rows and clock words ("plain words"), without branches.

Sparse streams consist of little else, and the three follow each other in no predictable order: branch prediction
fails at every second event. So a block of words is first checked as a whole, which compiles to vector instructions.
Then each word is kept or skipped by masks that are looked up by its type. (The compiler would turn masks computed by
comparisons back into branches.) ``evt3_kernel`` holds the stream's state and takes all other words.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any, Final

import numpy as np
from numba import njit

JIT: Final[dict[str, Any]] = {"cache": True, "nogil": True, "_nrt": False}
"""How the decoder's loops are compiled: without reference counts of arrays (``_nrt``). The loops allocate no arrays,
and counting references took most of the time of the rarer words.
"""


class Mode(IntEnum):
    """What is done with an event.

    Attributes
    ----------
    TALLY
        It is counted for the statistics only.
    STORE
        It is written to arrays.
    COUNT
        It is added to an image.
    """

    TALLY = 0
    STORE = 1
    COUNT = 2


BLOCK_WORDS: Final = 32
"""Number of words checked together, and the largest number of events that they hold."""
PACKED_EVENTS: Final = 1024
"""Number of events that are gathered before they are added to the image."""
MIN_WAIT_WORDS: Final = 8
"""Number of words after which the next run is tried: the length of the rate controller's two reports."""
MAX_WAIT_WORDS: Final = 512
"""Number of words after which a run is tried in any case, however often that failed."""

_SET_BITS: Final = np.zeros(16, np.uint32)
"""The bits of row (lower half) and clock (upper half) that a word of each type sets; the word stands in both halves."""
_SET_BITS[0x0], _SET_BITS[0x6] = 0x7FF, 0xFFF << 16
_KEPT_BITS: Final = np.full(16, 0xFFFFFFFF, np.uint32)
"""The bits of row and clock that a word of each type leaves as they are."""
_KEPT_BITS[0x0], _KEPT_BITS[0x6] = 0xFFFF0000, 0xFFFF
_BOTH_HALVES: Final = np.uint32(0x10001)
_HALF: Final = np.uint32(16)
_ROW: Final = np.uint32(0xFFFF)
_X: Final = np.uint32(0x7FF)
_P: Final = np.uint32(11)


@njit(**JIT)
def popcount(bits: int) -> int:
    """Count the set bits of a 32-bit number: sums of neighbours, of pairs, of fours, of bytes.

    Parameters
    ----------
    bits
        The number, 0 to 2^32 - 1.

    Returns
    -------
    int
        Number of bits that are set.

    References
    ----------
    Warren (2013), "Hacker's Delight", 2nd edition, chapter 5.
    """
    bits -= (bits >> 1) & 0x55555555
    bits = (bits & 0x33333333) + ((bits >> 2) & 0x33333333)
    bits = (bits + (bits >> 4)) & 0x0F0F0F0F
    return (bits * 0x01010101 >> 24) & 0xFF


@njit(**JIT)
def _count_plain_words(block: Any, repeated: int, width: int, height: int) -> tuple[int, int]:
    """Return how many words of a block are plain before any other word, and how many of these are ON events.

    Plain are single events and rows within the sensor, TIME_LOW, and a repetition of the TIME_HIGH in force.
    """
    high, columns, rows = np.uint16(repeated), np.uint16(width), np.uint16(height)
    other, on = np.uint32(0), np.uint32(0)
    for k in range(BLOCK_WORDS):
        word = block[k]
        kind, address = np.uint16(word >> np.uint16(12)), np.uint16(word & np.uint16(0x7FF))
        event, row = (kind == np.uint16(2)) & (address < columns), (kind == np.uint16(0)) & (address < rows)
        plain = event | row | (kind == np.uint16(6)) | (word == high)
        bit = np.uint32(np.uint32(1) << np.uint32(k))
        other |= np.uint32(0) if plain else bit
        on |= bit if np.uint16(word >> np.uint16(11)) == np.uint16(5) else np.uint32(0)
    before = np.uint32((other & (~other + np.uint32(1))) - np.uint32(1))  # the bits below the lowest set one
    return popcount(np.int64(before)), popcount(np.int64(on & before))


@njit(**JIT)
def _store(words: Any, t: int, y: int, t_out: Any, x_out: Any, y_out: Any, p_out: Any, first: int) -> Any:
    """Write the events of at most BLOCK_WORDS plain words from index ``first`` on; as many places are touched.

    Return whether the clock never steps back (bool), the number of events, and clock and row after the words (int).
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
        following = np.uint32((now & _KEPT_BITS[kind]) | (word * _BOTH_HALVES & _SET_BITS[kind]))
        back |= np.uint32((following | _ROW) - now)
        now = following
    return np.int32(back) >= 0, np.int64(n) - first, upper | np.int64(now >> _HALF), np.int64(now & _ROW)


@njit(**JIT)
def _pack(words: Any, t: int, y: int, packed: Any, first: int) -> Any:
    """Write the events of at most BLOCK_WORDS plain words to ``packed``, without times.

    Each event is one number, row before column. Places and results are those of ``_store``.
    """
    n = np.uint64(first)
    now, back = np.uint32((t & 0xFFF) << 16 | y), np.uint32(0)
    for k in range(len(words)):
        word = np.uint32(words[k])
        kind = word >> np.uint32(12)
        packed[n] = np.uint32(now << _HALF) | word
        n += np.uint64(kind == np.uint32(2))
        following = np.uint32((now & _KEPT_BITS[kind]) | (word * _BOTH_HALVES & _SET_BITS[kind]))
        back |= np.uint32((following | _ROW) - now)
        now = following
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
def decode_plain_words(
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
    """Take plain words from ``start`` on, until another word comes, the clock steps back, or few words are left.

    Parameters
    ----------
    words
        (N,) uint16, EVT3 words.
    start
        Index of the first word to take.
    mode
        A ``Mode``.
    limits
        The TIME_HIGH in force as a word, columns and rows (px), and the last index in ``events`` that leaves room for
        MARGIN events.
    t, y
        Clock (us) and row (px) in force; both must be known.
    n
        Next index in ``events``.
    events
        ``Events`` of arrays to fill.
    image
        (2, height, width) of any integer type, to add counts to.
    packed
        (PACKED_EVENTS,) uint32, scratch.

    Returns
    -------
    tuple of int
        Index of the first word not taken, number of events, number of ON events, clock (us) and row (px) there.
    """
    repeated, width, height, room = limits
    t_out, x_out, y_out, p_out = events
    i, found, on, gathered = start, 0, 0, 0
    while (n + found <= room) & (i + BLOCK_WORDS <= len(words)):
        size, on_here = _count_plain_words(words[i : i + BLOCK_WORDS], repeated, width, height)
        part = words[i : i + size]
        if mode == Mode.STORE:
            forward, here, t_here, y_here = _store(part, t, y, t_out, x_out, y_out, p_out, n + found)
        else:
            if gathered > PACKED_EVENTS - BLOCK_WORDS:
                _count(image, packed, gathered)
                gathered = 0
            forward, here, t_here, y_here = _pack(part, t, y, packed, gathered)
        if not forward:
            break
        if mode == Mode.COUNT:
            gathered += here
        i, found, on, t, y = i + size, found + here, on + on_here, t_here, y_here
        if size < BLOCK_WORDS:
            break
    _count(image, packed, gathered)
    return i, found, on, t, y


@njit(**JIT)
def add_events(x: Any, y: Any, p: Any, image: Any) -> bool:
    """Add events to an image of counts, unless one lies outside it.

    Parameters
    ----------
    x, y
        (N,) uint16, px: columns and rows.
    p
        (N,) uint8: polarities.
    image
        (2, height, width) of any integer type.

    Returns
    -------
    bool
        True if the events were added; False if one lies outside the image, which is then unchanged.
    """
    polarities, height, width = image.shape
    outside = False
    for k in range(len(x)):
        outside |= (x[k] >= width) | (y[k] >= height) | (p[k] >= polarities)
    if outside:
        return False
    for k in range(len(x)):
        image[p[k], y[k], x[k]] += 1
    return True
