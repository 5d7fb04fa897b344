"""State of the sensor's loop that is kept from slice to slice: pixels, their requests, and the loop's times.

This module names every number and array of that state. It also maintains the earliest requests of blocks, rows and
groups of rows, with which the oldest request is found without a search over all pixels. It contains no physics. Times
are microseconds after the epoch, the moment to which the float32 times of the pixels are relative.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulators.pixels.fast_math import INNER

BLOCK: Final = 32
"""Pixels of a block: one vector triple of the EVT3 format."""
GROUP: Final = 24
"""Rows of a group; groups speed up the search for the oldest request. 30 groups of 24 rows: both searches are short."""
AHEAD: Final = 256
"""Background and hot-pixel events drawn at a time, which costs less than one by one."""

# Indices into the float64 state of the loop.
FREE: Final = 0  # when the arbiter is free again
NOISE: Final = 1  # when the next background or hot-pixel event comes (px.noise_t[QUEUE])
FIFO: Final = 2  # words waiting for the link
FIFO_T: Final = 3  # time of that count
STALL: Final = 4  # time the arbiter has waited for the link
EPOCH: Final = 5  # sensor time of the epoch
FULL: Final = 6  # 1 when the last call ended because the output was nearly full
QUEUE: Final = 7  # position in the queue of background and hot-pixel events
N_STATE: Final = 8

# Numbers of a pixel, in Pixels.cell: a cache line holds four pixels, as memory limits the speed.
STORED_LIGHT: Final = 0  # its light, or its level on the atlas, from photoreceptor.stored_light
GAINS: Final = 1  # two uint16 (Pixels.gains); see ON_BITS
U_REF: Final = 2  # exp(-V) at the last reset
T_LIVE: Final = 3  # end of the dead time
N_CELL: Final = 4

ON_BITS: Final = 16
"""Number of low bits of a pixel's gains. An ON event comes at U_REF times low bits / 65536, an OFF event at U_REF
divided by high bits / 65536."""


class Pixels(NamedTuple):
    """State and fixed pattern of the pixels; columns are padded to whole blocks."""

    # (rows, columns) float32, time of the next request, us after the epoch; inf = none.
    t_next: NDArray[np.float32]
    # (rows, columns) uint8, polarity of that request in bit 0; above it, the lower digits of U_REF
    # (``pixel_reset``).
    is_on: NDArray[np.uint8]
    cell: NDArray[np.float32]  # (rows, columns, N_CELL) float32, further numbers of each pixel
    gains: NDArray[np.uint32]  # (rows, columns, N_CELL) uint32, the same memory as words
    block_min: NDArray[np.float32]  # (rows, blocks) float32, earliest request of each block
    row_min: NDArray[np.float32]  # (rows padded to whole groups,) float32, earliest request of each row
    group_min: NDArray[np.float32]  # (groups,) float32, earliest request of each group of rows
    # (N_BATCH, columns) float32, scratch: the pixels of a row that are processed.
    batch: NDArray[np.float32]
    column: NDArray[np.uint32]  # (columns + BLOCK,) uint32, their columns
    # (columns + BLOCK,) uint16, scratch: the columns of those with an OFF event.
    off_column: NDArray[np.uint16]
    asked: NDArray[np.uint32]  # (blocks,) uint32, scratch: the blocks of a row in which pixels wait
    # (AHEAD,) float64, times of the next background and hot-pixel events, us after the epoch.
    noise_t: NDArray[np.float64]
    noise_at: NDArray[np.int64]  # (AHEAD,) int64, their pixels: row * width + column, times 2, plus 1 if ON


class Readout(NamedTuple):
    """Dead time, arbiter, link and temporal noise."""

    dead_us: float  # Refractory time of a pixel after a read
    reset_noise: float  # Standard deviation of the reference after a reset, in units of log intensity
    row_us: float
    event_us: float
    link_words_us: float  # Words that the link carries per us
    fifo_words: float
    noise_rate_us: float  # Rate of background and hot-pixel events of all pixels together, events per us
    # (pixels,) uint64, Walker's alias table of the pixels' noise rates; see ``pixel_noise``.
    alias: NDArray[np.uint64]
    normals: NDArray[np.float32]  # (4096,) float32, normal deviates


@njit(forceinline=True, **INNER)
def smallest(values: Any) -> Any:
    """Return the smallest of at least one float32; none is NaN."""
    least = values[0]
    for k in range(1, values.size):
        least = min(least, values[k])
    return least


@njit(forceinline=True, **INNER)
def _first_equal(values: Any, wanted: Any) -> Any:
    """Return the index of the first number that equals the wanted one; 0 if none does."""
    for k in range(values.size):
        if values[k] == wanted:
            return np.int64(k)
    return np.int64(0)


@njit(forceinline=True, **INNER)
def update_row(px: Pixels, r: int) -> None:
    """Update the earliest request of a row and of its group from those of its blocks."""
    px.row_min[r] = smallest(px.block_min[r])
    g = r // GROUP
    px.group_min[g] = smallest(px.row_min[g * GROUP : (g + 1) * GROUP])


@njit(forceinline=True, **INNER)
def retime(px: Pixels, r: int, c: int, before: float) -> None:
    """Update the minima: one pixel's next time, us after the epoch, was ``before`` and has changed."""
    b = c // BLOCK
    old = px.block_min[r, b]
    new = px.t_next[r, c]
    if before <= old:
        new = smallest(px.t_next[r, b * BLOCK : (b + 1) * BLOCK])
    elif new >= old:
        return
    px.block_min[r, b] = new
    if old <= px.row_min[r]:
        update_row(px, r)
    elif new < px.row_min[r]:
        px.row_min[r] = new
        px.group_min[r // GROUP] = min(px.group_min[r // GROUP], new)


@njit(**INNER)
def update_minima(px: Pixels) -> None:
    """Update all minima from the pixels' requests."""
    rows, blocks = px.block_min.shape
    for r in range(rows):
        for b in range(blocks):
            px.block_min[r, b] = smallest(px.t_next[r, b * BLOCK : (b + 1) * BLOCK])
        update_row(px, r)


@njit(forceinline=True, **INNER)
def row_at(px: Pixels, oldest: float) -> int:
    """Return the first row whose earliest request is the earliest of all, at ``oldest`` us after the epoch."""
    g = _first_equal(px.group_min, oldest)
    return g * GROUP + _first_equal(px.row_min[g * GROUP : (g + 1) * GROUP], oldest)


def move_epoch(px: Pixels, state: NDArray[np.float64], by_us: float) -> None:
    """Move the epoch to a later time, so that float32 keeps resolving the times."""
    for times in (px.t_next, px.cell[..., T_LIVE], px.block_min, px.row_min, px.group_min):
        np.subtract(times, np.float32(by_us), out=times)
    px.noise_t[:] -= by_us
    state[EPOCH] += by_us
    state[[FREE, NOISE, FIFO_T]] -= by_us
