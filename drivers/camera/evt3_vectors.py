"""Read, store and count the EVT3 words that hold events: single events and vectors. Compiled.

``evt3_kernel`` lists the words.

References
----------
Leiserson, Prokop and Randall (1998), "Using de Bruijn sequences to index a 1 in a computer word": the place of the
lowest set bit.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numba import njit

from drivers.camera.evt3_state import S, StopReason
from drivers.camera.word_vectors import JIT

MARGIN: Final = 32
"""Room that output arrays need for three vectors in a row, events."""
_DE_BRUIJN: Final = 0x077CB531
"""A de Bruijn sequence: shifted left by k and cut to 32 bits, its upper five bits differ for every k."""
_PLACE: Final = np.array(
    [k for _, k in sorted(((_DE_BRUIJN << k) >> 27 & 31, k) for k in range(32))], np.uint8
)
"""The k that belongs to those five bits."""


@njit(**JIT)
def popcount(bits: int) -> int:
    """Count the set bits of a 32-bit number: sums of neighbours, of pairs, of fours, of bytes.

    bits: The number, 0 to 2^32 - 1.

    References
    ----------
    Warren (2013), "Hacker's Delight", 2nd edition, chapter 5.
    """
    bits -= (bits >> 1) & 0x55555555
    bits = (bits & 0x33333333) + ((bits >> 2) & 0x33333333)
    bits = (bits + (bits >> 4)) & 0x0F0F0F0F
    return (bits * 0x01010101 >> 24) & 0xFF


@njit(**JIT)
def read_event_word(state: Any, word: int, second: int, third: int) -> tuple[StopReason, int, int, int, int]:
    """Read a single event or a vector.

    Sensors send vectors as triples of 12 + 12 + 8 columns. A triple is taken at once, with the two words that follow.
    (Words are passed as numbers: references to an array would be counted.)

    state: (30,) int64 as of ``new_state``; the vector base moves on.
    second, third: The two words that follow it; 0 if there are none.
    Returns: Stop reason, number of words taken, first column (px), polarity, and one bit a column from there.
    """
    kind = word >> 12
    if kind == 0x2:
        x = word & 0x7FF
        return StopReason.COLUMN if x >= state[S.WIDTH] else StopReason.NONE, 1, x, (word >> 11) & 1, 1
    x = state[S.BASE]
    room = state[S.WIDTH] - x
    if (kind == 0x4) & (second >> 12 == 0x4) & (third >> 12 == 0x5) & (room >= 32):
        taken, columns = 3, 32
        bits = (word & 0xFFF) | (second & 0xFFF) << 12 | (third & 0xFF) << 24
    else:
        taken, columns = 1, 12 if kind == 0x4 else 8
        bits = word & ((1 << columns) - 1)
        if room < columns and bits >> max(room, 0):
            return StopReason.VECTOR, taken, x, 0, 0
    if x >= 0:
        state[S.BASE] = x + columns
    return StopReason.NONE, taken, x, state[S.POLARITY], bits


@njit(**JIT)
def store_bits(events: Any, n: int, t: int, y: int, x: int, p: int, bits: int) -> None:
    """Write one event for each bit set, lowest first.

    events: ``Events`` of arrays to fill.
    n: Index of the first event to write.
    t: Time of the events, us.
    y: Row, px.
    x: Column of the lowest bit, px.
    bits: One bit a column, 32 at most.
    """
    t_out, x_out, y_out, p_out = events
    while bits:
        t_out[n] = t
        x_out[n] = x + _PLACE[((bits & -bits) * _DE_BRUIJN >> 27) & 31]
        y_out[n] = y
        p_out[n] = p
        n += 1
        bits &= bits - 1


@njit(**JIT)
def count_bits(image: Any, y: int, x: int, p: int, bits: int) -> None:
    """Add one event for each bit set to an image; all 32 columns at once if the image has as many.

    image: (2, height, width) of any integer type.
    y: Row, px.
    x: Column of the lowest bit, px.
    p: Polarity: the first index of the image.
    bits: One bit a column, 32 at most.
    """
    if x + 32 <= image.shape[2]:
        row = image[p, y, x : x + 32]
        for k in range(32):
            row[k] += (bits >> k) & 1
    else:
        while bits:
            image[p, y, x + _PLACE[((bits & -bits) * _DE_BRUIJN >> 27) & 31]] += 1
            bits &= bits - 1


@njit(**JIT)
def add_events(x: Any, y: Any, p: Any, image: Any) -> bool:
    """Add events to an image of counts, unless one lies outside it.

    x, y: (N,) uint16, px: columns and rows.
    p: (N,) uint8: polarities.
    image: (2, height, width) of any integer type.
    Returns: True if the events were added; False if one lies outside the image, which is then unchanged.
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
