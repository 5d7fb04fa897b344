"""Next requests of the pixels: after a read, at the start, and under a new light or a new picture. Compiled functions.

A pixel that has been read takes a new reference at the end of its dead time. The pixels of a row are processed as a
batch in float32; if they are few, one by one. Under a square light, double precision is used for pixels that are read
at once and for crossings in the flat tail of an edge. ``readout`` decides when a row is read, and produces events.

In the tail of an edge u is almost flat. Where its logarithm changes by 1e-6 per microsecond, an error of 1e-6 moves an
event by a microsecond; elsewhere the errors of float32, some 1e-7, do no harm. Crossings in a tail are therefore
computed again with more digits. The first reference of a pixel remains a float32: where ln u changes by less than 1e-6
per microsecond, an event may still be off by a microsecond.
"""

from __future__ import annotations

from math import floor
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulators.pixels import photoreceptor as pr
from simulators.pixels.drive import Drive
from simulators.pixels.fast_math import INNER, INNER_KERNEL, JIT
from simulators.pixels.lower_digits import join_digits, lower_digits
from simulators.pixels.photoreceptor import fill_crossings, fill_levels, fill_steady_states, period_start
from simulators.pixels.pixel_noise import earlier_reset_error, reset_error, reset_errors, uniform
from simulators.pixels.sensor_state import (
    EPOCH,
    FREE,
    GAINS,
    ON_BITS,
    STORED_LIGHT,
    T_LIVE,
    U_REF,
    Pixels,
    Readout,
    update_minima,
)
from simulators.pixels.square_light import (
    crossing,
    fill_limit_distance,
    level,
    limit_distance,
    request_time,
    tail_width,
)

FEW: Final = 9
"""With fewer events, the pixels of a row are processed one by one, not as a batch, which has a fixed cost."""
LANES: Final = 16
"""The size of a batch is a multiple of this: the float32 of a vector register of 512 bits."""
_GAIN: Final = np.float32(1.0 / 65536.0)  # 2 to the power of -`ON_BITS`


@njit(forceinline=True, **INNER)
def firing_levels(u: Any, gains: Any) -> tuple[Any, Any]:
    """Return the levels at which a pixel fires; ``gains`` are ON and OFF in one uint32 (``sensor_state.ON_BITS``)."""
    on = np.float32(np.int32(gains & np.uint32(0xFFFF))) * _GAIN
    off = np.float32(np.int32(gains >> np.uint32(ON_BITS))) * _GAIN
    return u * on, u / off


@njit(forceinline=True, **INNER)
def _gains_of(gains: Any) -> tuple[float, float]:
    """Return the ON and the OFF gain of a pixel."""
    return np.int64(gains & np.uint32(0xFFFF)) / 65536.0, np.int64(gains >> np.uint32(ON_BITS)) / 65536.0


@njit(**INNER_KERNEL)
def _load(cell: NDArray[np.float32], column: NDArray[np.uint32], batch: NDArray[np.float32], n: int) -> None:
    """Load the stored light of the listed pixels of a row into the batch."""
    for k in range(n):
        batch[pr.LIGHT, k] = cell[column[k], STORED_LIGHT]


@njit(**INNER_KERNEL)
def _fill_firing_levels(
    gains: NDArray[np.uint32], column: NDArray[np.uint32], batch: NDArray[np.float32], n: int
) -> None:
    """Fill in the levels at which the pixels of the batch fire."""
    for k in range(n):
        batch[pr.ON_AT, k], batch[pr.OFF_AT, k] = firing_levels(batch[pr.U, k], gains[column[k], GAINS])


@njit(**INNER_KERNEL)
def _store(
    px_row: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint8]],
    column: NDArray[np.uint32],
    batch: NDArray[np.float32],
    n: int,
    start: float,
    live: float,
) -> None:
    """Store the references and the next crossings of the batch in the listed pixels of a row."""
    cell, t_next, is_on = px_row
    start32, live32 = np.float32(start), np.float32(live)
    for k in range(n):
        c = column[k]
        cell[c, U_REF] = batch[pr.U, k]
        cell[c, T_LIVE] = live32
        t_next[c] = max(live32, start32 + batch[pr.T, k])
        is_on[c] = np.uint8(batch[pr.IS_ON, k])


@njit(**INNER)
def cross_exactly(px: Pixels, drive: Drive, r: int, c: int, u: float, phase: float, start: float) -> None:
    """Set a pixel's next crossing by a reference in double precision, and store the reference with its lower digits."""
    on_gain, off_gain = _gains_of(px.gains[r, c, GAINS])
    cross, on = crossing(drive, px.cell[r, c, STORED_LIGHT], u * on_gain, u / off_gain, phase)
    px.cell[r, c, U_REF] = u
    px.is_on[r, c] = lower_digits(u, px.cell[r, c, U_REF]) | np.uint8(on)
    px.t_next[r, c] = max(px.cell[r, c, T_LIVE], np.float32(start + cross))


@njit(forceinline=True, **INNER)
def reset_pixel(
    px: Pixels,
    drive: Drive,
    ro: Readout,
    r: int,
    c: int,
    phase: float,
    start: float,
    random: NDArray[np.uint64],
) -> None:
    """Set one pixel's new reference at a phase, us, and its next crossing: ``reset_row`` for a single pixel."""
    light = px.cell[r, c, STORED_LIGHT]
    u_rise, u_fall = pr.steady_state(drive, light)
    error = reset_error(ro.normals, ro.reset_noise, random)
    u = pr.level_at(drive, light, u_rise, u_fall, phase) * error
    on_at, off_at = firing_levels(u, px.gains[r, c, GAINS])
    cross, on = pr.crossing(drive, light, u_rise, u_fall, on_at, off_at, phase)
    live = np.float32(start + phase)
    px.cell[r, c, U_REF] = u
    px.cell[r, c, T_LIVE] = live
    px.is_on[r, c] = np.uint8(on)
    px.t_next[r, c] = max(live, np.float32(start) + cross)
    if limit_distance(drive, light, on_at, off_at) < tail_width(drive):
        cross_exactly(px, drive, r, c, level(drive, light, phase) * error, phase, start)


@njit(**INNER)
def reset_at_once(
    px: Pixels, drive: Drive, ro: Readout, r: int, n: int, t: float, start: float, random: NDArray[np.uint64]
) -> None:
    """Reset a row's listed pixels, read at their request t, us after the epoch, under a square light: in double."""
    for k in range(n):
        c = np.int64(px.column[k])
        light, u_ref = px.cell[r, c, STORED_LIGHT], join_digits(px.cell[r, c, U_REF], px.is_on[r, c])
        on_gain, off_gain = _gains_of(px.gains[r, c, GAINS])
        on = px.is_on[r, c] & np.uint8(1) != 0
        target = u_ref * on_gain if on else u_ref / off_gain
        t_live = request_time(drive, light, target, on, t, start) + ro.dead_us
        live_start = start + floor((t_live - start) / drive.period_us) * drive.period_us
        phase = t_live - live_start
        u = level(drive, light, phase) * reset_error(ro.normals, ro.reset_noise, random)
        px.cell[r, c, T_LIVE] = t_live
        cross_exactly(px, drive, r, c, u, phase, live_start)


@njit(forceinline=True, **INNER)
def reset_row(
    px: Pixels, drive: Drive, ro: Readout, r: int, n: int, t: float, start: float, random: NDArray[np.uint64]
) -> None:
    """Set the listed pixels' references and next crossings after a read at t, us after the epoch."""
    t_live = t + ro.dead_us
    start += floor((t_live - start) / drive.period_us) * drive.period_us
    phase = t_live - start
    if n < FEW:
        for k in range(n):
            reset_pixel(px, drive, ro, r, np.int64(px.column[k]), phase, start, random)
        return
    whole = -(-n // LANES) * LANES  # the rest of the batch holds pixels of earlier rows, which are not stored
    _load(px.cell[r], px.column, px.batch, whole)
    fill_steady_states(drive, px.batch, whole)
    fill_levels(drive, px.batch, whole, phase)
    reset_errors(ro.normals, ro.reset_noise, random, px.batch[pr.U], n)
    _fill_firing_levels(px.gains[r], px.column, px.batch, whole)
    fill_crossings(drive, px.batch, whole, phase)
    _store((px.cell[r], px.t_next[r], px.is_on[r]), px.column, px.batch, n, start, t_live)
    width = tail_width(drive)
    if width > 0.0 and fill_limit_distance(drive, px.batch, n) < width:
        for k in range(n):
            if px.batch[pr.LIMIT_DISTANCE, k] < width:
                c = np.int64(px.column[k])
                u = level(drive, px.cell[r, c, STORED_LIGHT], phase)
                error = earlier_reset_error(ro.normals, ro.reset_noise, random, n - k)
                cross_exactly(px, drive, r, c, u * error, phase, start)


@njit(**JIT)
def set_picture(px: Pixels, drive: Drive, picture: NDArray[np.float32]) -> None:
    """Take the light of the pixels from a picture: (rows, width) float32, as shares of the light's drive."""
    for r in range(picture.shape[0]):
        for c in range(picture.shape[1]):
            px.cell[r, c, STORED_LIGHT] = pr.stored_light(drive, picture[r, c])


@njit(**JIT)
def start_pixels(
    px: Pixels, drive: Drive, ro: Readout, width: int, state: NDArray[np.float64], random: NDArray[np.uint64]
) -> None:
    """Reset every pixel as if its dead time ended now, at ``state[FREE]``."""
    t = state[FREE] - ro.dead_us
    start = period_start(drive, state[EPOCH], t)
    for r in range(px.t_next.shape[0]):
        for c in range(width):
            px.column[c] = c
        reset_row(px, drive, ro, r, width, t, start, random)
    update_minima(px)


@njit(**JIT)
def apply_change(
    px: Pixels,
    drive: Drive,
    width: int,
    t: float,
    step_us: float,
    state: NDArray[np.float64],
    random: NDArray[np.uint64],
) -> None:
    """Apply a new light or picture at t, us after the epoch: references stay, crossings are computed again."""
    batch = px.batch
    start = period_start(drive, state[EPOCH], t)
    for r in range(px.t_next.shape[0]):
        for c in range(width):
            batch[pr.LIGHT, c] = px.cell[r, c, STORED_LIGHT]
            aims = firing_levels(px.cell[r, c, U_REF], px.gains[r, c, GAINS])
            batch[pr.ON_AT, c], batch[pr.OFF_AT, c] = aims
        fill_steady_states(drive, batch, width)
        fill_levels(drive, batch, width, t - start)
        fill_crossings(drive, batch, width, t - start)
        fill_limit_distance(drive, batch, width)
        for c in range(width):
            if px.t_next[r, c] <= t:
                continue  # it already waits
            cross, on = start + batch[pr.T, c], batch[pr.IS_ON, c]
            u = batch[pr.U, c]
            if u <= batch[pr.ON_AT, c] or u >= batch[pr.OFF_AT, c]:
                cross, on = t + step_us * uniform(random), np.float32(u <= batch[pr.ON_AT, c])
            px.t_next[r, c] = max(np.float64(px.cell[r, c, T_LIVE]), cross)
            lower = px.is_on[r, c] & np.uint8(0xFE)
            px.is_on[r, c] = lower | np.uint8(on)
            if (
                batch[pr.LIMIT_DISTANCE, c] < tail_width(drive)
                and batch[pr.ON_AT, c] < u < batch[pr.OFF_AT, c]
            ):
                u_ref = join_digits(px.cell[r, c, U_REF], lower)
                cross_exactly(px, drive, r, c, u_ref, t - start, start)
    update_minima(px)
