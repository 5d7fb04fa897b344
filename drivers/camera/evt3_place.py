"""What an EVT3 word depends on: the place in the stream, and a guess of it from the words just before.

With a guess, a block in the middle of a stream can be decoded before the blocks before it are. The guess is right for
every stream that a sensor sends; who uses it compares it with the place that the decoder then reaches.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from drivers.camera.evt3_state import S
from drivers.camera.word_vectors import JIT

TAIL_WORDS: Final = 4096
"""Number of words before a place in which nearly everything is found."""

_WRAP_US: Final = 1 << 24
_PLACE: Final = [S.HIGH, S.WRAPS_US, S.T, S.Y, S.BASE, S.POLARITY]
"""Where a decoder's state holds the first fields of a place."""


class Place(NamedTuple):
    """The clock, row and vector base in force between two words."""

    high: int  # Last TIME_HIGH; -1 before the first
    wraps_us: int  # Full turns of the 24-bit clock, us
    t: int  # Clock, us, unwrapped; -1 before the first TIME_HIGH
    y: int  # Row, px; -1 before the first, and in rows of other events
    base: int  # Column of the next vector, px; -1 before the first vector base
    polarity: int
    begun: bool  # Whether there has been a TIME_LOW after a TIME_HIGH


def place_of(state: NDArray[np.int64]) -> Place:
    """Return the place that a decoder's state holds.

    state: (30,) int64 as of ``new_state``.
    """
    high, wraps_us, t, y, base, polarity = (int(number) for number in state[_PLACE])
    return Place(high, wraps_us, t, y, base, polarity, begun=bool(state[S.FIRST_T] >= 0))


def set_place(state: NDArray[np.int64], place: Place) -> None:
    """Put a decoder's state to a place. Its counts are not changed.

    state: (30,) int64 as of ``new_state``; changed.
    """
    state[_PLACE] = place[:6]
    state[S.FIRST_T] = place.t if place.begun else -1


def guess_place(words: NDArray[np.uint16], before: Place) -> Place | None:
    """Guess the place after a block of words.

    words: (N,) uint16, EVT3 words.
    before: The place before them.
    Returns: The place, if the clock wraps no more than once in the block; None if the words do not tell it.
    """
    high, low, y, base, polarity = (int(number) for number in _last_in_force(words[-TAIL_WORDS:]))
    if base < 0:
        if _has_vectors(words):
            high, low, y, base, polarity = (int(number) for number in _last_in_force(words))
        else:
            base, polarity = before.base, before.polarity
    if min(high, low, y) < 0:
        return None
    wraps_us = before.wraps_us + (_WRAP_US if high < before.high else 0)
    return Place(high, wraps_us, wraps_us + (high << 12) + low, y, base, polarity, begun=True)


@njit(**JIT)
def _has_vectors(words: Any) -> Any:
    """Return whether any word is a vector or the base of one."""
    found: Any = False
    for k in range(len(words)):
        found |= np.uint16(np.uint16(words[k] >> np.uint16(12)) - np.uint16(3)) < np.uint16(3)
    return found


@njit(**JIT)
def _last_in_force(words: Any) -> tuple[int, int, int, int, int]:
    """Return TIME_HIGH, TIME_LOW, row, next column and polarity of vectors after words; -1: the words do not tell."""
    high = low = earlier_low = y = base = -1
    polarity = moved = 0
    for i in range(len(words) - 1, -1, -1):
        word: Any = np.int64(words[i])
        kind, payload = word >> 12, word & 0xFFF
        if kind == 0x8 and high < 0:
            high = payload
        elif kind == 0x8 and low < 0 and (payload != high or earlier_low >= 0):
            low = earlier_low if payload == high else 0  # a new TIME_HIGH sets TIME_LOW to zero
        elif kind == 0x6 and low < 0 and earlier_low < 0:
            low, earlier_low = (payload if high < 0 else -1), payload
        elif kind == 0x0 and y < 0:
            y = payload & 0x7FF
        elif kind == 0x1 and y < 0:
            break
        elif kind == 0x3 and base < 0:
            base, polarity = (payload & 0x7FF) + moved, payload >> 11
        elif kind in (0x4, 0x5):
            moved += 12 if kind == 0x4 else 8
        if min(high, low, y, base) >= 0:
            break
    return high, low, y, base, polarity
