"""The sensor's loop in compiled form: pixels that cross thresholds, rows that are read, the link that is full.

The oldest request is served first; all pixels of a row that wait are read together, with one timestamp, and
each takes its new reference from the light *then*: what the light did while the pixel waited is lost. A full
link stops the arbiter, so pixels wait longer. Knows arrays and numbers only; what they mean, and where they
come from, is said in ``pixels``. Times are microseconds after the epoch, the moment to which the float32
times of the pixels are relative.
"""

from __future__ import annotations

from math import floor, log
from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulators.photoreceptor import (
    SQUARE,
    Drive,
    atlas_level,
    next_crossing,
    period_start,
    steady_square,
    value_at,
)

BLOCK: Final = 32
"""Pixels of a block: one vector triple of the EVT3 format."""
GROUP: Final = 24
"""Rows of a group, for finding the oldest request."""

# Indices into the float64 state of the loop.
FREE: Final = 0  # when the arbiter is free again
NOISE: Final = 1  # when the next background or hot-pixel event comes
FIFO: Final = 2  # words waiting for the link
FIFO_T: Final = 3  # as of when
STALL: Final = 4  # time the arbiter has waited for the link
EPOCH: Final = 5  # sensor time of the epoch
FULL: Final = 6  # 1 when the last call ended because the output was nearly full
N_STATE: Final = 7

JIT: Final[dict[str, Any]] = {
    "cache": True,
    "error_model": "numpy",
    "nogil": True,
    "fastmath": {"nnan", "nsz", "reassoc"},
}
"""No infinities are assumed away: a pixel without a request has its next one at infinity."""

VECTOR_FROM: Final = 5
"""Events of a block from which on the sensor sends them as a vector."""
LONGEST_ROW_WORDS: Final = 512
"""Room the link must have before a row is read."""


# Numbers of a pixel, in Pixels.cell: one cache line holds two pixels.
T_LIVE: Final = 0  # end of the dead time
U_REF: Final = 1  # exp(-V) at the last reset
GAIN_ON: Final = 2  # an ON event comes at U_REF * GAIN_ON
GAIN_OFF: Final = 3  # an OFF event comes at U_REF * GAIN_OFF
LIGHT: Final = 4  # share of the drive that reaches the pixel
U_RISE: Final = 5  # square: u at the rising edge; smooth: level on the atlas
U_FALL: Final = 6  # square: u at the falling edge
IS_ON: Final = 7  # polarity of the next request
N_CELL: Final = 8


class Pixels(NamedTuple):
    """State and fixed pattern of the pixels, float32; columns are padded to whole blocks."""

    t_next: NDArray[np.float32]  # (rows, columns) next request; inf = none
    cell: NDArray[np.float32]  # (rows, columns, N_CELL)
    block_min: NDArray[np.float32]  # (rows, blocks) earliest request
    row_min: NDArray[np.float32]  # (rows padded to whole groups,)
    group_min: NDArray[np.float32]


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
def _reset_pixel(
    px: Pixels, d: Drive, ro: Readout, r: int, c: int, t: float, start: float, random: NDArray
) -> None:
    """Take the level at the end of the dead time as the new reference and find the next crossing.

    Parameters
    ----------
    t
        When the row is read.
    start
        Start of a period not after ``t``, nor a whole period before it.
    """
    cell = px.cell[r, c]
    t_live = t + ro.dead_us
    phase = t_live - start
    if phase >= d.period_us:
        periods = floor(phase / d.period_us)
        phase -= periods * d.period_us
        start += periods * d.period_us
    light, u_rise, u_fall = cell[LIGHT], cell[U_RISE], cell[U_FALL]
    u = value_at(d, light, u_rise, u_fall, phase)
    if ro.reset_noise > 0.0:
        u *= 1.0 + ro.reset_noise * ro.normals[np.int64(_random(random) >> np.uint64(52))]
    cross, on = next_crossing(d, light, u_rise, u_fall, u * cell[GAIN_ON], u * cell[GAIN_OFF], phase)
    cell[U_REF] = u
    cell[T_LIVE] = t_live
    cell[IS_ON] = on
    px.t_next[r, c] = max(t_live, start + cross)


@njit(**JIT)
def _smallest(values: NDArray) -> float:
    """Smallest of some numbers; a plain loop, which becomes vector instructions."""
    m = values[0]
    for i in range(1, values.size):
        m = min(m, values[i])
    return m


@njit(**JIT)
def _update_row(px: Pixels, r: int) -> None:
    """Earliest request of a row and of its group, from those of its blocks."""
    px.row_min[r] = _smallest(px.block_min[r])
    g = r // GROUP
    px.group_min[g] = _smallest(px.row_min[g * GROUP : (g + 1) * GROUP])


@njit(**JIT)
def update_minima(px: Pixels) -> None:
    """Bring all minima up to date with the pixels' requests."""
    rows, blocks = px.block_min.shape
    for r in range(rows):
        for b in range(blocks):
            px.block_min[r, b] = _smallest(px.t_next[r, b * BLOCK : (b + 1) * BLOCK])
        _update_row(px, r)


@njit(**JIT)
def _first_equal(values: NDArray, wanted: float) -> int:
    """Index of the first of the numbers that equals the wanted one."""
    for i in range(values.size):
        if values[i] == wanted:
            return i
    return 0


@njit(**JIT)
def _oldest_row(px: Pixels) -> int:
    """Row whose request is the oldest."""
    oldest = _smallest(px.group_min)
    g = _first_equal(px.group_min, oldest)
    return g * GROUP + _first_equal(px.row_min[g * GROUP : (g + 1) * GROUP], oldest)


@njit(**JIT)
def _place_noise(px: Pixels, ro: Readout, width: int, t: float, random: NDArray) -> None:
    """Let one pixel, drawn by its noise rate, request a read at t, unless it is dead or waits already."""
    bits = _random(random)
    i = np.int64(((bits >> np.uint64(32)) * np.uint64(ro.alias_share.size)) >> np.uint64(32))
    if np.float32(np.int64(bits & np.uint64(0xFFFFFF)) * (1.0 / 16777216.0)) >= ro.alias_share[i]:
        i = np.int64(ro.alias_other[i])
    r, c = i // width, i % width
    if t < px.cell[r, c, T_LIVE] or px.t_next[r, c] <= t:
        return
    px.t_next[r, c] = t
    px.cell[r, c, IS_ON] = np.int64((bits >> np.uint64(24)) & np.uint64(1))
    b = c // BLOCK
    t32 = px.t_next[r, c]
    px.block_min[r, b] = min(px.block_min[r, b], t32)
    px.row_min[r] = min(px.row_min[r], t32)
    px.group_min[r // GROUP] = min(px.group_min[r // GROUP], t32)


@njit(**JIT)
def _take_block(
    px: Pixels,
    drive: Drive,
    ro: Readout,
    r: int,
    b: int,
    t: float,
    start: float,
    random: NDArray,
    on_x: NDArray,
    off_x: NDArray,
    n_on: int,
    n_off: int,
) -> tuple[int, int]:
    """Read the waiting pixels of a block into the row's lists of ON and OFF columns, and reset them."""
    for c in range(b * BLOCK, (b + 1) * BLOCK):
        if px.t_next[r, c] <= t:
            if px.cell[r, c, IS_ON] != 0.0:
                on_x[n_on] = c
                n_on += 1
            else:
                off_x[n_off] = c
                n_off += 1
            _reset_pixel(px, drive, ro, r, c, t, start, random)
    px.block_min[r, b] = _smallest(px.t_next[r, b * BLOCK : (b + 1) * BLOCK])
    return n_on, n_off


@njit(inline="always", **JIT)
def _block_words(n: int) -> int:
    """EVT3 words of n events of one polarity in a block: single events, or a vector triple with its base."""
    return n if n < VECTOR_FROM else 4


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
    Number of events written. ``state[FREE]`` and the pixels carry on: calling again goes on exactly there. When
    the output was nearly full before ``until``, ``state[FULL]`` is 1.
    """
    ts, xs, ys, ps = out
    on_x, off_x = np.empty(width, np.uint16), np.empty(width, np.uint16)
    room = ts.size - width
    start = period_start(drive, state[EPOCH], state[FREE])
    n = 0
    state[FULL] = 0.0
    while True:
        r = _oldest_row(px)
        t = max(np.float64(px.row_min[r]), state[FREE])
        # The link drains while the arbiter waits for room for the longest row.
        t_link = state[FIFO_T] + (state[FIFO] + LONGEST_ROW_WORDS - ro.fifo_words) / ro.link_words_us
        stall = max(0.0, t_link - t)
        t += stall
        if min(t, state[NOISE]) >= until:
            break
        if state[NOISE] <= t:
            _place_noise(px, ro, width, state[NOISE], random)
            state[NOISE] -= log(_uniform(random)) / ro.noise_rate_us
            continue
        if n > room:
            state[FULL] = 1.0
            break
        if t - start >= drive.period_us:
            start = period_start(drive, state[EPOCH], t)
        n_on, n_off, words = 0, 0, 2
        for b in range(px.block_min.shape[1]):
            if px.block_min[r, b] <= t:
                on_before, off_before = n_on, n_off
                n_on, n_off = _take_block(px, drive, ro, r, b, t, start, random, on_x, off_x, n_on, n_off)
                words += _block_words(n_on - on_before) + _block_words(n_off - off_before)
        _update_row(px, r)
        stamp = np.int64(floor(state[EPOCH] + t))
        for k in range(n_on + n_off):
            ts[n + k] = stamp
            xs[n + k] = on_x[k] if k < n_on else off_x[k - n_on]
            ys[n + k] = r
            ps[n + k] = k < n_on
        n += n_on + n_off
        state[STALL] += stall
        state[FREE] = t + ro.row_us + (n_on + n_off) * ro.event_us
        state[FIFO] = max(0.0, state[FIFO] - (t - state[FIFO_T]) * ro.link_words_us) + words
        state[FIFO_T] = t
    return n


@njit(**JIT)
def start_pixels(px: Pixels, drive: Drive, ro: Readout, t: float, state: NDArray, random: NDArray) -> None:
    """Set every pixel as if it had last been reset at the time t (us after the epoch), in the steady state."""
    rows, columns = px.t_next.shape
    start = period_start(drive, state[EPOCH], t)
    for r in range(rows):
        for c in range(columns):
            _reset_pixel(px, drive, ro, r, c, t - ro.dead_us, start, random)
    update_minima(px)


@njit(**JIT)
def redrive(px: Pixels, drive: Drive, t: float, step_us: float, state: NDArray, random: NDArray) -> None:
    """Let a new light or a new picture take effect at t: references stay, next crossings are found anew.

    A pixel that the change itself carries beyond its threshold requests at a random time of the step.
    """
    rows, columns = px.t_next.shape
    start = period_start(drive, state[EPOCH], t)
    for r in range(rows):
        for c in range(columns):
            if px.t_next[r, c] <= t:
                continue  # it waits already
            cell = px.cell[r, c]
            light, u_rise, u_fall = cell[LIGHT], cell[U_RISE], cell[U_FALL]
            u = value_at(drive, light, u_rise, u_fall, t - start)
            on_at, off_at = cell[U_REF] * cell[GAIN_ON], cell[U_REF] * cell[GAIN_OFF]
            if u <= on_at or u >= off_at:
                cross, on = t + step_us * _uniform(random), u <= on_at
            else:
                cross, on = next_crossing(drive, light, u_rise, u_fall, on_at, off_at, t - start)
                cross += start
            px.t_next[r, c] = max(np.float64(cell[T_LIVE]), cross)
            cell[IS_ON] = on
    update_minima(px)


@njit(**JIT)
def move_epoch(px: Pixels, state: NDArray, by_us: float) -> None:
    """Count times from a later epoch, so that float32 keeps resolving them."""
    shift = np.float32(by_us)
    px.t_next[:] -= shift
    px.cell[:, :, T_LIVE] -= shift
    px.block_min[:] -= shift
    px.row_min[:] -= shift
    px.group_min[:] -= shift
    state[EPOCH] += by_us
    state[FREE] -= by_us
    state[NOISE] -= by_us
    state[FIFO_T] -= by_us


@njit(**JIT)
def steady_levels(px: Pixels, drive: Drive) -> None:
    """Fill in each pixel's two numbers for its light: edges' levels (square) or position on the atlas (smooth)."""
    rows, columns = px.t_next.shape
    for r in range(rows):
        for c in range(columns):
            cell = px.cell[r, c]
            if drive.kind == SQUARE:
                cell[U_RISE], cell[U_FALL] = steady_square(drive, cell[LIGHT])
            else:
                cell[U_RISE] = atlas_level(drive, cell[LIGHT])
