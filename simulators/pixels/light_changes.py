"""The pixels at the start, and under a new light or a new picture: compiled functions.

They set every pixel's next request; ``readout`` then runs the sensor. They do not produce events.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulators.pixels import photoreceptor as pr
from simulators.pixels import square_tail as tail
from simulators.pixels.drive import Drive
from simulators.pixels.fast_math import JIT
from simulators.pixels.photoreceptor import fill_crossings, fill_levels, fill_steady_states, period_start
from simulators.pixels.pixel_noise import uniform
from simulators.pixels.pixel_reset import cross_exactly, firing_levels, reset_row
from simulators.pixels.sensor_state import (
    EPOCH,
    FREE,
    GAINS,
    STORED_LIGHT,
    T_LIVE,
    U_REF,
    Pixels,
    Readout,
    update_minima,
)


@njit(**JIT)
def set_picture(px: Pixels, drive: Drive, picture: NDArray[np.float32]) -> None:
    """Store a picture as the light of the pixels.

    picture: (rows, width) float32, share of the light's drive that reaches each pixel.
    """
    for r in range(picture.shape[0]):
        for c in range(picture.shape[1]):
            px.cell[r, c, STORED_LIGHT] = pr.stored_light(drive, picture[r, c])


@njit(**JIT)
def start_pixels(
    px: Pixels, drive: Drive, ro: Readout, width: int, state: NDArray[np.float64], random: NDArray[np.uint64]
) -> None:
    """Reset every pixel as if its dead time ended now, at ``state[FREE]``.

    state: (N_STATE,) float64, state of the loop.
    random: (2,) uint64, generator; its counter advances.
    """
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
    """Apply a new light or a new picture at t: references stay, and next crossings are computed again.

    A pixel that the change itself carries beyond its threshold requests at a random time within the step.

    t: Time of the change, us after the epoch.
    state: (N_STATE,) float64, state of the loop.
    random: (2,) uint64, generator; its counter advances.
    """
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
        tail.fill_limit_distance(drive, batch, width)
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
                batch[pr.LIMIT_DISTANCE, c] < tail.tail_width(drive)
                and batch[pr.ON_AT, c] < u < batch[pr.OFF_AT, c]
            ):
                u_ref = tail.join_digits(px.cell[r, c, U_REF], lower)
                cross_exactly(px, drive, r, c, u_ref, t - start, start)
    update_minima(px)
