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

from math import exp, floor, log
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulators.drive import (
    LN_BRIGHT,
    LN_STEPS,
    SMOOTH,
    SQUARE,
    U_BRIGHT,
    U_DARK,
    X_BRIGHT,
    X_DARK,
    Drive,
)
from simulators.fast_math import JIT, exp32, log32

# Rows of a batch.
LIGHT: Final = 0  # share of the drive that reaches the pixel
U_RISE: Final = (
    1  # square: u at the rising edge; smooth: row position on the atlas, -1 = too dark ever to fire
)
U_FALL: Final = 2  # square: u at the falling edge
ON_AT: Final = 3  # an ON event comes when u has fallen to this
OFF_AT: Final = 4  # an OFF event comes when u has risen to this
U: Final = 5  # u at the phase asked for
T: Final = 6  # phase of the next crossing; may exceed a period; inf = none
IS_ON: Final = 7  # its polarity
N_BATCH: Final = 8

STRAIGHT: Final = np.float32(1.0)
"""Half the number of bins over which the atlas may be taken for straight."""

_ZERO: Final = np.float32(0.0)
_ONE: Final = np.float32(1.0)
_NEVER: Final = np.float32(np.inf)
_HUGE: Final = np.float32(1e30)
_TINY: Final = np.float32(1e-30)


@njit(**JIT)
def period_start(drive: Drive, epoch: float, t: float) -> float:
    """Start of the light's period in which t lies, us after the epoch."""
    first = drive.start_us - epoch
    return first + floor((t - first) / drive.period_us) * drive.period_us


@njit(**JIT)
def steady_levels(drive: Drive, batch: NDArray, n: int) -> None:
    """Fill in U_RISE and U_FALL for the light of each pixel."""
    if drive.kind == SQUARE:
        for k in range(n):
            batch[U_RISE, k], batch[U_FALL, k] = _steady_square(drive, batch[LIGHT, k])
    else:
        top = np.float32(drive.atlas.shape[0] - 1.001)
        for k in range(n):
            light = batch[LIGHT, k]
            level = np.float32(-1.0)
            if light >= drive.lowest:
                level = min(np.float32(log(light / drive.lowest) / drive.log_step), top)
            batch[U_RISE, k] = level


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


@njit(**JIT)
def levels_at(drive: Drive, batch: NDArray, n: int, phase: float) -> None:
    """Fill in U at a phase below one period."""
    if drive.kind == SMOOTH:
        for k in range(n):
            batch[U, k] = _smooth_level(drive, batch[U_RISE, k], phase)
    else:
        for k in range(n):
            batch[U, k] = _square_level(drive, batch[LIGHT, k], batch[U_RISE, k], batch[U_FALL, k], phase)


@njit(**JIT)
def crossings(drive: Drive, batch: NDArray, n: int, phase: float) -> None:
    """Fill in T and IS_ON: the first crossing of ON_AT or OFF_AT at or after a phase below one period."""
    if drive.kind == SMOOTH:
        for k in range(n):
            on_at, off_at = batch[ON_AT, k], batch[OFF_AT, k]
            batch[T, k], batch[IS_ON, k] = _smooth_guess(drive, batch[U_RISE, k], on_at, off_at, phase)
        for k in range(n):
            if batch[T, k] == -_ONE:
                on_at, off_at = batch[ON_AT, k], batch[OFF_AT, k]
                batch[T, k] = _smooth_sought(drive, batch[U_RISE, k], on_at, off_at, phase)
    else:
        for k in range(n):
            light, u_rise, u_fall = batch[LIGHT, k], batch[U_RISE, k], batch[U_FALL, k]
            on_at, off_at = batch[ON_AT, k], batch[OFF_AT, k]
            batch[T, k], batch[IS_ON, k] = _square_crossing(
                drive, light, u_rise, u_fall, on_at, off_at, phase
            )


# ---------------------------------------------------------------- square


@njit(**JIT)
def _steady_square(drive: Drive, light: float) -> tuple[float, float]:
    """Values of u at the rising and the falling edge in the periodic steady state, in closed form."""
    i_high, i_low = drive.ambient + light * drive.w_high, drive.ambient + light * drive.w_low
    decay_high = exp(-i_high * drive.high_us / drive.q_us)
    decay_low = exp(-i_low * (drive.period_us - drive.high_us) / drive.q_us)
    bright, dark = 1.0 / i_high, 1.0 / i_low
    both = decay_high * decay_low
    u_rise = (dark * (1.0 - decay_low) + bright * (1.0 - decay_high) * decay_low) / (1.0 - both)
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
    bins = drive.atlas.shape[1] - 1
    x = phase / drive.period_us * bins
    i = min(int(x), bins - 1)
    g = np.float32(x - i)
    j = int(max(level, _ZERO))
    f = level - np.float32(j)
    a = drive.by_bin[i, j] + f * (drive.by_bin[i, j + 1] - drive.by_bin[i, j])
    b = drive.by_bin[i + 1, j] + f * (drive.by_bin[i + 1, j + 1] - drive.by_bin[i + 1, j])
    return exp32(a + g * (b - a)) if level >= _ZERO else np.float32(1.0 / drive.ambient)


@njit(inline="always", **JIT)
def _between(table: NDArray, j: int, f: float, column: int) -> float:
    """Interpolate between rows j and j + 1."""
    return table[j, column] + f * (table[j + 1, column] - table[j, column])


@njit(inline="always", **JIT)
def _smooth_target(d: Drive, level: Any, on_at: Any, off_at: Any, phase: float) -> Any:
    """Decide which threshold is crossed next: the present branch of the atlas is searched, then the one after it.

    Returns ln u at the crossing, whether it is OFF, the bin before which it cannot lie, bins to add to its
    place on the branch for its place after the phase's period start, and whether it never comes.
    """
    bins = np.float32(d.atlas.shape[1] - 1)
    j = np.int32(max(level, _ZERO))
    f = level - np.float32(j)
    dark, bright = _between(d.turns, j, f, X_DARK), _between(d.turns, j, f, X_BRIGHT)
    x = np.float32(phase / d.period_us) * bins
    turn = bins if x < dark else _ZERO  # into the period that begins in the dark: dark <= x < dark + bins
    rising = x + turn >= bright
    can_on = _between(d.turns, j, f, U_BRIGHT) <= on_at
    can_off = _between(d.turns, j, f, U_DARK) >= off_at
    in_now = can_off if rising else can_on
    off = rising == in_now
    never = not (can_on or can_off) or level < _ZERO
    earliest = x + turn if in_now else _ZERO
    add = (bins if rising and not in_now else _ZERO) - turn
    return log32(off_at if off else on_at), off, earliest, add, never


@njit(inline="always", **JIT)
def _along_slope(d: Drive, j: Any, f: Any, target: Any, at: Any) -> tuple[Any, Any]:
    """Bin at which a straight line through the atlas near ``at`` meets the target, and how far that is."""
    bins = np.int32(d.atlas.shape[1] - 1)
    i = min(max(np.int32(at), np.int32(0)), 2 * bins - 1)
    c = i - bins if i >= bins else i
    here, there = _between(d.atlas, j, f, c), _between(d.atlas, j, f, c + 1)
    slope = there - here
    step = (target - here) / (slope if slope != _ZERO else _TINY)
    return np.float32(i) + step, step


@njit(inline="always", **JIT)
def _smooth_guess(d: Drive, level: Any, on_at: Any, off_at: Any, phase: float) -> tuple[Any, Any]:
    """Phase and polarity of a pixel's next crossing; -1 where the curve turns too close by to tell.

    Errors would add up from event to event, each taking its reference where the last one left it: references
    and crossings are taken from the very same curve, interpolated on the atlas. A table says about where; from
    there it goes along the slope, twice.
    """
    bins = np.float32(d.atlas.shape[1] - 1)
    j = np.int32(max(level, _ZERO))
    f = level - np.float32(j)
    target, off, earliest, add, never = _smooth_target(d, level, on_at, off_at, phase)
    steps = np.float32(d.when.shape[2] - 1)
    s = (target - _between(d.turns, j, f, LN_BRIGHT)) * _between(d.turns, j, f, LN_STEPS)
    s = min(max(s, _ZERO), steps)
    at = d.when[1 if off else 0, j, np.int32(s + np.float32(0.5))]
    first, _ = _along_slope(d, j, f, target, at)
    cross, step = _along_slope(d, j, f, target, first)
    straight = abs(step - np.float32(0.5)) <= STRAIGHT and s > _ONE and s < steps - _ONE
    t = (max(cross, earliest) + add) * np.float32(d.period_us) / bins
    return _NEVER if never else t if straight else -_ONE, _ZERO if off else _ONE


@njit(**JIT)
def _smooth_sought(d: Drive, level: Any, on_at: Any, off_at: Any, phase: float) -> Any:
    """Phase of a pixel's next crossing near a turn: sought by halving."""
    j = np.int32(level)
    f = level - np.float32(j)
    target, off, earliest, add, _ = _smooth_target(d, level, on_at, off_at, phase)
    cross = max(_crossing_bin(d, j, f, target, off), earliest)
    return (cross + add) * np.float32(d.period_us / (d.atlas.shape[1] - 1))


@njit(inline="always", **JIT)
def _smooth_crossing(d: Drive, level: Any, on_at: Any, off_at: Any, phase: float) -> tuple[Any, Any]:
    """Phase and polarity of a pixel's next crossing on the atlas."""
    t, on = _smooth_guess(d, level, on_at, off_at, phase)
    if t == -_ONE:
        t = _smooth_sought(d, level, on_at, off_at, phase)
    return t, on


@njit(**JIT)
def _crossing_bin(drive: Drive, j: int, f: float, target: float, off: bool) -> float:
    """Bin at which ln u crosses the target, sought by halving on the branch of the atlas."""
    bins = drive.atlas.shape[1] - 1
    dark, bright = _between(drive.turns, j, f, X_DARK), _between(drive.turns, j, f, X_BRIGHT)
    first, last = (bright, dark + bins) if off else (dark, bright)
    low, high = int(first), int(last) + 1
    while high - low > 1:
        middle = (low + high) // 2
        if (_between(drive.atlas, j, f, middle % bins) >= target) == off:
            high = middle
        else:
            low = middle
    here, there = _between(drive.atlas, j, f, low % bins), _between(drive.atlas, j, f, high % bins)
    share = (target - here) / (there - here) if there != here else _ZERO
    return min(max(low + min(max(share, _ZERO), _ONE), first), last)
