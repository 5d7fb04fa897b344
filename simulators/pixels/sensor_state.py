"""What a sensor's loop carries on from slice to slice: its pixels, their requests, and where it stands in time.

Names every number and array of that state, and keeps the earliest requests of blocks, rows and groups of rows,
by which the oldest request is found without looking at every pixel. Knows no physics. Times are microseconds
after the epoch, the moment to which the float32 times of the pixels are relative.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulators.pixels.fast_math import JIT

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

# Numbers of a pixel, in Pixels.cell: a cache line holds four pixels. Speed is a matter of memory here.
PLACE: Final = 0  # its light, or its level on the atlas, as photoreceptor.place has it
GAINS: Final = 1  # as two uint16 (Pixels.gains): see ON_BITS
U_REF: Final = 2  # exp(-V) at the last reset
T_LIVE: Final = 3  # end of the dead time
N_CELL: Final = 4

ON_BITS: Final = 16
"""The low bits of a pixel's gains: an ON event comes at U_REF times these / 65536; an OFF event at U_REF divided
by the high bits / 65536."""


class Pixels(NamedTuple):
    """State and fixed pattern of the pixels, float32; columns are padded to whole blocks."""

    t_next: NDArray[np.float32]  # (rows, columns) next request; inf = none
    is_on: NDArray[np.uint8]  # (rows, columns) its polarity in bit 0; above, square_tail's digits of U_REF
    cell: NDArray[np.float32]  # (rows, columns, N_CELL)
    gains: NDArray[np.uint32]  # the same memory as words
    block_min: NDArray[np.float32]  # (rows, blocks) earliest request
    row_min: NDArray[np.float32]  # (rows padded to whole groups,)
    group_min: NDArray[np.float32]
    batch: NDArray[np.float32]  # (N_BATCH, columns) scratch: the pixels of a row at work
    column: NDArray[np.uint32]  # (columns,) where they stand
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
    alias: NDArray[np.uint64]  # Walker's alias table of the pixels' noise rates, as pixel_noise has it
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


@njit(forceinline=True, **JIT)
def retime(px: Pixels, r: int, c: int, before: float) -> None:
    """Bring the minima up to date after a pixel's request was moved from the time it had before."""
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
def row_at(px: Pixels, oldest: float) -> int:
    """First row whose earliest request comes at a time, the earliest of all."""
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


@njit(forceinline=True, **JIT)
def waiting(t_next: NDArray, is_on: NDArray, t32: Any) -> tuple[Any, Any]:
    """Which pixels of a block wait, a bit each, and which of them are ON."""
    asking, on = np.uint32(0), np.uint32(0)
    for i in range(BLOCK):
        bit = np.uint32(np.uint32(1) << np.uint32(i))
        asking |= bit if t_next[i] <= t32 else np.uint32(0)
        on |= bit if is_on[i] & np.uint8(1) else np.uint32(0)
    return asking, on & asking


@njit(inline="always", **JIT)
def lowest_bit(bits: Any) -> Any:
    """Position of the lowest bit set: the exponent of that bit as a float32."""
    alone = bits & (~bits + np.uint32(1))
    return (np.uint32(np.float32(alone).view(np.int32)) >> np.uint32(23)) - np.uint32(127)


@njit(inline="always", **JIT)
def count_bits(bits: Any) -> Any:
    """Number of bits set."""
    b = bits - ((bits >> np.uint32(1)) & np.uint32(0x55555555))
    b = (b & np.uint32(0x33333333)) + ((b >> np.uint32(2)) & np.uint32(0x33333333))
    b = (b + (b >> np.uint32(4))) & np.uint32(0x0F0F0F0F)
    return np.uint32(b * np.uint32(0x01010101)) >> np.uint32(24)
