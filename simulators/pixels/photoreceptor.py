"""Photoreceptors under a periodic light: their levels at any phase, and when they cross a threshold.

The large-signal first-order model of a logarithmic photoreceptor. With light I(t) = ambient + light * w(t), and
u = exp(-V) of the receptor's output V = ln I (in the steady state),

    du/dt = (1 - I u) / q

is linear. It equals q dV/dt = I - exp(V): a capacitance that the photocurrent charges and a transistor below threshold
discharges. The time constant is q / I, so ON edges are fast and OFF edges slow. That the bandwidth grows in proportion
to the light is a property of real pixels (Lichtsteiner et al. 2008; modelled in v2e, Hu, Liu and Delbruck 2021). An ON
or OFF event comes when V has changed by a threshold from its value at the last reset (Lichtsteiner et al. 2008).

Under a square light u is a pair of exponentials and everything is closed form; it is computed here. Under any other
light with one rise and one fall a period, u comes from an atlas of periodic steady states; see ``atlas_lookup``.

Compiled functions over a batch of pixels: a float32 array of N_BATCH rows, one number of a pixel each. A phase is in
microseconds after the start of a period of the light.
"""

from __future__ import annotations

from math import floor, log
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulators.pixels.atlas_lookup import exact_crossing, near_crossing, smooth_crossing, smooth_level
from simulators.pixels.drive import ATLAS_LEVELS, BENT, LEAST, SMOOTH, SQUARE, Drive
from simulators.pixels.fast_math import INNER, INNER_KERNEL, exp32, log32

# Rows of a batch.
# From stored_light; square: share of the drive that reaches the pixel; smooth: level on the atlas
LIGHT: Final = 0
U_RISE: Final = 1  # square: u at the rising edge; smooth: level on the atlas, -1 = too dark ever to fire
U_FALL: Final = 2  # square: u at the falling edge
ON_AT: Final = 3  # an ON event comes when u has fallen to this
OFF_AT: Final = 4  # an OFF event comes when u has risen to this
U: Final = 5  # u at the requested phase
T: Final = 6  # phase of the next crossing; may exceed a period; inf = none
IS_ON: Final = 7  # its polarity
LIMIT_DISTANCE: Final = 8  # square: relative distance of the targets from the limit of u; see pixel_reset
TARGET: Final = 2  # smooth: ln u at the next crossing
EARLIEST: Final = 8  # smooth: see atlas_lookup.near_crossing
SHIFT: Final = 9
N_BATCH: Final = 10

_ZERO: Final = np.float32(0.0)
_ONE: Final = np.float32(1.0)
_NEVER: Final = np.float32(np.inf)
_HUGE: Final = np.float32(1e30)
_TINY: Final = np.float32(1e-30)


@njit(**INNER)
def period_start(drive: Drive, epoch: float, t: float) -> float:
    """Return the start of the light's period that contains the time t; both in us after the epoch, itself in us."""
    first = drive.start_us - epoch
    return first + floor((t - first) / drive.period_us) * drive.period_us


@njit(**INNER)
def stored_light(drive: Drive, light: float) -> float:
    """Return what is stored for a pixel: its share under a square light, else its place in the atlas; -1: too dark."""
    if drive.kind == SQUARE:
        return light
    if light < drive.lowest:
        return -1.0
    level = log((1.0 + light * drive.contrast) / LEAST) / drive.log_step
    return min(level, ATLAS_LEVELS - 1.001)


@njit(forceinline=True, **INNER)
def steady_state(d: Drive, placed: Any) -> tuple[Any, Any]:
    """Return U_RISE and U_FALL, as in a batch, of a pixel with a light from ``stored_light``."""
    if d.kind != SQUARE:
        return placed, _ZERO
    return _steady_square(d, placed)


@njit(**INNER_KERNEL)
def fill_steady_states(drive: Drive, batch: NDArray[np.float32], n: int) -> None:
    """Fill in U_RISE and U_FALL of each pixel from its stored light."""
    if drive.kind != SQUARE:
        for k in range(n):
            batch[U_RISE, k] = batch[LIGHT, k]
    else:
        for k in range(n):
            batch[U_RISE, k], batch[U_FALL, k] = _steady_square(drive, batch[LIGHT, k])


@njit(forceinline=True, **INNER)
def level_at(d: Drive, light: Any, u_rise: Any, u_fall: Any, phase: float) -> Any:
    """Return u of one pixel at a phase."""
    if d.kind != SQUARE:
        return smooth_level(d, u_rise, phase, d.kind == BENT)
    return _square_level(d, light, u_rise, u_fall, phase)


@njit(forceinline=True, **INNER)
def crossing(d: Drive, light: Any, u_rise: Any, u_fall: Any, on_at: Any, off_at: Any, phase: float) -> Any:
    """Return one pixel's first crossing at or after a phase: us (may exceed a period, inf = none); 1.0 = ON."""
    if d.kind != SQUARE:
        return smooth_crossing(d, u_rise, on_at, off_at, phase, d.kind == BENT)
    return _square_crossing(d, light, u_rise, u_fall, on_at, off_at, phase)


@njit(**INNER_KERNEL)
def fill_levels(drive: Drive, batch: NDArray[np.float32], n: int, phase: float) -> None:
    """Fill in U of each pixel at a phase."""
    bent = drive.kind == BENT
    if drive.kind == SMOOTH or bent:
        for k in range(n):
            batch[U, k] = smooth_level(drive, batch[U_RISE, k], phase, bent)
    else:
        for k in range(n):
            batch[U, k] = _square_level(drive, batch[LIGHT, k], batch[U_RISE, k], batch[U_FALL, k], phase)


@njit(**INNER_KERNEL)
def fill_crossings(drive: Drive, batch: NDArray[np.float32], n: int, phase: float) -> None:
    """Fill in T and IS_ON of each pixel: the first crossing of ON_AT or OFF_AT at or after a phase."""
    bent = drive.kind == BENT
    if drive.kind == SMOOTH:
        for k in range(n):
            crossing = near_crossing(drive, batch[U_RISE, k], batch[ON_AT, k], batch[OFF_AT, k], phase, bent)
            batch[T, k], batch[TARGET, k], batch[EARLIEST, k], batch[SHIFT, k], batch[IS_ON, k] = crossing
        for k in range(n):
            near, target, earliest, shift = batch[T, k], batch[TARGET, k], batch[EARLIEST, k], batch[SHIFT, k]
            batch[T, k] = exact_crossing(drive, batch[U_RISE, k], near, target, earliest, shift, bent)
    elif bent:
        for k in range(n):
            on_at, off_at = batch[ON_AT, k], batch[OFF_AT, k]
            crossing = smooth_crossing(drive, batch[U_RISE, k], on_at, off_at, phase, bent)
            batch[T, k], batch[IS_ON, k] = crossing
    else:
        for k in range(n):
            light, u_rise, u_fall = batch[LIGHT, k], batch[U_RISE, k], batch[U_FALL, k]
            on_at, off_at = batch[ON_AT, k], batch[OFF_AT, k]
            batch[T, k], batch[IS_ON, k] = _square_crossing(
                drive, light, u_rise, u_fall, on_at, off_at, phase
            )


@njit(forceinline=True, **INNER)
def _steady_square(d: Drive, light: Any) -> tuple[Any, Any]:
    """Return u at the rising and the falling edge in the periodic steady state, in closed form.

    In each part of the period u goes to 1 / I as exp(-I t / q); both ends are those after which a period repeats u.
    """
    i_high = np.float32(d.ambient) + light * np.float32(d.w_high)
    i_low = np.float32(d.ambient) + light * np.float32(d.w_low)
    decay_high = exp32(-i_high * np.float32(d.high_us / d.q_us))
    decay_low = exp32(-i_low * np.float32((d.period_us - d.high_us) / d.q_us))
    bright, dark = _ONE / i_high, _ONE / i_low
    rise = dark * (_ONE - decay_low) + bright * (_ONE - decay_high) * decay_low
    u_rise = rise / (_ONE - decay_high * decay_low)
    return u_rise, bright + (u_rise - bright) * decay_high


@njit(forceinline=True, **INNER)
def _square_level(d: Drive, light: Any, u_rise: Any, u_fall: Any, phase: float) -> Any:
    """Return u at a phase: it relaxes towards 1 / I from its value at the last edge."""
    rising = phase >= d.high_us  # u rises in the low part
    i = np.float32(d.ambient) + light * np.float32(d.w_low if rising else d.w_high)
    since = np.float32((phase - (d.high_us if rising else 0.0)) / d.q_us)
    end = _ONE / i
    return end + ((u_fall if rising else u_rise) - end) * exp32(-since * i)


@njit(forceinline=True, **INNER)
def _square_crossing(
    d: Drive, light: Any, u_rise: Any, u_fall: Any, on_at: Any, off_at: Any, phase: float
) -> Any:
    """Search the present part of the period, then the part after it; beyond, everything repeats.

    Within a part u relaxes from its value at the part's start towards 1 / I and reaches the target after
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
