"""The photoreceptors under a periodic light: their levels at any phase, and when they cross a threshold.

The large-signal first-order model: light I(t) = ambient + light * w(t), and with u = exp(-V) of the
receptor's output V = ln I (in the steady state),

    du/dt = (1 - I u) / q

is linear: the time constant is q / I, so ON edges are fast and OFF edges slow. Under a square light u is a
pair of exponentials and everything is closed form; under any other light with one rise and one fall a period,
u comes from an atlas of periodic steady states, tabulated over light and phase.

Compiled functions over a batch of pixels: a float32 array of N_BATCH rows, one number of a pixel each. A phase
is in microseconds after the start of a period of the light.
"""

from __future__ import annotations

from math import exp, floor, log
from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulators.fast_math import JIT, exp32, log32

SQUARE: Final = 0
SMOOTH: Final = 1

# Rows of a batch.
LIGHT: Final = 0  # share of the drive that reaches the pixel
U_RISE: Final = (
    1  # square: u at the rising edge; smooth: row position on the atlas, -1 = too dark ever to fire
)
U_FALL: Final = 2  # square: u at the falling edge
ON_AT: Final = 3  # an ON event comes when u has fallen to this
OFF_AT: Final = 4  # an OFF event comes when u has risen to this
U: Final = 5  # u at the phase asked for
T: Final = 6  # phase of the next crossing; may exceed a period; inf = none
IS_ON: Final = 7  # its polarity
N_BATCH: Final = 8

# Columns of Drive.turns.
X_DARK: Final = 0  # bin of the largest u, and of the smallest, up to one period later
X_BRIGHT: Final = 1
U_DARK: Final = 2  # u there
U_BRIGHT: Final = 3
LN_BRIGHT: Final = 4  # ln of the smallest u, and 1 / (ln of the largest - ln of the smallest)
LN_SPAN: Final = 5
N_TURNS: Final = 6

_ZERO: Final = np.float32(0.0)
_ONE: Final = np.float32(1.0)
_NEVER: Final = np.float32(np.inf)
_HUGE: Final = np.float32(1e30)
_TINY: Final = np.float32(1e-30)


class Drive(NamedTuple):
    """The light and the photoreceptor."""

    kind: int
    period_us: float
    high_us: float  # square: length of the high part
    w_high: float
    w_low: float
    ambient: float
    q_us: float
    start_us: float  # sensor time at which a period begins
    atlas: NDArray[np.float32]  # smooth: (levels, bins + 1) u over a period, light rising from row to row
    by_bin: NDArray[np.float32]  # the same, transposed
    turns: NDArray[np.float32]  # (levels, N_TURNS) where each row turns
    guess: NDArray[np.float32]  # (2, levels, steps) bin at which u crosses a level, falling and rising
    lowest: float  # light of the first row; below, nothing ever crosses
    log_step: float  # ln of the ratio of light from one row to the next


@njit(**JIT)
def period_start(drive: Drive, epoch: float, t: float) -> float:
    """Start of the light's period in which t lies, us after the epoch."""
    first = drive.start_us - epoch
    return first + floor((t - first) / drive.period_us) * drive.period_us


@njit(**JIT)
def steady_levels(drive: Drive, batch: NDArray, n: int) -> None:
    """Fill in U_RISE and U_FALL for the light of each pixel."""
    if drive.kind == SQUARE:
        for k in range(n):
            batch[U_RISE, k], batch[U_FALL, k] = _steady_square(drive, batch[LIGHT, k])
    else:
        top = np.float32(drive.atlas.shape[0] - 1.001)
        for k in range(n):
            light = batch[LIGHT, k]
            level = np.float32(-1.0)
            if light >= drive.lowest:
                level = min(np.float32(log(light / drive.lowest) / drive.log_step), top)
            batch[U_RISE, k] = level


@njit(inline="always", **JIT)
def level_at(d: Drive, light: Any, u_rise: Any, u_fall: Any, phase: float) -> Any:
    """Value of u of one pixel at a phase below one period."""
    if d.kind == SMOOTH:
        return _smooth_level(d, u_rise, phase)
    return _square_level(d, light, u_rise, u_fall, phase)


@njit(inline="always", **JIT)
def crossing(d: Drive, light: Any, u_rise: Any, u_fall: Any, on_at: Any, off_at: Any, phase: float) -> Any:
    """First crossing of one pixel at or after a phase below one period.

    Returns its phase (float32; may exceed a period, inf = none) and its polarity (1.0 = ON).
    """
    if d.kind == SMOOTH:
        return _smooth_crossing(d, u_rise, on_at, off_at, phase)
    return _square_crossing(d, light, u_rise, u_fall, on_at, off_at, phase)


@njit(**JIT)
def levels_at(drive: Drive, batch: NDArray, n: int, phase: float) -> None:
    """Fill in U at a phase below one period."""
    if drive.kind == SMOOTH:
        for k in range(n):
            batch[U, k] = _smooth_level(drive, batch[U_RISE, k], phase)
    else:
        for k in range(n):
            batch[U, k] = _square_level(drive, batch[LIGHT, k], batch[U_RISE, k], batch[U_FALL, k], phase)


@njit(**JIT)
def crossings(drive: Drive, batch: NDArray, n: int, phase: float) -> None:
    """Fill in T and IS_ON: the first crossing of ON_AT or OFF_AT at or after a phase below one period."""
    if drive.kind == SMOOTH:
        for k in range(n):
            on_at, off_at = batch[ON_AT, k], batch[OFF_AT, k]
            batch[T, k], batch[IS_ON, k] = _smooth_crossing(drive, batch[U_RISE, k], on_at, off_at, phase)
    else:
        for k in range(n):
            light, u_rise, u_fall = batch[LIGHT, k], batch[U_RISE, k], batch[U_FALL, k]
            on_at, off_at = batch[ON_AT, k], batch[OFF_AT, k]
            batch[T, k], batch[IS_ON, k] = _square_crossing(
                drive, light, u_rise, u_fall, on_at, off_at, phase
            )


# ---------------------------------------------------------------- square


@njit(**JIT)
def _steady_square(drive: Drive, light: float) -> tuple[float, float]:
    """Values of u at the rising and the falling edge in the periodic steady state, in closed form."""
    i_high, i_low = drive.ambient + light * drive.w_high, drive.ambient + light * drive.w_low
    decay_high = exp(-i_high * drive.high_us / drive.q_us)
    decay_low = exp(-i_low * (drive.period_us - drive.high_us) / drive.q_us)
    bright, dark = 1.0 / i_high, 1.0 / i_low
    both = decay_high * decay_low
    u_rise = (dark * (1.0 - decay_low) + bright * (1.0 - decay_high) * decay_low) / (1.0 - both)
    return u_rise, bright + (u_rise - bright) * decay_high


@njit(inline="always", **JIT)
def _square_level(d: Drive, light: Any, u_rise: Any, u_fall: Any, phase: float) -> Any:
    """u relaxes towards 1 / I from its value at the last edge."""
    rising = phase >= d.high_us  # u rises in the low part
    i = np.float32(d.ambient) + light * np.float32(d.w_low if rising else d.w_high)
    since = np.float32((phase - (d.high_us if rising else 0.0)) / d.q_us)
    end = _ONE / i
    return end + ((u_fall if rising else u_rise) - end) * exp32(-since * i)


@njit(inline="always", **JIT)
def _square_crossing(
    d: Drive, light: Any, u_rise: Any, u_fall: Any, on_at: Any, off_at: Any, phase: float
) -> Any:
    """The present part of the period is searched, then the one after it; beyond, all repeats.

    Within a part u relaxes from its value at the part's start towards 1 / I and meets the target at
    (q / I) ln((u_start - 1 / I) / (target - 1 / I)).
    """
    rising = phase >= d.high_us
    now_start, now_end = (u_fall, u_rise) if rising else (u_rise, u_fall)
    now_at, next_at = (off_at, on_at) if rising else (on_at, off_at)
    sign = _ONE if rising else -_ONE
    now_on, next_on = (_ZERO, _ONE) if rising else (_ONE, _ZERO)
    now_w, next_w = np.float32(d.w_low if rising else d.w_high), np.float32(d.w_high if rising else d.w_low)
    now_from = np.float32(d.high_us if rising else 0.0)
    next_from = np.float32(d.period_us if rising else d.high_us)
    in_now = sign * (now_end - now_at) >= _ZERO
    in_next = sign * (next_at - now_start) >= _ZERO
    u_start = now_start if in_now else now_end
    target = now_at if in_now else next_at
    end = _ONE / (np.float32(d.ambient) + light * (now_w if in_now else next_w))
    ratio = min(max((u_start - end) / (target - end), _TINY), _HUGE)
    begin = now_from if in_now else next_from
    cross = max(begin + np.float32(d.q_us) * end * log32(ratio), begin, np.float32(phase))
    never = not (in_now or in_next) or u_start == end
    return _NEVER if never else cross, now_on if in_now else next_on


# ---------------------------------------------------------------- smooth


@njit(inline="always", **JIT)
def _smooth_level(drive: Drive, level: Any, phase: float) -> Any:
    """u at a phase, interpolated on the atlas."""
    bins = drive.atlas.shape[1] - 1
    x = phase / drive.period_us * bins
    i = min(int(x), bins - 1)
    g = np.float32(x - i)
    j = int(max(level, _ZERO))
    f = level - np.float32(j)
    a = drive.by_bin[i, j] + f * (drive.by_bin[i, j + 1] - drive.by_bin[i, j])
    b = drive.by_bin[i + 1, j] + f * (drive.by_bin[i + 1, j + 1] - drive.by_bin[i + 1, j])
    return a + g * (b - a) if level >= _ZERO else np.float32(1.0 / drive.ambient)


@njit(inline="always", **JIT)
def _between(table: NDArray, j: int, f: float, column: int) -> float:
    """Interpolate between rows j and j + 1."""
    return table[j, column] + f * (table[j + 1, column] - table[j, column])


@njit(**JIT)
def _smooth_crossing(drive: Drive, level: Any, on_at: Any, off_at: Any, phase: float) -> tuple[Any, Any]:
    """Phase and polarity of a pixel's next crossing on the atlas."""
    if level < _ZERO:
        return _NEVER, _ZERO
    bins = drive.atlas.shape[1] - 1
    j = int(level)
    f = level - np.float32(j)
    dark, bright = _between(drive.turns, j, f, X_DARK), _between(drive.turns, j, f, X_BRIGHT)
    falls_to, rises_to = _between(drive.turns, j, f, U_BRIGHT), _between(drive.turns, j, f, U_DARK)
    can_on, can_off = falls_to <= on_at, rises_to >= off_at
    x = phase / drive.period_us * bins
    x += (
        floor((dark - x) / bins + 1.0) * bins
    )  # into the period that begins in the dark: dark <= x < dark + bins
    shift = x - phase / drive.period_us * bins
    if x < bright:
        if can_on:
            return (_on_bin(drive, j, f, on_at, x) - shift) * drive.period_us / bins, _ONE
        if can_off:
            return (_off_bin(drive, j, f, off_at, x) - shift) * drive.period_us / bins, _ZERO
    elif can_off:
        return (_off_bin(drive, j, f, off_at, x) - shift) * drive.period_us / bins, _ZERO
    elif can_on:
        return (_on_bin(drive, j, f, on_at, x - bins) + bins - shift) * drive.period_us / bins, _ONE
    return _NEVER, _ZERO


@njit(inline="always", **JIT)
def _on_bin(drive: Drive, j: int, f: float, target: float, x: float) -> float:
    """Bin, not before x, at which u falls to the target between dark and bright."""
    return max(x, _crossing_bin(drive, j, f, target, 0, np.float32(-1.0)))


@njit(inline="always", **JIT)
def _off_bin(drive: Drive, j: int, f: float, target: float, x: float) -> float:
    """Bin, not before x, at which u rises to the target between bright and the next dark."""
    return max(x, _crossing_bin(drive, j, f, target, 1, np.float32(1.0)))


@njit(**JIT)
def _crossing_bin(drive: Drive, j: int, f: float, target: float, branch: int, sign: float) -> float:
    """Bin at which sign * u rises to sign * target: guessed from a table, then sought on the atlas."""
    bins = drive.atlas.shape[1] - 1
    steps = drive.guess.shape[2]
    first = _between(drive.turns, j, f, X_DARK if branch == 0 else X_BRIGHT)
    last = (
        _between(drive.turns, j, f, X_BRIGHT) if branch == 0 else _between(drive.turns, j, f, X_DARK) + bins
    )
    s = (log32(target) - _between(drive.turns, j, f, LN_BRIGHT)) * _between(drive.turns, j, f, LN_SPAN)
    s = min(max(s, _ZERO), _ONE) * np.float32(steps - 1)
    a = min(int(s), steps - 2)
    i = int(
        _between(drive.guess[branch], j, f, a) * (a + 1 - s)
        + _between(drive.guess[branch], j, f, a + 1) * (s - a)
    )
    low, high = int(first), int(last) + 1
    i = min(max(i, low), high - 1)
    row, above = drive.atlas[j], drive.atlas[j + 1]
    c = i % bins
    here = row[c] + f * (above[c] - row[c])
    there = row[c + 1] + f * (above[c + 1] - row[c + 1])
    while sign * (here - target) >= _ZERO and i > low:
        i -= 1
        c = c - 1 if c > 0 else bins - 1
        there = here
        here = row[c] + f * (above[c] - row[c])
    while sign * (there - target) < _ZERO and i < high - 1:
        i += 1
        c = c + 1 if c < bins - 1 else 0
        here = there
        there = row[c + 1] + f * (above[c + 1] - row[c + 1])
    share = (target - here) / (there - here) if there != here else _ZERO
    return min(max(i + min(max(share, _ZERO), _ONE), first), last)


@njit(**JIT)
def fill_atlas(
    atlas: NDArray,
    turns: NDArray,
    guess: NDArray,
    lights: NDArray,
    wave: NDArray,
    ambient: float,
    bin_q: float,
) -> None:
    """Tabulate the periodic steady state of u for each light, its turns, and where it crosses levels.

    Parameters
    ----------
    atlas, turns, guess
        As in ``Drive``; filled in.
    lights
        (levels,) light of each row.
    wave
        (bins,) w in the middle of each bin: within a bin I is taken as constant, which is exact for steps and
        of second order in the bin's length for smooth waves.
    ambient
        Constant part of I.
    bin_q
        Length of a bin in units of q.
    """
    bins = wave.size
    for j in range(lights.size):
        scale, offset = 1.0, 0.0  # u after a period = scale * u + offset
        for i in range(bins):
            intensity = ambient + lights[j] * wave[i]
            decay = exp(-intensity * bin_q)
            scale *= decay
            offset = offset * decay + (1.0 - decay) / intensity
        u = offset / (1.0 - scale)
        for i in range(bins + 1):
            atlas[j, i] = u
            intensity = ambient + lights[j] * wave[i % bins]
            u = 1.0 / intensity + (u - 1.0 / intensity) * exp(-intensity * bin_q)
        _fill_turns(atlas[j], turns[j])
        for branch in range(2):
            _fill_guess(atlas[j], turns[j], guess[branch, j], branch)


@njit(**JIT)
def _fill_turns(row: NDArray, turns: NDArray) -> None:
    """Where a row of the atlas has its largest u, and after that its smallest."""
    bins = row.size - 1
    dark, bright = row[:bins].argmax(), row[:bins].argmin()
    turns[X_DARK], turns[X_BRIGHT] = dark, bright if bright > dark else bright + bins
    turns[U_DARK], turns[U_BRIGHT] = row[dark], row[bright]
    turns[LN_BRIGHT] = log(row[bright])
    turns[LN_SPAN] = 1.0 / (log(row[dark]) - log(row[bright]))


@njit(**JIT)
def _fill_guess(row: NDArray, turns: NDArray, guess: NDArray, branch: int) -> None:
    """Bins at which a row crosses levels evenly spaced in ln u, from bright to dark."""
    bins = row.size - 1
    dark, bright = int(turns[X_DARK]), int(turns[X_BRIGHT])
    for a in range(guess.size):
        target = exp(turns[LN_BRIGHT] + a / (guess.size - 1) / turns[LN_SPAN])
        low, high = (dark, bright) if branch == 0 else (bright, dark + bins)
        while high - low > 1:
            middle = (low + high) // 2
            above = row[middle % bins] >= target
            if above == (branch == 0):
                low = middle
            else:
                high = middle
        guess[a] = low
