"""Compiled loop of the sensor: pixels cross thresholds, rows are read, and the link may be full.

The oldest request is served first. All waiting pixels of a row are read together, with one timestamp. Each takes its
new reference from the light *then*: changes of the light while the pixel waited are lost. A full link stops the
arbiter, so pixels wait longer. Finateu et al. (2020) describe the chip; the timing model here is simpler. This module
works on arrays and numbers only; ``sensor`` builds them. Times are microseconds after the epoch, the moment to which
the float32 times of the pixels are relative.
"""

from __future__ import annotations

from math import floor
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulators.pixels import photoreceptor as pr
from simulators.pixels import square_tail as tail
from simulators.pixels.drive import SQUARE, Drive
from simulators.pixels.fast_math import JIT
from simulators.pixels.lanes import BLOCK, count_bits, list_bits, prefetch, smallest, waiting
from simulators.pixels.photoreceptor import fill_crossings, fill_levels, fill_steady_states, period_start
from simulators.pixels.pixel_noise import draw_arrivals, uniform
from simulators.pixels.pixel_reset import cross_exactly, firing_levels, reset_at_once, reset_pixel, reset_row
from simulators.pixels.sensor_state import (
    AHEAD,
    EPOCH,
    FIFO,
    FIFO_T,
    FREE,
    FULL,
    GAINS,
    GROUP,
    NOISE,
    QUEUE,
    STALL,
    STORED_LIGHT,
    T_LIVE,
    U_REF,
    Pixels,
    Readout,
    retime,
    row_at,
    update_minima,
    update_row,
)

VECTOR_FROM: Final = 5
"""Smallest number of events of a block that the sensor sends as a vector."""
VECTOR_WORDS: Final = 4
LONE_WORDS: Final = 3
"""EVT3 words of an event that is read on its own."""
LONGEST_ROW_WORDS: Final = 512
"""Free words that the link must have before a row is read."""

EventArrays = tuple[NDArray[np.int64], NDArray[np.uint16], NDArray[np.uint16], NDArray[np.uint8]]
"""t in us, x, y and p of events."""


@njit(**JIT)
def draw_noise(px: Pixels, ro: Readout, width: int, after: float, random: NDArray[np.uint64]) -> Any:
    """Draw the next background and hot-pixel events.

    Many are drawn at a time, and their pixels are read from memory at once: this is faster than one after the other,
    and the pixels are in the cache when their events come.

    Parameters
    ----------
    px
        Pixels; ``noise_t`` and ``noise_at`` are filled in.
    ro
        Readout, for the noise rates.
    width
        Columns of the sensor.
    after
        Time of the last event drawn, us after the epoch.
    random
        (2,) uint64, generator; its counter advances.

    Returns
    -------
    float32
        A number without meaning, which keeps the compiler from removing the memory reads.
    """
    draw_arrivals(ro.alias, ro.noise_rate_us, after, random, px.noise_t, px.noise_at)
    touched = np.float32(0.0)
    for k in range(AHEAD):
        r, c = (px.noise_at[k] >> 1) // width, (px.noise_at[k] >> 1) % width
        touched += px.cell[r, c, T_LIVE] + px.t_next[r, c]
    return touched


@njit(forceinline=True, **JIT)
def _place_noise(px: Pixels, at: int, width: int, t: float) -> None:
    """Let a pixel request a read at t, unless it is in its dead time or waits already."""
    r, c = (at >> 1) // width, (at >> 1) % width
    if t < px.cell[r, c, T_LIVE] or px.t_next[r, c] <= t:
        return
    px.t_next[r, c] = t
    px.is_on[r, c] = at & 1
    b = c // BLOCK
    t32 = px.t_next[r, c]
    px.block_min[r, b] = min(px.block_min[r, b], t32)
    px.row_min[r] = min(px.row_min[r], t32)
    px.group_min[r // GROUP] = min(px.group_min[r // GROUP], t32)


@njit(inline="always", **JIT)
def _block_words(n: int) -> int:
    """Return the EVT3 words of n events of one polarity in a block: single events, or a vector triple with its base."""
    return n if n < VECTOR_FROM else VECTOR_WORDS


@njit(forceinline=True, **JIT)
def _find_blocks(px: Pixels, r: int, t32: Any) -> int:
    """List the blocks of a row in which pixels wait in ``px.asked``, and ask for their memory; return their number."""
    n = 0
    for b in range(px.block_min.shape[1]):
        px.asked[n] = b
        n += px.block_min[r, b] <= t32
    start = r * px.t_next.shape[1]
    for k in range(n):
        first = start + np.int64(px.asked[k]) * BLOCK
        prefetch(px.t_next, first)
        prefetch(px.t_next, first + BLOCK // 2)
        prefetch(px.is_on, first)
    return n


@njit(forceinline=True, **JIT)
def _gather_row(px: Pixels, r: int, t32: Any, blocks: int, xs: NDArray[np.uint16]) -> Any:
    """List the waiting pixels of a row in ``px.column``; return their number, how many are ON, and their words.

    The columns of ON events are written to ``xs``, those of OFF events to ``px.off_column``.
    """
    n, n_on, words = np.int64(0), np.int64(0), np.int64(2)
    t_next, is_on = px.t_next[r], px.is_on[r]
    for k in range(blocks):
        first = np.int64(px.asked[k]) * BLOCK
        asking, on = waiting(t_next[first : first + BLOCK], is_on[first : first + BLOCK], t32)
        off = asking & ~on
        here, on_here = np.int64(count_bits(asking)), np.int64(count_bits(on))
        list_bits(asking, np.uint64(first), px.column, np.uint64(n))
        list_bits(on, np.uint64(first), xs, np.uint64(n_on))
        list_bits(off, np.uint64(first), px.off_column, np.uint64(n - n_on))
        n += here
        n_on += on_here
        words += _block_words(on_here) + _block_words(here - on_here)
    return n, n_on, words


@njit(forceinline=True, **JIT)
def _emit_row(px: Pixels, r: int, n: int, n_on: int, stamp: int, out: EventArrays) -> None:
    """Write a row's events, whose ON columns are written: ON first, then OFF, each from left to right."""
    ts, xs, ys, ps = out
    off = xs[n_on:n]
    for k in range(off.size):
        off[k] = px.off_column[k]
    for k in range(n):
        ts[k] = stamp
    for k in range(n):
        ys[k] = r
    for k in range(n):
        ps[k] = k < n_on


@njit(forceinline=True, **JIT)
def _update_blocks(px: Pixels, r: int, blocks: int) -> None:
    """Update the earliest requests of the listed blocks of a row, and of the row."""
    for k in range(blocks):
        b = np.int64(px.asked[k])
        px.block_min[r, b] = smallest(px.t_next[r, b * BLOCK : (b + 1) * BLOCK])
    update_row(px, r)


@njit(forceinline=True, **JIT)
def _next_noise(
    px: Pixels, ro: Readout, width: int, state: NDArray[np.float64], random: NDArray[np.uint64]
) -> None:
    """Advance to the next background or hot-pixel event."""
    queue = int(state[QUEUE])
    if queue + 1 == AHEAD:
        draw_noise(px, ro, width, state[NOISE], random)
        queue = -1
    state[QUEUE] = queue + 1
    state[NOISE] = px.noise_t[queue + 1]


@njit(forceinline=True, **JIT)
def _read_alone(
    px: Pixels,
    drive: Drive,
    ro: Readout,
    at: int,
    width: int,
    state: NDArray[np.float64],
    start: float,
    random: NDArray[np.uint64],
    out: EventArrays,
    n: int,
) -> int:
    """Read the one pixel that a noise event makes request while nothing else waits; return the events written."""
    r, c = (at >> 1) // width, (at >> 1) % width
    t = state[NOISE]
    if t < px.cell[r, c, T_LIVE]:
        return 0
    ts, xs, ys, ps = out
    ts[n], xs[n], ys[n], ps[n] = np.int64(floor(state[EPOCH] + t)), c, r, at & 1
    t_live = t + ro.dead_us
    start += floor((t_live - start) / drive.period_us) * drive.period_us
    before = px.t_next[r, c]
    reset_pixel(px, drive, ro, r, c, t_live - start, start, random)
    retime(px, r, c, before)
    _account(state, ro, t, 1, LONE_WORDS)
    return 1


@njit(forceinline=True, **JIT)
def _account(state: NDArray[np.float64], ro: Readout, t: float, n: int, words: int) -> None:
    """Keep the arbiter and the link busy for a row read at t."""
    state[FREE] = t + ro.row_us + n * ro.event_us
    state[FIFO] = max(0.0, state[FIFO] - (t - state[FIFO_T]) * ro.link_words_us) + words
    state[FIFO_T] = t


@njit(**JIT)
def read_rows(
    px: Pixels,
    drive: Drive,
    ro: Readout,
    state: NDArray[np.float64],
    random: NDArray[np.uint64],
    until: float,
    width: int,
    out: EventArrays,
) -> int:
    """Run the sensor's loop up to a time, or until the output is nearly full.

    Parameters
    ----------
    px
        Pixels, changed in place.
    drive
        Light.
    ro
        Dead time, arbiter, link and noise.
    state
        (N_STATE,) float64, state of the loop, changed in place. ``state[FULL]`` is 1 if the output was nearly full
        before ``until``.
    random
        (2,) uint64, generator; its counter advances.
    until
        End, us after the epoch, exclusive.
    width
        Columns of the sensor.
    out
        t (int64, sensor time), x, y (uint16), p (uint8): arrays of equal length, filled from the start.

    Returns
    -------
    int
        Number of events written. The next call continues exactly there.
    """
    room = out[0].size - width - BLOCK
    start = period_start(drive, state[EPOCH], state[FREE])
    n = 0
    state[FULL] = 0.0
    while True:
        oldest = np.float64(smallest(px.group_min))
        # The link drains while the arbiter waits for room for the longest row.
        t_link = state[FIFO_T] + (state[FIFO] + LONGEST_ROW_WORDS - ro.fifo_words) / ro.link_words_us
        t = max(oldest, state[FREE], t_link)
        if min(t, state[NOISE]) >= until:
            break
        if n > room:
            state[FULL] = 1.0
            break
        if min(t, state[NOISE]) - start >= drive.period_us:
            start = period_start(drive, state[EPOCH], min(t, state[NOISE]))
        if state[NOISE] <= t:
            at = px.noise_at[int(state[QUEUE])]
            if state[NOISE] < oldest and max(state[FREE], t_link) <= state[NOISE]:
                n += _read_alone(px, drive, ro, at, width, state, start, random, out, n)
            else:
                _place_noise(px, at, width, state[NOISE])
            _next_noise(px, ro, width, state, random)
            continue
        r = row_at(px, smallest(px.group_min))
        blocks = _find_blocks(px, r, np.float32(t))
        ts, xs, ys, ps = out
        here = ts[n:], xs[n:], ys[n:], ps[n:]
        n_row, n_on, words = _gather_row(px, r, np.float32(t), blocks, here[1])
        _emit_row(px, r, n_row, n_on, np.int64(floor(state[EPOCH] + t)), here)
        if t == oldest and drive.kind == SQUARE:
            reset_at_once(px, drive, ro, r, n_row, t, start, random)
        else:
            reset_row(px, drive, ro, r, n_row, t, start, random)
        _update_blocks(px, r, blocks)
        n += n_row
        state[STALL] += max(0.0, t_link - max(oldest, state[FREE]))
        _account(state, ro, t, n_row, words)
    return n


# ---------------------------------------------------------------- start and changes


@njit(**JIT)
def set_picture(px: Pixels, drive: Drive, picture: NDArray[np.float32]) -> None:
    """Store a picture as the light of the pixels.

    Parameters
    ----------
    px
        Pixels, changed in place.
    drive
        Light.
    picture
        (rows, width) float32, share of the light's drive that reaches each pixel.
    """
    for r in range(picture.shape[0]):
        for c in range(picture.shape[1]):
            px.cell[r, c, STORED_LIGHT] = pr.stored_light(drive, picture[r, c])


@njit(**JIT)
def start_pixels(
    px: Pixels, drive: Drive, ro: Readout, width: int, state: NDArray[np.float64], random: NDArray[np.uint64]
) -> None:
    """Reset every pixel as if its dead time ended now, at ``state[FREE]``.

    Parameters
    ----------
    px
        Pixels, changed in place.
    drive
        Light.
    ro
        Readout, for dead time and noise of the reset.
    width
        Columns of the sensor.
    state
        (N_STATE,) float64, state of the loop.
    random
        (2,) uint64, generator; its counter advances.
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

    Parameters
    ----------
    px
        Pixels, changed in place.
    drive
        New light.
    width
        Columns of the sensor.
    t
        Time of the change, us after the epoch.
    step_us
        Time over which the change is spread.
    state
        (N_STATE,) float64, state of the loop.
    random
        (2,) uint64, generator; its counter advances.
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
