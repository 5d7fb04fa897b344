"""The photoreceptor under a periodic light: its level at any phase, and when it crosses a threshold.

The large-signal first-order model: light I(t) = ambient + light * w(t), and with u = exp(-V) of the
receptor's output V = ln I (in the steady state),

    du/dt = (1 - I u) / q

is linear: the time constant is q / I, so ON edges are fast and OFF edges slow. Under a square light u is a
pair of exponentials and everything is closed form; under any other light with one rise and one fall a period,
u comes from an atlas of periodic steady states, tabulated over phase and light. Compiled functions of numbers
and arrays only; times in microseconds.
"""

from __future__ import annotations

from math import exp, floor, log
from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

SQUARE: Final = 0
SMOOTH: Final = 1

JIT: Final[dict[str, Any]] = {"cache": True, "error_model": "numpy", "nogil": True}
"""How everything here is compiled."""


class Drive(NamedTuple):
    """The light and the photoreceptor: I(t) = ambient + light * w(t); du/dt = (1 - I u) / q."""

    kind: int
    period_us: float
    high_us: float  # square: length of the high part
    w_high: float
    w_low: float
    ambient: float
    q_us: float
    start_us: float  # sensor time at which a period begins
    atlas: NDArray[np.float32]  # smooth: (levels, bins + 1) u over a period, light rising from row to row
    lowest: float  # smooth: light of the first row; below, nothing ever crosses
    log_step: float  # smooth: ln of the ratio of light from one row to the next
    extremes: NDArray[np.int32]  # smooth: (levels, 2) bins of the largest and the smallest u


@njit(**JIT)
def steady_square(drive: Drive, light: float) -> tuple[float, float]:
    """Values of u at the rising and the falling edge in the periodic steady state, in closed form."""
    i_high, i_low = drive.ambient + light * drive.w_high, drive.ambient + light * drive.w_low
    decay_high = exp(-i_high * drive.high_us / drive.q_us)
    decay_low = exp(-i_low * (drive.period_us - drive.high_us) / drive.q_us)
    bright, dark = 1.0 / i_high, 1.0 / i_low
    u_rise = (dark * (1.0 - decay_low) + bright * (1.0 - decay_high) * decay_low) / (
        1.0 - decay_high * decay_low
    )
    return u_rise, bright + (u_rise - bright) * decay_high


@njit(inline="always", **JIT)
def _square_value(d: Drive, light: float, u_rise: float, u_fall: float, phase: float) -> float:
    """Value of u at a phase (us after the rising edge, below one period)."""
    if phase < d.high_us:
        i = d.ambient + light * d.w_high
        return 1.0 / i + (u_rise - 1.0 / i) * exp(-phase * i / d.q_us)
    i = d.ambient + light * d.w_low
    return 1.0 / i + (u_fall - 1.0 / i) * exp(-(phase - d.high_us) * i / d.q_us)


@njit(inline="always", **JIT)
def _square_on(d: Drive, light: float, u_rise: float, target: float) -> float:
    """Phase at which u falls to the target in the high part."""
    i = d.ambient + light * d.w_high
    return d.q_us / i * log((u_rise - 1.0 / i) / (target - 1.0 / i))


@njit(inline="always", **JIT)
def _square_off(d: Drive, light: float, u_fall: float, target: float) -> float:
    """Phase at which u rises to the target in the low part."""
    i = d.ambient + light * d.w_low
    return d.high_us + d.q_us / i * log((u_fall - 1.0 / i) / (target - 1.0 / i))


@njit(**JIT)
def _square_next(
    d: Drive, light: float, u_rise: float, u_fall: float, on_at: float, off_at: float, phase: float
) -> tuple[float, int]:
    """Phase (may exceed the period) and polarity of the next crossing of ``on_at`` or ``off_at``; inf = none."""
    can_on, can_off = u_fall <= on_at < u_rise, u_rise >= off_at > u_fall
    if phase < d.high_us:
        if u_fall <= on_at:
            return max(phase, _square_on(d, light, u_rise, on_at) if can_on else phase), 1
        if can_off:
            return _square_off(d, light, u_fall, off_at), 0
        return np.inf, 0
    if u_rise >= off_at:
        return max(phase, _square_off(d, light, u_fall, off_at) if can_off else phase), 0
    if can_on:
        return d.period_us + _square_on(d, light, u_rise, on_at), 1
    return np.inf, 0


@njit(inline="always", **JIT)
def _atlas_u(atlas: NDArray, j: int, f: float, i: int) -> float:
    """Value of u on the atlas at a level (row j, share f of the next) and bin i."""
    return (1.0 - f) * atlas[j, i] + f * atlas[j + 1, i]


@njit(**JIT)
def _smooth_value(d: Drive, level: float, phase: float) -> float:
    """Value of u at a phase, interpolated on the atlas."""
    j = int(level)
    f = level - j
    x = phase / d.period_us * (d.atlas.shape[1] - 1)
    i = min(int(x), d.atlas.shape[1] - 2)
    return _atlas_u(d.atlas, j, f, i) * (1.0 - (x - i)) + _atlas_u(d.atlas, j, f, i + 1) * (x - i)


@njit(**JIT)
def _branch_crossing(d: Drive, j: int, f: float, first: int, last: int, target: float, sign: float) -> float:
    """Bin position at which sign * u rises to sign * target on a monotone branch; bins may exceed one period."""
    bins = d.atlas.shape[1] - 1
    low, high = first, last
    while high - low > 1:
        middle = (low + high) // 2
        if sign * (_atlas_u(d.atlas, j, f, middle % bins) - target) >= 0.0:
            high = middle
        else:
            low = middle
    a, b = _atlas_u(d.atlas, j, f, low % bins), _atlas_u(d.atlas, j, f, high % bins)
    return low + (min(1.0, max(0.0, (target - a) / (b - a))) if b != a else 0.0)


@njit(**JIT)
def _smooth_next(d: Drive, level: float, on_at: float, off_at: float, phase: float) -> tuple[float, int]:
    """Phase (may exceed the period) and polarity of the next crossing on the atlas; inf = none."""
    bins = d.atlas.shape[1] - 1
    j = int(level)
    f = level - j
    nearest = j + (1 if f > 0.5 else 0)
    dark, bright = d.extremes[nearest, 0], d.extremes[nearest, 1]
    u_dark, u_bright = _atlas_u(d.atlas, j, f, dark), _atlas_u(d.atlas, j, f, bright)
    x = phase / d.period_us * bins
    # ON branch: dark .. bright; OFF branch: bright .. dark + bins. Bring the phase onto one of them.
    if bright < dark:
        bright += bins
    if x < dark:
        x += bins
        shift = 1
    else:
        shift = 0
    if x < bright:
        if u_bright <= on_at:
            cross, on = max(x, _branch_crossing(d, j, f, dark, bright, on_at, -1.0)), 1
        elif u_dark >= off_at:
            cross, on = _branch_crossing(d, j, f, bright, dark + bins, off_at, 1.0), 0
        else:
            return np.inf, 0
    elif u_dark >= off_at:
        cross, on = max(x, _branch_crossing(d, j, f, bright, dark + bins, off_at, 1.0)), 0
    elif u_bright <= on_at:
        cross, on = _branch_crossing(d, j, f, dark, bright, on_at, -1.0) + bins, 1
    else:
        return np.inf, 0
    return (cross - shift * bins) / bins * d.period_us, on


@njit(**JIT)
def period_start(drive: Drive, epoch: float, t: float) -> float:
    """Start of the light's period in which t lies, us after the epoch."""
    first = drive.start_us - epoch
    return first + floor((t - first) / drive.period_us) * drive.period_us


@njit(**JIT)
def value_at(drive: Drive, light: float, u_rise: float, u_fall: float, phase: float) -> float:
    """Value of u of a pixel at a phase (us, below one period)."""
    if drive.kind == SQUARE:
        return _square_value(drive, light, u_rise, u_fall, phase)
    if u_rise < 0.0:
        return 1.0 / drive.ambient
    return _smooth_value(drive, u_rise, phase)


@njit(**JIT)
def next_crossing(
    drive: Drive, light: float, u_rise: float, u_fall: float, on_at: float, off_at: float, phase: float
) -> tuple[float, int]:
    """Phase and polarity of a pixel's next crossing; inf = none."""
    if light * drive.w_high <= 0.0 or u_rise < 0.0:
        return np.inf, 0
    if drive.kind == SQUARE:
        return _square_next(drive, light, u_rise, u_fall, on_at, off_at, phase)
    return _smooth_next(drive, u_rise, on_at, off_at, phase)


@njit(**JIT)
def atlas_level(drive: Drive, light: float) -> float:
    """Row position on the atlas for a light; -1 for too little light to cross any threshold."""
    if light < drive.lowest:
        return -1.0
    return min(log(light / drive.lowest) / drive.log_step, drive.atlas.shape[0] - 1.001)


@njit(**JIT)
def fill_atlas(
    atlas: NDArray, extremes: NDArray, lights: NDArray, wave: NDArray, ambient: float, bin_q: float
) -> None:
    """Tabulate the periodic steady state of u for each light.

    Parameters
    ----------
    atlas, extremes
        (levels, bins + 1) float32 and (levels, 2) int32, filled in.
    lights
        (levels,) light of each row.
    wave
        (bins,) w in the middle of each bin: within a bin I is taken as constant, which is exact for steps and
        of second order in the bin's length for smooth waves.
    ambient
        Constant part of I.
    bin_q
        Length of a bin in units of q.
    """
    bins = wave.size
    for j in range(lights.size):
        scale, offset = 1.0, 0.0  # u after a period = scale * u + offset
        for i in range(bins):
            intensity = ambient + lights[j] * wave[i]
            decay = exp(-intensity * bin_q)
            scale *= decay
            offset = offset * decay + (1.0 - decay) / intensity
        u = offset / (1.0 - scale)
        for i in range(bins):
            atlas[j, i] = u
            intensity = ambient + lights[j] * wave[i]
            u = 1.0 / intensity + (u - 1.0 / intensity) * exp(-intensity * bin_q)
        atlas[j, bins] = u
        extremes[j, 0] = atlas[j, :bins].argmax()
        extremes[j, 1] = atlas[j, :bins].argmin()
