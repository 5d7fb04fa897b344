"""Pixels that have been read: their new references, at the end of the dead time, and their next crossings.

A row's pixels are worked on as a batch, in float32; a few of a row one by one; and under a square light what is
served at once, or comes in the flat tail of an edge, in double precision. Compiled functions; they know the state
of the sensor's loop, and not when a row is read.
"""

from __future__ import annotations

from math import floor
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulators.pixels import photoreceptor as pr
from simulators.pixels import square_tail as tail
from simulators.pixels.drive import Drive
from simulators.pixels.fast_math import JIT, KERNEL
from simulators.pixels.photoreceptor import crossings, levels_at, steady_levels
from simulators.pixels.pixel_noise import earlier_error, reset_error, reset_errors
from simulators.pixels.sensor_state import GAINS, ON_BITS, PLACE, T_LIVE, U_REF, Pixels, Readout

FEW: Final = 9
"""Events of a row below which they are worked on one by one, not as a batch."""
LANES: Final = 16
"""Pixels are worked on in multiples of this many."""
_GAIN: Final = np.float32(1.0 / 65536.0)


@njit(inline="always", **JIT)
def targets(u: Any, gains: Any) -> tuple[Any, Any]:
    """Levels at which a pixel fires, from its reference and its gains."""
    on = np.float32(np.int32(gains & np.uint32(0xFFFF))) * _GAIN
    off = np.float32(np.int32(gains >> np.uint32(ON_BITS))) * _GAIN
    return u * on, u / off


@njit(inline="always", **JIT)
def _gains_of(gains: Any) -> tuple[float, float]:
    """ON and OFF gain of a pixel."""
    return np.int64(gains & np.uint32(0xFFFF)) / 65536.0, np.int64(gains >> np.uint32(ON_BITS)) / 65536.0


@njit(**KERNEL)
def _load(cell: NDArray, column: NDArray, batch: NDArray, n: int) -> None:
    """Fetch the places of the listed pixels of a row into the batch."""
    for k in range(n):
        batch[pr.LIGHT, k] = cell[column[k], PLACE]


@njit(**KERNEL)
def _aim(gains: NDArray, column: NDArray, batch: NDArray, n: int) -> None:
    """Fill in the levels at which the pixels of the batch fire."""
    for k in range(n):
        batch[pr.ON_AT, k], batch[pr.OFF_AT, k] = targets(batch[pr.U, k], gains[column[k], GAINS])


@njit(**KERNEL)
def _store(px_row: tuple, column: NDArray, batch: NDArray, n: int, start: float, live: float) -> None:
    """Put the references and the next crossings of the batch back to the listed pixels of a row."""
    cell, t_next, is_on = px_row
    start32, live32 = np.float32(start), np.float32(live)
    for k in range(n):
        c = column[k]
        cell[c, U_REF] = batch[pr.U, k]
        cell[c, T_LIVE] = live32
        t_next[c] = max(live32, start32 + batch[pr.T, k])
        is_on[c] = np.uint8(batch[pr.IS_ON, k])


@njit(**JIT)
def cross_exactly(px: Pixels, drive: Drive, r: int, c: int, u: float, phase: float, start: float) -> None:
    """Find a pixel's next crossing by a reference in double precision, whose lower digits are kept as well."""
    on_gain, off_gain = _gains_of(px.gains[r, c, GAINS])
    cross, on = tail.crossing(drive, px.cell[r, c, PLACE], u * on_gain, u / off_gain, phase)
    px.cell[r, c, U_REF] = u
    px.is_on[r, c] = tail.lower_digits(u, px.cell[r, c, U_REF]) | np.uint8(on)
    px.t_next[r, c] = max(px.cell[r, c, T_LIVE], np.float32(start + cross))


@njit(forceinline=True, **JIT)
def reset_pixel(
    px: Pixels, drive: Drive, ro: Readout, r: int, c: int, phase: float, start: float, random: NDArray
) -> None:
    """Give one pixel its new reference at a phase, and its next crossing: ``reset_row`` for a row of one."""
    light = px.cell[r, c, PLACE]
    u_rise, u_fall = pr.steady(drive, light)
    error = reset_error(ro.normals, ro.reset_noise, random)
    u = pr.level_at(drive, light, u_rise, u_fall, phase) * error
    on_at, off_at = targets(u, px.gains[r, c, GAINS])
    cross, on = pr.crossing(drive, light, u_rise, u_fall, on_at, off_at, phase)
    live = np.float32(start + phase)
    px.cell[r, c, U_REF] = u
    px.cell[r, c, T_LIVE] = live
    px.is_on[r, c] = np.uint8(on)
    px.t_next[r, c] = max(live, np.float32(start) + cross)
    if tail.to_end(drive, light, on_at, off_at) < tail.tail_width(drive):
        cross_exactly(px, drive, r, c, tail.level(drive, light, phase) * error, phase, start)


@njit(**JIT)
def reset_at_once(
    px: Pixels, drive: Drive, ro: Readout, r: int, n: int, t: float, start: float, random: NDArray
) -> None:
    """Reset the listed pixels of a row that asked at t and are served at once, under a square light: in double.

    They are one, but for pixels that are alike.
    """
    for k in range(n):
        c = np.int64(px.column[k])
        light, u_ref = px.cell[r, c, PLACE], tail.joined(px.cell[r, c, U_REF], px.is_on[r, c])
        on_gain, off_gain = _gains_of(px.gains[r, c, GAINS])
        on = px.is_on[r, c] & np.uint8(1) != 0
        target = u_ref * on_gain if on else u_ref / off_gain
        t_live = tail.asked_at(drive, light, target, on, t, start) + ro.dead_us
        live_start = start + floor((t_live - start) / drive.period_us) * drive.period_us
        phase = t_live - live_start
        u = tail.level(drive, light, phase) * reset_error(ro.normals, ro.reset_noise, random)
        px.cell[r, c, T_LIVE] = t_live
        cross_exactly(px, drive, r, c, u, phase, live_start)


@njit(forceinline=True, **JIT)
def reset_row(
    px: Pixels, drive: Drive, ro: Readout, r: int, n: int, t: float, start: float, random: NDArray
) -> None:
    """Give the listed pixels of a row their new references, at the end of the dead time, and next crossings.

    Parameters
    ----------
    t
        When the row is read.
    start
        Start of a period of the light not after ``t``.
    """
    t_live = t + ro.dead_us
    start += floor((t_live - start) / drive.period_us) * drive.period_us
    phase = t_live - start
    if n < FEW:
        for k in range(n):
            reset_pixel(px, drive, ro, r, np.int64(px.column[k]), phase, start, random)
        return
    whole = -(-n // LANES) * LANES  # the rest of the batch holds pixels of former rows: harmless
    _load(px.cell[r], px.column, px.batch, whole)
    steady_levels(drive, px.batch, whole)
    levels_at(drive, px.batch, whole, phase)
    reset_errors(ro.normals, ro.reset_noise, random, px.batch[pr.U], n)
    _aim(px.gains[r], px.column, px.batch, whole)
    crossings(drive, px.batch, whole, phase)
    _store((px.cell[r], px.t_next[r], px.is_on[r]), px.column, px.batch, n, start, t_live)
    width = tail.tail_width(drive)
    if tail.fill_to_end(drive, px.batch, n) < width:
        for k in range(n):
            if px.batch[pr.TO_END, k] < width:
                c = np.int64(px.column[k])
                u = tail.level(drive, px.cell[r, c, PLACE], phase)
                error = earlier_error(ro.normals, ro.reset_noise, random, n - k)
                cross_exactly(px, drive, r, c, u * error, phase, start)
