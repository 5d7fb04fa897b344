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
LN_DARK: Final = 2  # ln u there
LN_BRIGHT: Final = 3
N_TURNS: Final = 4

STRAIGHT: Final = np.float32(1.0)
"""Half the number of bins over which the atlas may be taken for straight."""
TRIES: Final = 3

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
    atlas: NDArray[np.float32]  # smooth: (levels, bins + 1) ln u over a period, light rising from row to row
    by_bin: NDArray[np.float32]  # the same, transposed
    turns: NDArray[np.float32]  # (levels, N_TURNS) where each row turns
    when: NDArray[np.float32]  # (2, levels, steps) bin at which ln u crosses a value, falling and rising
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
    """Let u relax towards 1 / I from its value at the last edge."""
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
    """Interpolate u at a phase on the atlas."""
    bins = drive.atlas.shape[1] - 1
    x = phase / drive.period_us * bins
    i = min(int(x), bins - 1)
    g = np.float32(x - i)
    j = int(max(level, _ZERO))
    f = level - np.float32(j)
    a = drive.by_bin[i, j] + f * (drive.by_bin[i, j + 1] - drive.by_bin[i, j])
    b = drive.by_bin[i + 1, j] + f * (drive.by_bin[i + 1, j + 1] - drive.by_bin[i + 1, j])
    return exp32(a + g * (b - a)) if level >= _ZERO else np.float32(1.0 / drive.ambient)


@njit(inline="always", **JIT)
def _between(table: NDArray, j: int, f: float, column: int) -> float:
    """Interpolate between rows j and j + 1."""
    return table[j, column] + f * (table[j + 1, column] - table[j, column])


@njit(inline="always", **JIT)
def _smooth_crossing(d: Drive, level: Any, on_at: Any, off_at: Any, phase: float) -> Any:
    """The present branch of the atlas is searched, then the one after it, as under a square light.

    Errors would add up from event to event, each taking its reference where the last one left it: that is why
    ln u is interpolated between levels, which bends less than u.
    """
    bins = np.float32(d.atlas.shape[1] - 1)
    j = int(max(level, _ZERO))
    f = level - np.float32(j)
    dark, bright = _between(d.turns, j, f, X_DARK), _between(d.turns, j, f, X_BRIGHT)
    ln_dark, ln_bright = _between(d.turns, j, f, LN_DARK), _between(d.turns, j, f, LN_BRIGHT)
    ln_on, ln_off = log32(on_at), log32(off_at)
    x = np.float32(phase / d.period_us) * bins
    turn = bins if x < dark else _ZERO  # into the period that begins in the dark: dark <= x < dark + bins
    x += turn
    rising = x >= bright
    in_now = ln_dark >= ln_off if rising else ln_bright <= ln_on
    in_next = ln_bright <= ln_on if rising else ln_dark >= ln_off
    off = rising == in_now
    target = ln_off if off else ln_on
    steps = np.float32(d.when.shape[2] - 1)
    s = min(max((target - ln_bright) / (ln_dark - ln_bright) * steps, _ZERO), steps)
    # A table says about where; from there along the slope of the atlas, unless it turns nearby.
    at = np.float32(d.when[1 if off else 0, j, np.int32(s + np.float32(0.5))])
    cross = _NEVER
    if _ONE < s < steps - _ONE:
        for _ in range(TRIES):
            i = np.int32(at)
            c = i - np.int32(bins) if i >= np.int32(bins) else i
            here, there = _between(d.atlas, j, f, c), _between(d.atlas, j, f, c + 1)
            step = (target - here) / (there - here)
            at = np.float32(i) + step
            if abs(step - np.float32(0.5)) <= STRAIGHT:
                cross = at
                break
            if not bins > abs(step):
                break
    if not dark <= cross <= dark + bins:
        cross = _crossing_bin(d, j, f, target, off)
    cross = max(cross, x) if in_now else cross + (bins if rising else _ZERO)
    never = not (in_now or in_next) or level < _ZERO
    return _NEVER if never else (cross - turn) * np.float32(d.period_us) / bins, _ZERO if off else _ONE


@njit(**JIT)
def _crossing_bin(drive: Drive, j: int, f: float, target: float, off: bool) -> float:
    """Bin at which ln u crosses the target, sought by halving on the branch of the atlas."""
    bins = drive.atlas.shape[1] - 1
    dark, bright = _between(drive.turns, j, f, X_DARK), _between(drive.turns, j, f, X_BRIGHT)
    first, last = (bright, dark + bins) if off else (dark, bright)
    low, high = int(first), int(last) + 1
    while high - low > 1:
        middle = (low + high) // 2
        if (_between(drive.atlas, j, f, middle % bins) >= target) == off:
            high = middle
        else:
            low = middle
    here, there = _between(drive.atlas, j, f, low % bins), _between(drive.atlas, j, f, high % bins)
    share = (target - here) / (there - here) if there != here else _ZERO
    return min(max(low + min(max(share, _ZERO), _ONE), first), last)


@njit(**JIT)
def fill_atlas(
    atlas: NDArray,
    turns: NDArray,
    when: NDArray,
    lights: NDArray,
    wave: NDArray,
    ambient: float,
    bin_q: float,
) -> None:
    """Tabulate the periodic steady state of ln u for each light, its turns, and where it crosses values.

    Parameters
    ----------
    atlas, turns, when
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
            atlas[j, i] = log(u)
            intensity = ambient + lights[j] * wave[i % bins]
            u = 1.0 / intensity + (u - 1.0 / intensity) * exp(-intensity * bin_q)
        _fill_turns(atlas, turns, j)
        for branch in range(2):
            _fill_when(atlas, turns, when, j, branch)


@njit(**JIT)
def _fill_turns(atlas: NDArray, turns: NDArray, j: int) -> None:
    """Where a row of the atlas has its largest u, and after that its smallest."""
    bins = atlas.shape[1] - 1
    dark = bright = 0
    for i in range(bins):
        if atlas[j, i] > atlas[j, dark]:
            dark = i
        if atlas[j, i] < atlas[j, bright]:
            bright = i
    turns[j, LN_DARK], turns[j, LN_BRIGHT] = atlas[j, dark], atlas[j, bright]
    turns[j, X_DARK], turns[j, X_BRIGHT] = dark, bright if bright > dark else bright + bins


@njit(**JIT)
def _fill_when(atlas: NDArray, turns: NDArray, when: NDArray, j: int, branch: int) -> None:
    """Bins at which a row crosses values evenly spaced in ln u, from bright to dark."""
    bins, steps = atlas.shape[1] - 1, when.shape[2]
    dark, bright = int(turns[j, X_DARK]), int(turns[j, X_BRIGHT])
    for a in range(steps):
        target = turns[j, LN_BRIGHT] + a / (steps - 1) * (turns[j, LN_DARK] - turns[j, LN_BRIGHT])
        low, high = (dark, bright) if branch == 0 else (bright, dark + bins)
        while high - low > 1:
            middle = (low + high) // 2
            if (atlas[j, middle % bins] >= target) == (branch == 1):
                high = middle
            else:
                low = middle
        here, there = atlas[j, low % bins], atlas[j, high % bins]
        when[branch, j, a] = low + ((target - here) / (there - here) if there != here else 0.0)
