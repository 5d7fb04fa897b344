"""What a sensor's loop carries on from slice to slice: its pixels, their requests, and where it stands in time.

Names every number and array of that state, and keeps the earliest requests of blocks, rows and groups of rows,
by which the oldest request is found without looking at every pixel. Knows no physics. Times are microseconds
after the epoch, the moment to which the float32 times of the pixels are relative.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulators.fast_math import JIT

BLOCK: Final = 32
"""Pixels of a block: one vector triple of the EVT3 format."""
GROUP: Final = 24
"""Rows of a group, for finding the oldest request."""
AHEAD: Final = 256
"""Background and hot-pixel events drawn at a time."""

# Indices into the float64 state of the loop.
FREE: Final = 0  # when the arbiter is free again
NOISE: Final = 1  # when the next background or hot-pixel event comes (px.noise_t[QUEUE])
FIFO: Final = 2  # words waiting for the link
FIFO_T: Final = 3  # as of when
STALL: Final = 4  # time the arbiter has waited for the link
EPOCH: Final = 5  # sensor time of the epoch
FULL: Final = 6  # 1 when the last call ended because the output was nearly full
QUEUE: Final = 7  # position in the queue of background and hot-pixel events
N_STATE: Final = 8

# Numbers of a pixel, in Pixels.cell: one cache line holds two pixels.
LIGHT: Final = 0  # share of the drive that reaches the pixel
U_RISE: Final = 1  # its steady state, as photoreceptor has it
U_FALL: Final = 2
GAIN_ON: Final = 3  # an ON event comes at U_REF * GAIN_ON
GAIN_OFF: Final = 4  # an OFF event comes at U_REF * GAIN_OFF
U_REF: Final = 5  # exp(-V) at the last reset
T_LIVE: Final = 6  # end of the dead time
IS_ON: Final = 7  # polarity of the next request
N_CELL: Final = 8


class Pixels(NamedTuple):
    """State and fixed pattern of the pixels, float32; columns are padded to whole blocks."""

    t_next: NDArray[np.float32]  # (rows, columns) next request; inf = none
    cell: NDArray[np.float32]  # (rows, columns, N_CELL)
    block_min: NDArray[np.float32]  # (rows, blocks) earliest request
    row_min: NDArray[np.float32]  # (rows padded to whole groups,)
    group_min: NDArray[np.float32]
    batch: NDArray[np.float32]  # (N_BATCH, columns) scratch: the pixels of a row at work
    column: NDArray[np.int32]  # (columns,) where they stand
    noise_t: NDArray[np.float64]  # (AHEAD,) background and hot-pixel events to come: when,
    noise_at: NDArray[np.int64]  # and at which pixel, row * width + column, times 2, plus 1 if ON


class Readout(NamedTuple):
    """Dead time, arbiter, link and temporal noise."""

    dead_us: float
    reset_noise: float
    row_us: float  # cost of a row read
    event_us: float  # and of each event in it
    link_words_us: float
    fifo_words: float
    noise_rate_us: float  # of all pixels together, events per us
    alias_share: NDArray[np.float32]  # Walker's alias table of the pixels' noise rates
    alias_other: NDArray[np.int32]
    normals: NDArray[np.float32]  # 4096 normal deviates


@njit(forceinline=True, **JIT)
def smallest(values: NDArray) -> float:
    """Smallest of some numbers; a plain loop, which becomes vector instructions."""
    m = values[0]
    for i in range(1, values.size):
        m = min(m, values[i])
    return m


@njit(forceinline=True, **JIT)
def update_row(px: Pixels, r: int) -> None:
    """Earliest request of a row and of its group, from those of its blocks."""
    px.row_min[r] = smallest(px.block_min[r])
    g = r // GROUP
    px.group_min[g] = smallest(px.row_min[g * GROUP : (g + 1) * GROUP])


@njit(**JIT)
def update_minima(px: Pixels) -> None:
    """Bring all minima up to date with the pixels' requests."""
    rows, blocks = px.block_min.shape
    for r in range(rows):
        for b in range(blocks):
            px.block_min[r, b] = smallest(px.t_next[r, b * BLOCK : (b + 1) * BLOCK])
        update_row(px, r)


@njit(forceinline=True, **JIT)
def _first_equal(values: NDArray, wanted: float) -> int:
    """Index of the first of the numbers that equals the wanted one."""
    for i in range(values.size):
        if values[i] == wanted:
            return i
    return 0


@njit(forceinline=True, **JIT)
def oldest_row(px: Pixels) -> int:
    """Row whose request is the oldest."""
    oldest = smallest(px.group_min)
    g = _first_equal(px.group_min, oldest)
    return g * GROUP + _first_equal(px.row_min[g * GROUP : (g + 1) * GROUP], oldest)


@njit(**JIT)
def move_epoch(px: Pixels, state: NDArray, by_us: float) -> None:
    """Count times from a later epoch, so that float32 keeps resolving them."""
    shift = np.float32(by_us)
    rows, columns = px.t_next.shape
    for r in range(rows):
        for c in range(columns):
            px.t_next[r, c] -= shift
            px.cell[r, c, T_LIVE] -= shift
        for b in range(px.block_min.shape[1]):
            px.block_min[r, b] -= shift
        px.row_min[r] -= shift
    for g in range(px.group_min.size):
        px.group_min[g] -= shift
    for k in range(AHEAD):
        px.noise_t[k] -= by_us
    state[EPOCH] += by_us
    state[FREE] -= by_us
    state[NOISE] -= by_us
    state[FIFO_T] -= by_us
