"""Random events and random errors of the pixels: background and hot-pixel events, and the noise of a reset.

Compiled functions. Random numbers come from a counter that is hashed (SplitMix64; Steele, Lea and Flood 2014), so that
a whole batch can be drawn at once. This module uses rates and seeds; it does not process the events.

A generator is a (2,) uint64 array: its KEY and its COUNTER.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulators.compiled import LOOP
from simulators.pixels.fast_math import INNER, INNER_KERNEL, log32

# Indices into a generator.
KEY: Final = 0  # its seed
COUNTER: Final = 1  # how many numbers it has drawn

_GOLDEN: Final = np.uint64(0x9E3779B97F4A7C15)  # As the next two, of SplitMix64 (Steele, Lea and Flood 2014)
_MIX_1: Final = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2: Final = np.uint64(0x94D049BB133111EB)
_LOW_32: Final = np.uint64(0xFFFFFFFF)
_TO_UNIT: Final = np.float32(2.0**-23)  # With half of the last bit added, 23 bits are a float32 in (0, 1)
_HALF_UNIT: Final = np.float32(2.0**-24)


@njit(forceinline=True, **INNER)
def _bits(key: Any, count: Any) -> Any:
    """Return 64 random bits: number ``count`` of the generator (SplitMix64)."""
    z = key + count * _GOLDEN
    z = (z ^ (z >> np.uint64(30))) * _MIX_1
    z = (z ^ (z >> np.uint64(27))) * _MIX_2
    return z ^ (z >> np.uint64(31))


@njit(forceinline=True, **INNER)
def _next_bits(random: NDArray[np.uint64]) -> Any:
    """Return the next 64 random bits."""
    random[COUNTER] += np.uint64(1)
    return _bits(random[KEY], random[COUNTER])


@njit(forceinline=True, **INNER)
def uniform(random: NDArray[np.uint64]) -> float:
    """Return the next random number, uniform in (0, 1)."""
    return (np.int64(_next_bits(random) >> np.uint64(11)) + 0.5) * (1.0 / 9007199254740992.0)


@njit(forceinline=True, **INNER)
def reset_error(normals: NDArray[np.float32], spread: float, random: NDArray[np.uint64]) -> Any:
    """Return the next random factor on u of a new reference: the noise of a reset in log intensity, to first order."""
    if spread == 0.0:
        return np.float32(1.0)
    return np.float32(1.0) + np.float32(spread) * normals[_next_bits(random) >> np.uint64(52)]


@njit(**INNER_KERNEL)
def reset_errors(
    normals: NDArray[np.float32],
    spread: float,
    random: NDArray[np.uint64],
    values: NDArray[np.float32],
    n: int,
) -> None:
    """Multiply the first n of (N,) float32 values, in place, by the next factors of ``reset_error``."""
    if spread == 0.0:
        return
    spread32 = np.float32(spread)
    key, count = random[KEY], random[COUNTER]
    for k in range(n):
        bits = _bits(key, count + np.uint64(1) + np.uint64(k))
        values[k] *= np.float32(1.0) + spread32 * normals[bits >> np.uint64(52)]
    random[COUNTER] = count + np.uint64(n)


@njit(forceinline=True, **INNER)
def earlier_reset_error(
    normals: NDArray[np.float32], spread: float, random: NDArray[np.uint64], back: int
) -> Any:
    """Return a factor that ``reset_error`` or ``reset_errors`` drew before; ``back`` is 1 for the last one."""
    if spread == 0.0:
        return np.float32(1.0)
    bits = _bits(random[KEY], random[COUNTER] + np.uint64(1) - np.uint64(back))
    return np.float32(1.0) + np.float32(spread) * normals[bits >> np.uint64(52)]


@njit(**INNER_KERNEL)
def draw_arrivals(
    alias: NDArray[np.uint64],
    rate_us: float,
    after: float,
    random: NDArray[np.uint64],
    times: NDArray[np.float64],
    where: NDArray[np.int64],
) -> None:
    """Draw the next background and hot-pixel events of all pixels together: a Poisson process.

    Exponential waiting times at the rate of all pixels (events per us) from the last event drawn (us); the pixel by
    Walker's alias method (Walker 1977), from ``fill_alias``, (pixels,) uint64. Filled in, each (N,): ``times``, float64
    us, and ``where``, int64, pixel number times 2, plus 1 if ON.
    """
    n = np.uint64(alias.size)
    key, count = random[KEY], random[COUNTER]
    for k in range(times.size):
        bits = _bits(key, count + np.uint64(1) + np.uint64(k))
        times[k] = -log32(np.float32(np.int32(bits >> np.uint64(41))) * _TO_UNIT + _HALF_UNIT)
    count += np.uint64(times.size)
    for k in range(where.size):
        bits = _bits(key, count + np.uint64(1) + np.uint64(k))
        pixel = ((bits >> np.uint64(32)) * n) >> np.uint64(32)
        entry = alias[pixel]
        own = (bits & _LOW_32) >> np.uint64(1) < (entry & _LOW_32) >> np.uint64(1)
        pixel = pixel if own else entry >> np.uint64(32)
        where[k] = np.int64((pixel << np.uint64(1)) | (bits & np.uint64(1)))
    random[COUNTER] = count + np.uint64(where.size)
    t = after
    for k in range(times.size):
        t += times[k] / rate_us
        times[k] = t


@njit(**LOOP)
def fill_alias(scaled: NDArray[np.float64], alias: NDArray[np.uint64]) -> None:
    """Fill Walker's alias table (Walker 1977), by Vose's algorithm (Vose 1991).

    ``scaled``, (N,) float64, are rates scaled to a mean of 1; used up. ``alias``, (N,) uint64, gets the share of 2^32
    in the low half, the other pixel in the high half.
    """
    n = scaled.size
    small, large = np.empty(n, np.int32), np.empty(n, np.int32)
    n_small = n_large = 0
    for i in range(n):
        alias[i] = _LOW_32 | (np.uint64(i) << np.uint64(32))
        if scaled[i] < 1.0:
            small[n_small] = i
            n_small += 1
        else:
            large[n_large] = i
            n_large += 1
    while n_small > 0 and n_large > 0:
        n_small -= 1
        i, j = small[n_small], large[n_large - 1]
        alias[i] = np.uint64(scaled[i] * 4294967295.0) | (np.uint64(j) << np.uint64(32))
        scaled[j] -= 1.0 - scaled[i]
        if scaled[j] < 1.0:
            n_large -= 1
            small[n_small] = j
            n_small += 1
