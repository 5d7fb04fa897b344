"""EVT3 words that stand for events, compiled: single ones and vectors, read, stored and counted.

Knows no clock, no files and no devices; ``evt3_kernel`` says which words there are.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numba import njit

from drivers.camera.evt3_plain import JIT
from drivers.camera.evt3_state import Fault, S

MARGIN: Final = 32
"""Events that three vectors in a row can hold: room that output arrays need to take them."""
_DE_BRUIJN: Final = 0x077CB531
"""Shifted left by k and cut to 32 bits, its upper five bits differ for every k."""
_PLACE: Final = np.array(
    [k for _, k in sorted(((_DE_BRUIJN << k) >> 27 & 31, k) for k in range(32))], np.uint8
)
"""The k of those five bits."""


@njit(**JIT)
def events_of(state: Any, word: int, second: int, third: int) -> tuple[Fault, int, int, int, int]:
    """Read a single event or a vector: fault, words taken, first column, polarity, one bit a column from there.

    Sensors send vectors as triples of 12 + 12 + 8 columns: these are taken at once, with the two words that
    follow. (They are passed as numbers: an array would have its references counted.)
    """
    kind = word >> 12
    if kind == 0x2:
        x = word & 0x7FF
        return Fault.COLUMN if x >= state[S.WIDTH] else Fault.NONE, 1, x, (word >> 11) & 1, 1
    x = state[S.BASE]
    room = state[S.WIDTH] - x
    if (kind == 0x4) & (second >> 12 == 0x4) & (third >> 12 == 0x5) & (room >= 32):
        taken, columns = 3, 32
        bits = (word & 0xFFF) | (second & 0xFFF) << 12 | (third & 0xFF) << 24
    else:
        taken, columns = 1, 12 if kind == 0x4 else 8
        bits = word & ((1 << columns) - 1)
        if room < columns and bits >> max(room, 0):
            return Fault.VECTOR, taken, x, 0, 0
    if x >= 0:
        state[S.BASE] = x + columns
    return Fault.NONE, taken, x, state[S.POLARITY], bits


@njit(**JIT)
def store(events: Any, n: int, t: int, y: int, x: int, p: int, bits: int) -> None:
    """Write the events of the bits set, lowest first, from place n on."""
    t_out, x_out, y_out, p_out = events
    while bits:
        t_out[n] = t
        x_out[n] = x + _PLACE[((bits & -bits) * _DE_BRUIJN >> 27) & 31]
        y_out[n] = y
        p_out[n] = p
        n += 1
        bits &= bits - 1


@njit(**JIT)
def count(image: Any, y: int, x: int, p: int, bits: int) -> None:
    """Add the events of the bits set to the image; all columns at once where there are as many."""
    if x + 32 <= image.shape[2]:
        row = image[p, y, x : x + 32]
        for k in range(32):
            row[k] += (bits >> k) & 1
    else:
        while bits:
            image[p, y, x + _PLACE[((bits & -bits) * _DE_BRUIJN >> 27) & 31]] += 1
            bits &= bits - 1
