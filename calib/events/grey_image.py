"""Conversion of any image to 8 bits a pixel, for the tag detector and for display."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from calib.compiled import INNER, KERNEL
from calib.errors import InputMismatch

#: Share of the pixels that may be clipped at each end of the grey scale.
CLIPPED_SHARE = 0.005


def to_uint8(image: NDArray[np.generic]) -> NDArray[np.uint8]:
    """Stretch an image to 0..255 between its quantiles `CLIPPED_SHARE` and 1 - `CLIPPED_SHARE`.

    Own linear stretch: 255 (value - low) / (high - low), cut at 0 and 255.

    image: (H, W) of any integer or floating type; nan counts as the darkest value.
    Returns: (H, W) uint8; all 0 if the image is constant or holds no finite value.
    Raises InputMismatch: If the image does not have two axes, or is empty.

    Examples
    --------
    >>> to_uint8(np.array([[0.0, 1.0], [2.0, 4.0]])).tolist()
    [[0, 63], [127, 255]]
    """
    if image.ndim != 2 or image.size == 0:
        raise InputMismatch(
            f"The image has shape {image.shape}.", where="picture", remedy="Give one grey plane (H, W)."
        )
    values = np.ascontiguousarray(image, np.float32)
    sample = values if values.size < 4_000_000 else np.ascontiguousarray(values[::2, ::2])
    low, high = _clipped_ends(sample.ravel().view(np.uint32), CLIPPED_SHARE)
    if not high > low:
        return np.zeros(image.shape, np.uint8)
    return np.asarray(_stretched(values, low, 255.0 / (high - low)))


def _clipped_ends(keys: NDArray[np.uint32], share: float) -> tuple[float, float]:
    """Return the quantiles ``share`` and 1 - ``share`` of the finite values; if they are equal, the ends of the values.

    Quantiles: Hyndman and Fan (1996), definition 7, exact to the last bit. Both are 0 if no value is finite.

    keys: The bits of the values, float32.
    """
    counts = _count_upper_halves(keys).sum(axis=0, dtype=np.int64)
    n = int(counts.sum())
    if n == 0:
        return 0.0, 0.0
    low, high = _quantile(keys, counts, n, share), _quantile(keys, counts, n, 1.0 - share)
    if high <= low:
        ends = (_nth_and_next(keys, counts, place, n - 1).view(np.float32)[0] for place in (0, n - 1))
        return float(next(ends)), float(next(ends))
    return low, high


@njit(**KERNEL)
def _count_upper_halves(keys: Any) -> Any:
    """Count finite values by the upper 16 bits of `_ordered`: (4, 65536) int32, whose sum is the number.

    The tables are filled in turn, since neighbours often have the same value: a sum that has just been stored is
    slow to add to.
    """
    tables = np.zeros((4, 65536), np.int32)
    for i in range(keys.size):
        key = _ordered(keys[i])
        finite = keys[i] & np.uint32(0x7F800000) != np.uint32(0x7F800000)
        tables[i & 3, key >> np.uint32(16)] += finite
    return tables


def _quantile(keys: Any, counts: Any, n: int, share: float) -> float:
    """Return the value at a share of n values, interpolated as NumPy does (Hyndman and Fan, 1996)."""
    place = share * (n - 1)
    below = int(place)
    part = place - below
    one, other = _nth_and_next(keys, counts, below, n - 1).view(np.float32)
    apart = np.float64(other - one)
    return float(other - apart * (1.0 - part) if part >= 0.5 else one + apart * part)


@njit(**INNER)
def _ordered(key: Any) -> Any:
    """Return the bits of a float32 as a number that grows with its value (Terdiman, 2000)."""
    return ~key if key >> np.uint32(31) else key | np.uint32(0x80000000)


@njit(**INNER)
def _bits(key: Any) -> Any:
    """Return the bits of the float32 that `_ordered` turned into a number."""
    return key & np.uint32(0x7FFFFFFF) if key >> np.uint32(31) else ~key


@njit(**INNER)
def _only_value(keys: Any, upper: Any) -> Any:
    """Return the bits of the only value with some upper 16 bits; -1 if there are several, or none."""
    at = 0
    while at < keys.size and keys[at] >> np.uint32(16) != upper:
        at += 1
    if at == keys.size:
        return -1
    value, different = keys[at], np.uint32(0)
    for i in range(keys.size):  # without a branch, so that it runs over several pixels at once
        other = keys[i] ^ value
        different |= other if other < np.uint32(65536) else np.uint32(0)
    return -1 if different else np.int64(value)


@njit(**KERNEL)
def _nth_and_next(keys: Any, counts: Any, n: int, last: int) -> Any:
    """Return the bits of the n-th smallest value (n counts from 0) and of the next larger one, (2,) uint32.

    Radix selection in two steps of 16 bits (Knuth, 1998).

    ``counts`` are the numbers of finite values by their upper 16 bits. The largest value, number ``last``, has itself
    as the next one.
    """
    found = np.empty(2, np.uint32)
    lower = np.empty(65536, np.int64)
    seen = -1
    for k in range(2):
        upper, rest = 0, min(n + k, last)
        while rest >= counts[upper]:
            rest -= counts[upper]
            upper += 1
        if upper != seen:
            seen = upper
            lower[:] = 0
            only = _only_value(keys, _bits(np.uint32(upper << 16)) >> np.uint32(16))
            if only >= 0:  # an image of few values
                lower[_ordered(np.uint32(only)) & np.uint32(0xFFFF)] = counts[upper]
                found[k] = np.uint32(only)
                continue
            for i in range(keys.size):
                key = _ordered(keys[i])
                lower[key & np.uint32(0xFFFF)] += key >> np.uint32(16) == upper
        low = 0
        while rest >= lower[low]:
            rest -= lower[low]
            low += 1
        found[k] = _bits(np.uint32(upper << 16 | low))
    return found


@njit(**KERNEL)
def _stretched(values: Any, low: float, scale: float) -> Any:
    """Return 255 (value - low) / (high - low), cut at 0 and 255, as uint8; nan is 0."""
    result = np.empty(values.shape, np.uint8)
    for r in range(values.shape[0]):
        for c in range(values.shape[1]):
            grey = (np.float64(values[r, c]) - low) * scale
            result[r, c] = np.uint8(min(max(grey, 0.0), 255.0)) if grey > 0.0 else 0
    return result
