"""The sensor's loop in compiled form: pixels that cross thresholds, rows that are read, the link that is full.

The oldest request is served first; all pixels of a row that wait are read together, with one timestamp, and
each takes its new reference from the light *then*: what the light did while the pixel waited is lost. A full
link stops the arbiter, so pixels wait longer. Knows arrays and numbers only; what they mean, and where they
come from, is said in ``pixels``. Times are microseconds after the epoch, the moment to which the float32
times of the pixels are relative.
"""

from __future__ import annotations

from math import floor, log
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulators import photoreceptor as pr
from simulators.drive import Drive
from simulators.fast_math import JIT
from simulators.photoreceptor import crossings, levels_at, period_start
from simulators.sensor_state import (
    AHEAD,
    BLOCK,
    EPOCH,
    FIFO,
    FIFO_T,
    FREE,
    FULL,
    GAIN_OFF,
    GAIN_ON,
    GROUP,
    IS_ON,
    LIGHT,
    NOISE,
    QUEUE,
    STALL,
    T_LIVE,
    U_FALL,
    U_REF,
    U_RISE,
    Pixels,
    Readout,
    oldest_row,
    smallest,
    update_minima,
    update_row,
)

VECTOR_FROM: Final = 5
"""Events of a block from which on the sensor sends them as a vector."""
VECTOR_WORDS: Final = 4
FEW: Final = 4
"""Events of a row below which they are worked on one by one, not as a batch."""
LONGEST_ROW_WORDS: Final = 512
"""Room the link must have before a row is read."""


@njit(inline="always", **JIT)
def _random(s: NDArray) -> np.uint64:
    """Next 64 random bits (xorshift128+; Vigna 2014)."""
    a, b = s[0], s[1]
    s[0] = b
    a ^= a << np.uint64(23)
    a ^= (a >> np.uint64(18)) ^ b ^ (b >> np.uint64(5))
    s[1] = a
    return a + b


@njit(inline="always", **JIT)
def _uniform(s: NDArray) -> float:
    """Uniform in (0, 1)."""
    return (np.int64(_random(s) >> np.uint64(11)) + 0.5) * (1.0 / 9007199254740992.0)


@njit(**JIT)
def draw_noise(px: Pixels, ro: Readout, width: int, after: float, random: NDArray) -> Any:
    """Draw the next background and hot-pixel events; return a number that means nothing.

    They are drawn many at a time, and their pixels touched: memory then serves many at once, and has them
    ready when their time comes.
    """
    n = ro.alias_share.size
    t = after
    for k in range(AHEAD):
        t -= log(_uniform(random)) / ro.noise_rate_us
        bits = _random(random)
        i = np.int64(((bits >> np.uint64(32)) * np.uint64(n)) >> np.uint64(32))
        share = np.float32(np.int64(bits & np.uint64(0xFFFFFF)) * (1.0 / 16777216.0))
        px.noise_t[k] = t
        px.noise_at[k] = 2 * (i if share < ro.alias_share[i] else np.int64(ro.alias_other[i]))
        px.noise_at[k] += np.int64((bits >> np.uint64(24)) & np.uint64(1))
    touched = np.float32(0.0)
    for k in range(AHEAD):
        i = px.noise_at[k] >> 1
        touched += px.cell[i // width, i % width, T_LIVE] + px.t_next[i // width, i % width]
    return touched


@njit(forceinline=True, **JIT)
def _place_noise(px: Pixels, at: int, width: int, t: float) -> None:
    """Let a pixel request a read at t, unless it is dead or waits already."""
    r, c = (at >> 1) // width, (at >> 1) % width
    if t < px.cell[r, c, T_LIVE] or px.t_next[r, c] <= t:
        return
    px.t_next[r, c] = t
    px.cell[r, c, IS_ON] = at & 1
    b = c // BLOCK
    t32 = px.t_next[r, c]
    px.block_min[r, b] = min(px.block_min[r, b], t32)
    px.row_min[r] = min(px.row_min[r], t32)
    px.group_min[r // GROUP] = min(px.group_min[r // GROUP], t32)


@njit(inline="always", **JIT)
def _block_words(n: int) -> int:
    """EVT3 words of n events of one polarity in a block: single events, or a vector triple with its base."""
    return n if n < VECTOR_FROM else VECTOR_WORDS


@njit(forceinline=True, **JIT)
def _gather_row(px: Pixels, r: int, t: float) -> tuple[int, int]:
    """List the waiting pixels of a row in ``px.column``; return their number and that of their EVT3 words."""
    n, words = 0, 2
    t32 = np.float32(t)
    for b in range(px.block_min.shape[1]):
        if px.block_min[r, b] > t32:
            continue
        before, n_on = n, 0
        for c in range(b * BLOCK, (b + 1) * BLOCK):
            if px.t_next[r, c] <= t32:
                px.column[n] = c
                n += 1
                n_on += px.cell[r, c, IS_ON] != 0.0
        words += _block_words(n_on) + _block_words(n - before - n_on)
    return n, words


@njit(forceinline=True, **JIT)
def _emit_row(px: Pixels, r: int, n: int, stamp: int, out: tuple, first: int) -> None:
    """Write a row's events: ON first, then OFF, each from left to right."""
    ts, xs, ys, ps = out
    i = first
    for on in (1, 0):
        for k in range(n):
            if (px.cell[r, px.column[k], IS_ON] != 0.0) == (on == 1):
                ts[i], xs[i], ys[i], ps[i] = stamp, px.column[k], r, on
                i += 1


@njit(inline="always", **JIT)
def _reset_error(ro: Readout, random: NDArray) -> Any:
    """Factor on u of a new reference: noise of the reset, in units of log intensity."""
    if ro.reset_noise == 0.0:
        return np.float32(1.0)
    return (
        np.float32(1.0) + np.float32(ro.reset_noise) * ro.normals[np.int64(_random(random) >> np.uint64(52))]
    )


@njit(forceinline=True, **JIT)
def _reset_pixel(
    px: Pixels, drive: Drive, ro: Readout, r: int, c: int, phase: float, start: float, random: NDArray
) -> None:
    """Give one pixel its new reference at a phase, and its next crossing: ``_reset_row`` for a row of one."""
    light, u_rise, u_fall = px.cell[r, c, LIGHT], px.cell[r, c, U_RISE], px.cell[r, c, U_FALL]
    u = pr.level_at(drive, light, u_rise, u_fall, phase) * _reset_error(ro, random)
    on_at, off_at = u * px.cell[r, c, GAIN_ON], u * px.cell[r, c, GAIN_OFF]
    cross, on = pr.crossing(drive, light, u_rise, u_fall, on_at, off_at, phase)
    live = np.float32(start + phase)
    px.cell[r, c, U_REF] = u
    px.cell[r, c, T_LIVE] = live
    px.cell[r, c, IS_ON] = on
    px.t_next[r, c] = max(live, np.float32(start) + cross)


@njit(forceinline=True, **JIT)
def _reset_row(
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
            _reset_pixel(px, drive, ro, r, px.column[k], phase, start, random)
        return
    batch, column = px.batch, px.column
    for k in range(n):
        c = column[k]
        batch[pr.LIGHT, k], batch[pr.U_RISE, k] = px.cell[r, c, LIGHT], px.cell[r, c, U_RISE]
        batch[pr.U_FALL, k] = px.cell[r, c, U_FALL]
        batch[pr.ON_AT, k], batch[pr.OFF_AT, k] = px.cell[r, c, GAIN_ON], px.cell[r, c, GAIN_OFF]
    levels_at(drive, batch, n, phase)
    for k in range(n):
        batch[pr.U, k] *= _reset_error(ro, random)
        batch[pr.ON_AT, k] *= batch[pr.U, k]
        batch[pr.OFF_AT, k] *= batch[pr.U, k]
    crossings(drive, batch, n, phase)
    start32, live32 = np.float32(start), np.float32(t_live)
    for k in range(n):
        c = column[k]
        px.cell[r, c, U_REF] = batch[pr.U, k]
        px.cell[r, c, T_LIVE] = live32
        px.cell[r, c, IS_ON] = batch[pr.IS_ON, k]
        px.t_next[r, c] = max(live32, start32 + batch[pr.T, k])


@njit(forceinline=True, **JIT)
def _update_blocks(px: Pixels, r: int, t: float) -> None:
    """Earliest requests of the blocks of a row that were read at t, and of the row."""
    t32 = np.float32(t)
    for b in range(px.block_min.shape[1]):
        if px.block_min[r, b] <= t32:
            px.block_min[r, b] = smallest(px.t_next[r, b * BLOCK : (b + 1) * BLOCK])
    update_row(px, r)


@njit(**JIT)
def read_rows(
    px: Pixels,
    drive: Drive,
    ro: Readout,
    state: NDArray,
    random: NDArray,
    until: float,
    width: int,
    out: tuple,
) -> int:
    """Run the sensor's loop up to a time, or until the output is nearly full.

    Parameters
    ----------
    until
        End, us after the epoch, exclusive.
    width
        Columns of the sensor.
    out
        t (int64, sensor time), x, y (uint16), p (uint8): arrays of equal length, filled from the start.

    Returns
    -------
    Number of events written. The state and the pixels carry on: calling again goes on exactly there. When
    the output was nearly full before ``until``, ``state[FULL]`` is 1.
    """
    room = out[0].size - width
    start = period_start(drive, state[EPOCH], state[FREE])
    n = 0
    state[FULL] = 0.0
    while True:
        r = oldest_row(px)
        t = max(np.float64(px.row_min[r]), state[FREE])
        # The link drains while the arbiter waits for room for the longest row.
        t_link = state[FIFO_T] + (state[FIFO] + LONGEST_ROW_WORDS - ro.fifo_words) / ro.link_words_us
        stall = max(0.0, t_link - t)
        t += stall
        if min(t, state[NOISE]) >= until:
            break
        if state[NOISE] <= t:
            queue = int(state[QUEUE])
            _place_noise(px, px.noise_at[queue], width, state[NOISE])
            if queue + 1 == AHEAD:
                draw_noise(px, ro, width, state[NOISE], random)
                queue = -1
            state[QUEUE] = queue + 1
            state[NOISE] = px.noise_t[queue + 1]
            continue
        if n > room:
            state[FULL] = 1.0
            break
        if t - start >= drive.period_us:
            start = period_start(drive, state[EPOCH], t)
        n_row, words = _gather_row(px, r, t)
        _emit_row(px, r, n_row, np.int64(floor(state[EPOCH] + t)), out, n)
        _reset_row(px, drive, ro, r, n_row, t, start, random)
        _update_blocks(px, r, t)
        n += n_row
        state[FREE] = t + ro.row_us + n_row * ro.event_us
        state[FIFO] = max(0.0, state[FIFO] - (t - state[FIFO_T]) * ro.link_words_us) + words
        state[FIFO_T] = t
        state[STALL] += stall
    return n


# ---------------------------------------------------------------- beginning and changing


@njit(**JIT)
def see(px: Pixels, drive: Drive, picture: NDArray) -> None:
    """Take over a picture, (rows, width), and find each pixel's steady state under the light."""
    batch = px.batch
    width = picture.shape[1]
    for r in range(picture.shape[0]):
        for c in range(width):
            batch[pr.LIGHT, c] = picture[r, c]
        pr.steady_levels(drive, batch, width)
        for c in range(width):
            px.cell[r, c, LIGHT] = batch[pr.LIGHT, c]
            px.cell[r, c, U_RISE], px.cell[r, c, U_FALL] = batch[pr.U_RISE, c], batch[pr.U_FALL, c]


@njit(**JIT)
def start_pixels(px: Pixels, drive: Drive, ro: Readout, width: int, state: NDArray, random: NDArray) -> None:
    """Set every pixel as if its dead time ended now, ``state[FREE]``."""
    t = state[FREE] - ro.dead_us
    start = period_start(drive, state[EPOCH], t)
    for r in range(px.t_next.shape[0]):
        for c in range(width):
            px.column[c] = c
        _reset_row(px, drive, ro, r, width, t, start, random)
    update_minima(px)


@njit(**JIT)
def redrive(
    px: Pixels, drive: Drive, width: int, t: float, step_us: float, state: NDArray, random: NDArray
) -> None:
    """Let a new light or a new picture take effect at t: references stay, next crossings are found anew.

    A pixel that the change itself carries beyond its threshold requests at a random time of the step.
    """
    batch = px.batch
    start = period_start(drive, state[EPOCH], t)
    for r in range(px.t_next.shape[0]):
        for c in range(width):
            batch[pr.LIGHT, c] = px.cell[r, c, LIGHT]
            batch[pr.U_RISE, c], batch[pr.U_FALL, c] = px.cell[r, c, U_RISE], px.cell[r, c, U_FALL]
            batch[pr.ON_AT, c] = px.cell[r, c, U_REF] * px.cell[r, c, GAIN_ON]
            batch[pr.OFF_AT, c] = px.cell[r, c, U_REF] * px.cell[r, c, GAIN_OFF]
        levels_at(drive, batch, width, t - start)
        crossings(drive, batch, width, t - start)
        for c in range(width):
            if px.t_next[r, c] <= t:
                continue  # it waits already
            cross, on = start + batch[pr.T, c], batch[pr.IS_ON, c]
            u = batch[pr.U, c]
            if u <= batch[pr.ON_AT, c] or u >= batch[pr.OFF_AT, c]:
                cross, on = t + step_us * _uniform(random), np.float32(u <= batch[pr.ON_AT, c])
            px.t_next[r, c] = max(np.float64(px.cell[r, c, T_LIVE]), cross)
            px.cell[r, c, IS_ON] = on
    update_minima(px)
