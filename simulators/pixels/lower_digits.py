"""Digits of a reference beyond float32: its rounding error, at most 2^-24, as -63 to 63 steps in 7 bits."""

from __future__ import annotations

from math import floor
from typing import Any

import numpy as np
from numba import njit

from simulators.pixels.fast_math import INNER


@njit(forceinline=True, **INNER)
def lower_digits(u: float, u32: Any) -> Any:
    """Return the digits of u that its float32 value lacks, to be stored beside it: bits 1 to 7; bit 0 is free."""
    steps = floor((u / np.float64(u32) - 1.0) * (63.0 * 16777216.0) + 64.5)
    return np.uint8(np.int64(min(max(steps, 1.0), 127.0)) << 1)


@njit(forceinline=True, **INNER)
def join_digits(u32: Any, digits: Any) -> float:
    """Return a float32 reference with its digits from ``lower_digits``; 0 in bits 1 to 7 if none were stored."""
    steps = np.int64(digits >> np.uint8(1))
    return np.float64(u32) * (1.0 + ((steps - 64) / (63.0 * 16777216.0) if steps else 0.0))
