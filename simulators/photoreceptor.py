"""The photoreceptors under a periodic light: their levels at any phase, and when they cross a threshold.

The large-signal first-order model: light I(t) = ambient + light * w(t), and with u = exp(-V) of the
receptor's output V = ln I (in the steady state),

    du/dt = (1 - I u) / q

is linear: the time constant is q / I, so ON edges are fast and OFF edges slow. Under a square light u is a
pair of exponentials and everything is closed form; under any other light with one rise and one fall a period,
u comes from an atlas of periodic steady states, tabulated over light and phase.

Compiled functions over a batch of pixels: a float32 array of N_BATCH rows, one number of a pixel each. A phase
is in microseconds after the start of a period of the light.
"""

from __future__ import annotations

import math
from math import floor, log
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulators.drive import (
    ATLAS_LEVELS,
    LEAST,
    LN_BRIGHT,
    LN_DARK,
    SMOOTH,
    SQUARE,
    T_BRIGHT,
    T_DARK,
    WHEN_STEPS,
    Drive,
)
from simulators.fast_math import JIT, KERNEL, exp32, log32

# Rows of a batch.
LIGHT: Final = 0  # its place: square: share of the drive that reaches the pixel; smooth: level on the atlas
U_RISE: Final = 1  # square: u at the rising edge; smooth: level on the atlas, -1 = too dark ever to fire
U_FALL: Final = 2  # square: u at the falling edge
ON_AT: Final = 3  # an ON event comes when u has fallen to this
OFF_AT: Final = 4  # an OFF event comes when u has risen to this
U: Final = 5  # u at the phase asked for
T: Final = 6  # phase of the next crossing; may exceed a period; inf = none
IS_ON: Final = 7  # its polarity
N_BATCH: Final = 8

_ZERO: Final = np.float32(0.0)
_ONE: Final = np.float32(1.0)
_NEVER: Final = np.float32(np.inf)
_HUGE: Final = np.float32(1e30)
_TINY: Final = np.float32(1e-30)
_ROOT_2: Final = np.float32(math.sqrt(2.0))
_HALF: Final = np.float32(0.5)
_NEXT: Final = np.uint32(1)


@njit(**JIT)
def period_start(drive: Drive, epoch: float, t: float) -> float:
    """Start of the light's period in which t lies, us after the epoch."""
    first = drive.start_us - epoch
    return first + floor((t - first) / drive.period_us) * drive.period_us


@njit(**JIT)
def place(drive: Drive, light: float) -> float:
    """What is kept of a pixel's light: itself under a square light, its level on the atlas under another."""
    if drive.kind == SQUARE:
        return light
    if light < drive.lowest:
        return -1.0
    level = log((1.0 + light * drive.contrast) / LEAST) / drive.log_step
    return min(level, ATLAS_LEVELS - 1.001)


@njit(inline="always", **JIT)
def steady(d: Drive, placed: Any) -> tuple[Any, Any]:
    """U_RISE and U_FALL of a pixel, from its place."""
    if d.kind == SMOOTH:
        return placed, _ZERO
    return _steady_square(d, placed)


@njit(**KERNEL)
def steady_levels(drive: Drive, batch: NDArray, n: int) -> None:
    """Fill in U_RISE and U_FALL from the place of each pixel."""
    if drive.kind == SMOOTH:
        for k in range(n):
            batch[U_RISE, k] = batch[LIGHT, k]
    else:
        for k in range(n):
            batch[U_RISE, k], batch[U_FALL, k] = _steady_square(drive, batch[LIGHT, k])


@njit(inline="always", **JIT)
def level_at(d: Drive, light: Any, u_rise: Any, u_fall: Any, phase: float) -> Any:
    """Value of u of one pixel at a phase below one period."""
    if d.kind == SMOOTH:
        return _smooth_level(d, u_rise, phase)
    return _square_level(d, light, u_rise, u_fall, phase)


@njit(inline="always", **JIT)
def crossing(d: Drive, light: Any, u_rise: Any, u_fall: Any, on_at: Any, off_at: Any, phase: float) -> Any:
    """First crossing of one pixel at or after a phase below one period.

    Returns its phase (float32; may exceed a period, inf = none) and its polarity (1.0 = ON).
    """
    if d.kind == SMOOTH:
        return _smooth_crossing(d, u_rise, on_at, off_at, phase)
    return _square_crossing(d, light, u_rise, u_fall, on_at, off_at, phase)


@njit(**KERNEL)
def levels_at(drive: Drive, batch: NDArray, n: int, phase: float) -> None:
    """Fill in U at a phase below one period."""
    if drive.kind == SMOOTH:
        for k in range(n):
            batch[U, k] = _smooth_level(drive, batch[U_RISE, k], phase)
    else:
        for k in range(n):
            batch[U, k] = _square_level(drive, batch[LIGHT, k], batch[U_RISE, k], batch[U_FALL, k], phase)


@njit(**KERNEL)
def crossings(drive: Drive, batch: NDArray, n: int, phase: float) -> None:
    """Fill in T and IS_ON: the first crossing of ON_AT or OFF_AT at or after a phase below one period."""
    if drive.kind == SMOOTH:
        for k in range(n):
            on_at, off_at = batch[ON_AT, k], batch[OFF_AT, k]
            batch[T, k], batch[IS_ON, k] = _smooth_crossing(drive, batch[U_RISE, k], on_at, off_at, phase)
    else:
        for k in range(n):
            light, u_rise, u_fall = batch[LIGHT, k], batch[U_RISE, k], batch[U_FALL, k]
            on_at, off_at = batch[ON_AT, k], batch[OFF_AT, k]
            batch[T, k], batch[IS_ON, k] = _square_crossing(
                drive, light, u_rise, u_fall, on_at, off_at, phase
            )


# ---------------------------------------------------------------- square


@njit(inline="always", **JIT)
def _steady_square(d: Drive, light: Any) -> tuple[Any, Any]:
    """Values of u at the rising and the falling edge in the periodic steady state, in closed form."""
    i_high = np.float32(d.ambient) + light * np.float32(d.w_high)
    i_low = np.float32(d.ambient) + light * np.float32(d.w_low)
    decay_high = exp32(-i_high * np.float32(d.high_us / d.q_us))
    decay_low = exp32(-i_low * np.float32((d.period_us - d.high_us) / d.q_us))
    bright, dark = _ONE / i_high, _ONE / i_low
    rise = dark * (_ONE - decay_low) + bright * (_ONE - decay_high) * decay_low
    u_rise = rise / (_ONE - decay_high * decay_low)
    return u_rise, bright + (u_rise - bright) * decay_high


@njit(inline="always", **JIT)
def _square_level(d: Drive, light: Any, u_rise: Any, u_fall: Any, phase: float) -> Any:
    """Let u relax towards 1 / I from its value at the last edge."""
    rising = phase >= d.high_us  # u rises in the low part
    i = np.float32(d.ambient) + light * np.float32(d.w_low if rising else d.w_high)
    since = np.float32((phase - (d.high_us if rising else 0.0)) / d.q_us)
    end = _ONE / i
    return end + ((u_fall if rising else u_rise) - end) * exp32(-since * i)


@njit(inline="always", **JIT)
def _square_crossing(
    d: Drive, light: Any, u_rise: Any, u_fall: Any, on_at: Any, off_at: Any, phase: float
) -> Any:
    """The present part of the period is searched, then the one after it; beyond, all repeats.

    Within a part u relaxes from its value at the part's start towards 1 / I and meets the target at
    (q / I) ln((u_start - 1 / I) / (target - 1 / I)).
    """
    rising = phase >= d.high_us
    now_start, now_end = (u_fall, u_rise) if rising else (u_rise, u_fall)
    now_at, next_at = (off_at, on_at) if rising else (on_at, off_at)
    sign = _ONE if rising else -_ONE
    now_on, next_on = (_ZERO, _ONE) if rising else (_ONE, _ZERO)
    now_w, next_w = np.float32(d.w_low if rising else d.w_high), np.float32(d.w_high if rising else d.w_low)
    now_from = np.float32(d.high_us if rising else 0.0)
    next_from = np.float32(d.period_us if rising else d.high_us)
    in_now = sign * (now_end - now_at) >= _ZERO
    in_next = sign * (next_at - now_start) >= _ZERO
    u_start = now_start if in_now else now_end
    target = now_at if in_now else next_at
    end = _ONE / (np.float32(d.ambient) + light * (now_w if in_now else next_w))
    ratio = min(max((u_start - end) / (target - end), _TINY), _HUGE)
    begin = now_from if in_now else next_from
    cross = max(begin + np.float32(d.q_us) * end * log32(ratio), begin, np.float32(phase))
    never = not (in_now or in_next) or u_start == end
    return _NEVER if never else cross, now_on if in_now else next_on


# ---------------------------------------------------------------- smooth


@njit(inline="always", **JIT)
def _smooth_level(drive: Drive, level: Any, phase: float) -> Any:
    """Interpolate u at a phase on the atlas."""
    bins = drive.atlas.shape[0] - 1
    x = phase / drive.period_us * bins
    i = min(int(x), bins - 1)
    g = np.float32(x - i)
    here, there = drive.atlas[i], drive.atlas[i + 1]
    j = np.uint32(np.int32(max(level, _ZERO)))
    f = level - np.float32(j)
    a = here[j] + f * (here[j + _NEXT] - here[j])
    b = there[j] + f * (there[j + _NEXT] - there[j])
    return exp32(a + g * (b - a)) if level >= _ZERO else np.float32(1.0 / drive.ambient)


@njit(inline="always", **JIT)
def _between(table: NDArray, j: Any, f: Any) -> Any:
    """Interpolate between the entries j and j + 1 of a table."""
    return table[j] + f * (table[j + _NEXT] - table[j])


@njit(inline="always", **JIT)
def _on_curve(d: Drive, j: Any, f: Any, target: Any, at: Any) -> Any:
    """Phase near ``at`` at which the atlas itself, as ``_smooth_level`` interpolates it, meets the target.

    Each event takes its reference where the last one left it: were the two taken from curves that differ by a
    trifle, it would add up from event to event.
    """
    bins = np.int32(d.atlas.shape[0] - 1)
    levels = np.uint32(ATLAS_LEVELS)
    bin_us = np.float32(d.period_us) / np.float32(bins)
    i = min(np.int32(at / bin_us), 2 * bins - 1)
    c = np.uint32(i - bins if i >= bins else i) * levels + j
    flat = d.flat
    here, there = _between(flat, c, f), _between(flat, c + levels, f)
    share = (target - here) / (there - here)
    return (np.float32(i) + share) * bin_us if abs(share - _HALF) <= _ONE else at


@njit(inline="always", **JIT)
def _smooth_crossing(d: Drive, level: Any, on_at: Any, off_at: Any, phase: float) -> tuple[Any, Any]:
    """Phase and polarity of a pixel's next crossing: on the present branch of the curve, or on the one after it.

    ``Drive.when`` has the phase of a crossing over the light and the height of the target between the curve's
    turns, in a scale that grows as the root of the distance from either turn, in which the phase is smooth.
    """
    j = np.uint32(np.int32(max(level, _ZERO)))
    f = level - np.float32(j)
    bright, dark = _between(d.turns[LN_BRIGHT], j, f), _between(d.turns[LN_DARK], j, f)
    t_bright, t_dark = _between(d.turns[T_BRIGHT], j, f), _between(d.turns[T_DARK], j, f)
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
    above, below = max(target - bright, _ZERO), max(dark - target, _ZERO)
    root = np.sqrt(min(above, below) / (dark - bright))
    s = (root if above <= below else _ROOT_2 - root) * np.float32(WHEN_STEPS / math.sqrt(2.0))
    k = np.uint32(np.int32(s))
    g = s - np.float32(k)
    i = (j + (np.uint32(ATLAS_LEVELS) if off else np.uint32(0))) * np.uint32(WHEN_STEPS + 2) + k
    here, there = _between(d.when, i, g), _between(d.when, i + np.uint32(WHEN_STEPS + 2), g)
    cross = _on_curve(d, j, f, target, here + f * (there - here))
    cross = max(cross, now if in_now else _ZERO)
    cross += (period if rising and not in_now else _ZERO) - turn
    return _NEVER if never else cross, _ZERO if off else _ONE
