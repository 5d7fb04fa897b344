"""A square light in double precision, for the few events that float32 would misplace by microseconds."""

from __future__ import annotations

from math import exp, floor, log
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulators.pixels import photoreceptor as pr
from simulators.pixels.drive import SQUARE, Drive
from simulators.pixels.fast_math import INNER, INNER_KERNEL
from simulators.pixels.sensor_state import (
    smallest,
)

STEEP: Final = 3e-5
"""Smallest change of ln u per microsecond at which float32 is good to some hundredths of a microsecond."""
LEAST_Q_US: Final = 1.0  # A shorter time constant is below the clock's step
TIME_STEP_US: Final = 4.0 / 1024.0
"""The coarsest step of a float32 time after the epoch, about 4 ns."""


@njit(forceinline=True, **INNER)
def tail_width(d: Drive) -> float:
    """Return the relative distance of u from its limit below which u changes more slowly than ``STEEP``."""
    return STEEP * max(d.q_us, LEAST_Q_US) if d.kind == SQUARE else 0.0


@njit(forceinline=True, **INNER)
def limit_distance(d: Drive, light: Any, on_at: Any, off_at: Any) -> Any:
    """Return how near the nearer of a pixel's two targets is to the limit of u in its part of the period."""
    i_high = np.float32(d.ambient) + light * np.float32(d.w_high)
    i_low = np.float32(d.ambient) + light * np.float32(d.w_low)
    return min(abs(on_at * i_high - np.float32(1.0)), abs(off_at * i_low - np.float32(1.0)))


@njit(**INNER_KERNEL)
def fill_limit_distance(drive: Drive, batch: NDArray[np.float32], n: int) -> Any:
    """Fill in ``LIMIT_DISTANCE`` of each pixel under a square light; return the smallest, at most 1."""
    for k in range(n):
        batch[pr.LIMIT_DISTANCE, k] = limit_distance(
            drive, batch[pr.LIGHT, k], batch[pr.ON_AT, k], batch[pr.OFF_AT, k]
        )
    return min(np.float32(1.0), smallest(batch[pr.LIMIT_DISTANCE, :n]))


@njit(**INNER)
def _steady(d: Drive, light: float) -> tuple[float, float]:
    """Return u at the rising and the falling edge in the periodic steady state; see `photoreceptor._steady_square`."""
    i_high, i_low = d.ambient + light * d.w_high, d.ambient + light * d.w_low
    decay_high = exp(-i_high * d.high_us / d.q_us)
    decay_low = exp(-i_low * (d.period_us - d.high_us) / d.q_us)
    bright, dark = 1.0 / i_high, 1.0 / i_low
    rise = dark * (1.0 - decay_low) + bright * (1.0 - decay_high) * decay_low
    u_rise = rise / (1.0 - decay_high * decay_low)
    return u_rise, bright + (u_rise - bright) * decay_high


@njit(**INNER)
def level(d: Drive, light: float, phase: float) -> float:
    """Return u of a pixel at a phase."""
    u_rise, u_fall = _steady(d, light)
    rising = phase >= d.high_us  # u rises in the low part
    i = d.ambient + light * (d.w_low if rising else d.w_high)
    since = phase - (d.high_us if rising else 0.0)
    return 1.0 / i + ((u_fall if rising else u_rise) - 1.0 / i) * exp(-since * i / d.q_us)


@njit(**INNER)
def crossing(d: Drive, light: float, on_at: float, off_at: float, phase: float) -> tuple[float, bool]:
    """Return the first crossing at or after a phase: its phase, us (inf = none), and whether it is ON."""
    u_rise, u_fall = _steady(d, light)
    bright, dark = 1.0 / (d.ambient + light * d.w_high), 1.0 / (d.ambient + light * d.w_low)
    can_on, can_off = u_fall <= on_at, u_rise >= off_at
    rising = phase >= d.high_us
    on = not can_off if rising else can_on  # the present part of the period first, then the one after it
    if not (can_on if on else can_off):
        return np.inf, on
    start, end, at = (u_rise, bright, on_at) if on else (u_fall, dark, off_at)
    begin = (d.period_us if rising else 0.0) if on else d.high_us
    if start == end:
        return np.inf, on
    past = (start - end) / (at - end) if at != end else np.inf
    return max(begin + d.q_us * end * log(max(past, 1.0)), phase), on


@njit(**INNER)
def request_time(d: Drive, light: float, target: float, on: bool, t: float, start: float) -> float:
    """Return when u met a target, more exactly than float32 stores a request's time t, us after the epoch.

    On a steep slope the target determines the moment better than the stored time does. The light that the pixel
    receives at the end of its dead time sets the next reference.
    """
    begin = start + floor((t - start) / d.period_us) * d.period_us + (0.0 if on else d.high_us)
    u_rise, u_fall = _steady(d, light)
    end = 1.0 / (d.ambient + light * (d.w_high if on else d.w_low))
    past = ((u_rise if on else u_fall) - end) / (target - end) if target != end else 0.0
    exact = begin + d.q_us * end * log(past) if past > 0.0 else t
    return exact if abs(exact - t) <= TIME_STEP_US else t
