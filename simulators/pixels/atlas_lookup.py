"""Look-ups in the atlas of steady states: a pixel's level at a phase, and when it crosses a threshold.

For every light that has an atlas (see ``drive``): any light with one rise and one fall a period, square ones behind a
second pole included. Compiled functions for one pixel; ``photoreceptor`` runs them over batches. ln u increases on
the OFF branch of a curve and decreases on the ON branch. A phase is in microseconds after the start of a period.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulators.pixels.drive import (
    ATLAS_BINS,
    ATLAS_LEVELS,
    EDGE_BEND,
    LN_BRIGHT,
    LN_DARK,
    T_BRIGHT,
    T_DARK,
    WHEN_STEPS,
    Drive,
)
from simulators.pixels.fast_math import INNER, exp32, log32

_ZERO: Final = np.float32(0.0)
_ONE: Final = np.float32(1.0)
_NEVER: Final = np.float32(np.inf)
_TINY: Final = np.float32(1e-30)
_ROOT_2: Final = np.float32(math.sqrt(2.0))
_HALF: Final = np.float32(0.5)
_NEXT: Final = np.uint32(1)


@njit(forceinline=True, **INNER)
def smooth_level(drive: Drive, level: Any, phase: float, bent: bool) -> Any:
    """Return u of a pixel at a phase, interpolated on the atlas."""
    x = _bin_at(drive, np.float32(phase), bent)
    i = np.int32(x)
    g = x - np.float32(i)
    here, there = drive.atlas[i], drive.atlas[i + 1]
    j = np.uint32(np.int32(max(level, _ZERO)))
    f = level - np.float32(j)
    a = here[j] + f * (here[j + _NEXT] - here[j])
    b = there[j] + f * (there[j + _NEXT] - there[j])
    return exp32(a + g * (b - a)) if level >= _ZERO else np.float32(1.0 / drive.ambient)


@njit(forceinline=True, **INNER)
def between(table: NDArray[np.float32], j: Any, f: Any) -> Any:
    """Interpolate between the entries j and j + 1 of a table, (N,) float32."""
    return table[j] + f * (table[j + _NEXT] - table[j])


@njit(forceinline=True, **INNER)
def _atlas_crossing(d: Drive, j: Any, f: Any, target: Any, at: Any) -> Any:
    """Return the phase near ``at`` at which the atlas, as ``smooth_level`` interpolates it, meets the target.

    Each event takes its reference where the last one left it. If the two came from curves that differ slightly, the
    difference would add up from event to event.
    """
    period = np.float32(d.period_us)
    later = period if at >= period else _ZERO
    i = np.uint32(np.int32(_bin_at(d, at - later, False)))
    share = _share(d, i, j, f, target)
    start, length = d.grid[i], d.grid[i + _NEXT] - d.grid[i]
    return later + start + share * length if abs(share - _HALF) <= _ONE else at


@njit(forceinline=True, **INNER)
def _share(d: Drive, i: Any, j: Any, f: Any, target: Any) -> Any:
    """Return where in bin i a curve meets the target, 0 at its start and 1 at its end."""
    c = i * np.uint32(ATLAS_LEVELS) + j
    here, there = between(d.flat, c, f), between(d.flat, c + np.uint32(ATLAS_LEVELS), f)
    return (target - here) / (there - here)


@njit(**INNER)
def _bisected_crossing(d: Drive, j: Any, f: Any, target: Any, first: Any, last: Any, off: Any) -> Any:
    """Return the phase of a crossing on a branch, by bisection: a curve with edges has no slope at them."""
    bins = np.int64(ATLAS_BINS)
    period = np.float32(d.period_us)
    low = np.int64(_bin_at(d, first - (period if first >= period else _ZERO), True))
    low += bins if first >= period else 0
    high = np.int64(_bin_at(d, last - (period if last >= period else _ZERO), True)) + 1
    high += bins if last >= period else 0
    while high - low > 1:
        middle = (low + high) // 2
        c = np.uint32(middle % bins) * np.uint32(ATLAS_LEVELS) + j
        if (between(d.flat, c, f) >= target) == off:
            high = middle
        else:
            low = middle
    i = np.uint32(low % bins)
    share = min(max(_share(d, i, j, f, target), _ZERO), _ONE)
    later = period if low >= bins else _ZERO
    return later + d.grid[i] + share * (d.grid[i + _NEXT] - d.grid[i])


@njit(forceinline=True, **INNER)
def _bin_at(d: Drive, phase: Any, bent: bool) -> Any:
    """Return the position of a phase below one period among the atlas's bins, with its fraction.

    The inverse of ``drive._bent_grid`` where the bins are bent.
    """
    bins = np.float32(ATLAS_BINS)
    if not bent:
        x = phase * np.float32(ATLAS_BINS / d.period_us)
    else:
        low = phase >= np.float32(d.high_us)
        since = phase - np.float32(d.high_us) if low else phase
        part = np.float32(d.period_us - d.high_us) if low else np.float32(d.high_us)
        s = log32(_ONE + since / part * np.float32(math.expm1(EDGE_BEND)))
        x = s * np.float32(ATLAS_BINS / 2 / EDGE_BEND) + (np.float32(ATLAS_BINS / 2) if low else _ZERO)
    return min(max(x, _ZERO), bins - np.float32(0.001))


@njit(forceinline=True, **INNER)
def _tabulated_crossing(d: Drive, j: Any, f: Any, target: Any, bright: Any, dark: Any, off: Any) -> Any:
    """Return the phase of a crossing from ``Drive.when``, to about a tenth of a microsecond."""
    above, below = max(target - bright, _ZERO), max(dark - target, _ZERO)
    root = np.sqrt(min(above, below) / max(dark - bright, _TINY))
    s = (root if above <= below else _ROOT_2 - root) * np.float32(WHEN_STEPS / math.sqrt(2.0))
    k = np.uint32(np.int32(s))
    g = s - np.float32(k)
    i = (j + (np.uint32(ATLAS_LEVELS) if off else np.uint32(0))) * np.uint32(WHEN_STEPS + 2) + k
    here, there = between(d.when, i, g), between(d.when, i + np.uint32(WHEN_STEPS + 2), g)
    return here + f * (there - here)


@njit(forceinline=True, **INNER)
def near_crossing(
    d: Drive, level: Any, on_at: Any, off_at: Any, phase: float, bent: bool
) -> tuple[Any, Any, Any, Any, Any]:
    """Return about when a pixel crosses next: on the present branch of the curve, or on the one after it.

    ``Drive.when`` holds the phase of a crossing over the light and the height of the target between the curve's
    extremes. The height has a scale that grows as the root of the distance from either extreme; the phase is smooth in
    it. With ``exact_crossing`` the two halves of a crossing are two short loops over many pixels: a processor then
    waits for the memory of several pixels at once.

    Returns phase of the crossing on its branch, us; ln u there; the earliest phase that it may have, us; what is to be
    added to it, us (inf = it never crosses); and its polarity (1.0 = ON).
    """
    j = np.uint32(np.int32(max(level, _ZERO)))
    f = level - np.float32(j)
    bright, dark = between(d.turns[LN_BRIGHT], j, f), between(d.turns[LN_DARK], j, f)
    t_bright, t_dark = between(d.turns[T_BRIGHT], j, f), between(d.turns[T_DARK], j, f)
    period = np.float32(d.period_us)
    turn = period if np.float32(phase) < t_dark else _ZERO  # the period that begins in the dark
    now = np.float32(phase) + turn
    rising = now >= t_bright
    on_ln, off_ln = log32(on_at), log32(off_at)
    can_on, can_off = on_ln >= bright, off_ln <= dark
    in_now = can_off if rising else can_on
    off = rising == in_now
    never = not (can_on or can_off) or level < _ZERO
    target = off_ln if off else on_ln
    if bent:
        near = _bisected_crossing(
            d, j, f, target, t_bright if off else t_dark, t_dark + period if off else t_bright, off
        )
    else:
        near = _tabulated_crossing(d, j, f, target, bright, dark, off)
    shift = (period if rising and not in_now else _ZERO) - turn
    return near, target, now if in_now else _ZERO, _NEVER if never else shift, _ZERO if off else _ONE


@njit(forceinline=True, **INNER)
def exact_crossing(
    d: Drive, level: Any, near: Any, target: Any, earliest: Any, shift: Any, bent: bool
) -> Any:
    """Return the phase of a pixel's next crossing, us, from ``near_crossing``; may exceed a period; inf = none."""
    cross = near
    if not bent:
        j = np.uint32(np.int32(max(level, _ZERO)))
        cross = _atlas_crossing(d, j, level - np.float32(j), target, near)
    cross = max(cross, earliest) + shift
    return _NEVER if shift == _NEVER else cross


@njit(forceinline=True, **INNER)
def smooth_crossing(
    d: Drive, level: Any, on_at: Any, off_at: Any, phase: float, bent: bool
) -> tuple[Any, Any]:
    """Return phase, us (may exceed a period, inf = none), and polarity (1.0 = ON) of a pixel's next crossing."""
    near, target, earliest, shift, is_on = near_crossing(d, level, on_at, off_at, phase, bent)
    return exact_crossing(d, level, near, target, earliest, shift, bent), is_on
