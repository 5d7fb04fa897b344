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

from simulators.pixels.drive import SQUARE, Drive
from simulators.pixels.fast_math import INNER, JIT
from simulators.pixels.photoreceptor import period_start
from simulators.pixels.pixel_noise import draw_arrivals
from simulators.pixels.pixel_reset import reset_at_once, reset_pixel, reset_row
from simulators.pixels.sensor_state import (
    AHEAD,
    BLOCK,
    EPOCH,
    FIFO,
    FIFO_T,
    FREE,
    FULL,
    GROUP,
    NOISE,
    QUEUE,
    STALL,
    T_LIVE,
    Pixels,
    Readout,
    retime,
    row_at,
    smallest,
)

VECTOR_FROM: Final = 5
"""Smallest number of events of a block that the sensor sends as a vector."""
VECTOR_WORDS: Final = 4  # The base, and three of bits
LONE_WORDS: Final = 3
"""EVT3 words of an event that is read on its own."""
LONGEST_ROW_WORDS: Final = 512
"""Free words that the link must have before a row is read."""

SHORT: Final = 8
"""Rows of no more events are written in one go."""

EventArrays = tuple[NDArray[np.int64], NDArray[np.uint16], NDArray[np.uint16], NDArray[np.uint8]]
"""t in us, x, y and p of events."""


@njit(**JIT)
def draw_noise(px: Pixels, ro: Readout, after: float, random: NDArray[np.uint64]) -> None:
    """Draw the next background and hot-pixel events into ``noise_t`` and ``noise_at``, ``after`` us after the epoch."""
    draw_arrivals(ro.alias, ro.noise_rate_us, after, random, px.noise_t, px.noise_at)


@njit(forceinline=True, **INNER)
def _place_noise(px: Pixels, at: int, width: int, t: float) -> Any:
    """Let a pixel request a read at t, unless it is in its dead time or waits already; return its time, else inf."""
    r, c = (at >> 1) // width, (at >> 1) % width
    if t < px.cell[r, c, T_LIVE] or px.t_next[r, c] <= t:
        return np.float32(np.inf)
    t32 = np.float32(t)
    px.t_next[r, c] = t32
    px.is_on[r, c] = at & 1
    b = c // BLOCK
    px.block_min[r, b] = min(px.block_min[r, b], t32)
    px.row_min[r] = min(px.row_min[r], t32)
    px.group_min[r // GROUP] = min(px.group_min[r // GROUP], t32)
    return t32


@njit(forceinline=True, **INNER)
def _block_words(n: int) -> int:
    """Return the EVT3 words of n events of one polarity in a block: single events, or a vector triple with its base."""
    return n if n < VECTOR_FROM else VECTOR_WORDS


@njit(forceinline=True, **INNER)
def _find_blocks(px: Pixels, r: int, t32: Any) -> int:
    """List the blocks of a row in which pixels wait in ``px.asked``; return their number.

    The earliest requests of these blocks, of the row and of its group become infinite: `_update_blocks` sets them
    again. Set so early, they do not delay the search for the earliest ones.
    """
    n, blocks = 0, px.block_min[r]
    for b in range(blocks.size):
        px.asked[n] = b
        n += blocks[b] <= t32
    for k in range(n):
        blocks[np.int64(px.asked[k])] = np.inf
    px.row_min[r] = np.inf
    px.group_min[r // GROUP] = np.inf
    return n


@njit(forceinline=True, **INNER)
def _gather_row(px: Pixels, r: int, t32: Any, blocks: int, xs: NDArray[np.uint16]) -> Any:
    """List a row's waiting pixels in ``px.column``, ON columns in ``xs``; return their number, how many ON, words."""
    n, n_on, words = np.int64(0), np.int64(0), np.int64(2)
    t_next, is_on = px.t_next[r], px.is_on[r]
    for k in range(blocks):
        first = np.int64(px.asked[k]) * BLOCK
        before, before_on = n, n_on
        for c in range(first, first + BLOCK):
            # Written without a branch: a column that does not wait is overwritten by the next one.
            asks = np.int64(t_next[c] <= t32)
            on = np.int64(is_on[c] & np.uint8(1)) & asks
            px.column[n] = xs[n_on] = px.off_column[n - n_on] = c
            n += asks
            n_on += on
        here, on_here = n - before, n_on - before_on
        words += _block_words(on_here) + _block_words(here - on_here)
    return n, n_on, words


@njit(forceinline=True, **INNER)
def _emit_row(px: Pixels, r: int, n: int, n_on: int, stamp: int, out: EventArrays) -> None:
    """Write a row's events, whose ON columns are written: ON first, then OFF, each from left to right."""
    ts, xs, ys, ps = out
    if n <= SHORT:
        # All that short rows could need is written, in few instructions; what is too much is overwritten later.
        for k in range(SHORT):
            xs[n_on + k] = px.off_column[k]
        for k in range(SHORT):
            ts[k] = stamp
        for k in range(SHORT):
            ys[k] = r
        for k in range(SHORT):
            ps[k] = k < n_on
        return
    off = xs[n_on:n]
    for k in range(off.size):
        off[k] = px.off_column[k]
    for k in range(n):
        ts[k] = stamp
    for k in range(n):
        ys[k] = r
    for k in range(n):
        ps[k] = k < n_on


@njit(forceinline=True, **INNER)
def _update_blocks(px: Pixels, r: int, blocks: int) -> Any:
    """Set the earliest requests of the listed blocks of a row, of the row and of its group; return that of all.

    The earliest of the others are found first: numbers just written one by one cannot be read at once as a vector.
    """
    g = r // GROUP
    row, group = smallest(px.block_min[r]), smallest(px.row_min[g * GROUP : (g + 1) * GROUP])
    oldest = smallest(px.group_min)
    for k in range(blocks):
        b = np.int64(px.asked[k])
        least = smallest(px.t_next[r, b * BLOCK : (b + 1) * BLOCK])
        px.block_min[r, b] = least
        row = min(row, least)
    group = min(group, row)
    px.row_min[r] = row
    px.group_min[g] = group
    return min(oldest, group)


@njit(forceinline=True, **INNER)
def _next_noise(px: Pixels, ro: Readout, state: NDArray[np.float64], random: NDArray[np.uint64]) -> None:
    """Advance to the next background or hot-pixel event."""
    queue = int(state[QUEUE])
    if queue + 1 == AHEAD:
        draw_noise(px, ro, state[NOISE], random)
        queue = -1
    state[QUEUE] = queue + 1
    state[NOISE] = px.noise_t[queue + 1]


@njit(forceinline=True, **INNER)
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


@njit(forceinline=True, **INNER)
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
    """Run the sensor's loop to before ``until``, us after the epoch, or until the output is nearly full."""
    room = out[0].size - width - BLOCK
    start = period_start(drive, state[EPOCH], state[FREE])
    n = int(np.int64(0))
    state[FULL] = 0.0
    oldest32 = smallest(px.group_min)
    while True:
        oldest = np.float64(oldest32)
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
                oldest32 = smallest(px.group_min)
            else:
                oldest32 = min(oldest32, _place_noise(px, at, width, state[NOISE]))
            _next_noise(px, ro, state, random)
            continue
        r = row_at(px, oldest32)
        blocks = _find_blocks(px, r, np.float32(t))
        ts, xs, ys, ps = out
        here = ts[n:], xs[n:], ys[n:], ps[n:]
        n_row, n_on, words = _gather_row(px, r, np.float32(t), blocks, here[1])
        _emit_row(px, r, n_row, n_on, np.int64(floor(state[EPOCH] + t)), here)
        if t == oldest and drive.kind == SQUARE:
            reset_at_once(px, drive, ro, r, n_row, t, start, random)
        else:
            reset_row(px, drive, ro, r, n_row, t, start, random)
        oldest32 = _update_blocks(px, r, blocks)
        n += n_row
        state[STALL] += max(0.0, t_link - max(oldest, state[FREE]))
        _account(state, ro, t, n_row, words)
    return n
