"""The light as the pixels feel it: its waveform, the photoreceptor's constants, and tables of where they lead.

Under a square light everything is closed form and there is nothing to tabulate. Under any other light with one
rise and one fall a period, an atlas holds the periodic steady state of ln u over light and phase (u = exp(-V);
see ``photoreceptor``), where each of its rows turns, and about when it crosses which value.
"""

from __future__ import annotations

import math
from math import exp, log
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulators.biases import PixelSettings
from simulators.fast_math import JIT
from simulators.world import LightState

SQUARE: Final = 0
SMOOTH: Final = 1

# Columns of Drive.turns.
X_DARK: Final = 0  # bin of the largest u, and of the smallest, up to one period later
X_BRIGHT: Final = 1
U_DARK: Final = 2  # u there
U_BRIGHT: Final = 3
LN_BRIGHT: Final = 4  # ln u, and steps of ``Drive.when`` for each unit of it
LN_STEPS: Final = 5
N_TURNS: Final = 6

ATLAS_LEVELS: Final = 128
ATLAS_BINS: Final = 2048
WHEN_STEPS: Final = 256
BRIGHTEST: Final = 1.5
"""Highest light of a pixel that the atlas covers."""
LOWEST_CONTRAST: Final = 0.02
"""Relative change of brightness below which no pixel is ever near its threshold."""


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


def make_drive(light: LightState, start_us: float, settings: PixelSettings) -> Drive:
    """The light as the pixels feel it, a period beginning at ``start_us`` of the sensor's clock."""
    period = light.period_us
    steady = light.waveform == "square" or light.high == light.low
    tables = _no_atlas() if steady else _atlas(light, settings)
    return Drive(
        SQUARE if steady else SMOOTH,
        period,
        period * light.high_share,
        light.high,
        light.low,
        settings.ambient,
        settings.q_us,
        start_us,
        *tables,
    )


_Atlas = tuple[
    NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], float, float
]


def _no_atlas() -> _Atlas:
    """Placeholders where u is closed form."""
    one = np.zeros((1, 1), np.float32)
    return one, one, one, np.zeros((1, 1, 1), np.float32), 1.0, 1.0


def _atlas(light: LightState, settings: PixelSettings) -> _Atlas:
    """Atlas of a sine's periodic steady states, as ``Drive`` has it."""
    lowest = LOWEST_CONTRAST * settings.ambient / light.high
    log_step = math.log(BRIGHTEST / lowest) / (ATLAS_LEVELS - 1)
    lights = lowest * np.exp(log_step * np.arange(ATLAS_LEVELS))
    phase = (np.arange(ATLAS_BINS) + 0.5) / ATLAS_BINS
    wave = 0.5 * (light.high + light.low) + 0.5 * (light.high - light.low) * np.sin(2.0 * np.pi * phase)
    atlas = np.empty((ATLAS_LEVELS, ATLAS_BINS + 1), np.float32)
    turns = np.empty((ATLAS_LEVELS, N_TURNS), np.float32)
    when = np.empty((2, ATLAS_LEVELS, WHEN_STEPS), np.float32)
    bin_q = light.period_us / ATLAS_BINS / settings.q_us
    fill_atlas(atlas, turns, when, lights, wave, settings.ambient, bin_q)
    return atlas, np.ascontiguousarray(atlas.T), turns, when, lowest, log_step


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
        _fill_turns(atlas, turns, j, when.shape[2])
        for branch in range(2):
            _fill_when(atlas, turns, when, j, branch)


@njit(**JIT)
def _fill_turns(atlas: NDArray, turns: NDArray, j: int, steps: int) -> None:
    """Where a row of the atlas has its largest u, and after that its smallest."""
    bins = atlas.shape[1] - 1
    dark = bright = 0
    for i in range(bins):
        if atlas[j, i] > atlas[j, dark]:
            dark = i
        if atlas[j, i] < atlas[j, bright]:
            bright = i
    turns[j, U_DARK], turns[j, U_BRIGHT] = exp(atlas[j, dark]), exp(atlas[j, bright])
    turns[j, LN_BRIGHT], turns[j, LN_STEPS] = (
        atlas[j, bright],
        (steps - 1) / (atlas[j, dark] - atlas[j, bright]),
    )
    turns[j, X_DARK], turns[j, X_BRIGHT] = dark, bright if bright > dark else bright + bins


@njit(**JIT)
def _fill_when(atlas: NDArray, turns: NDArray, when: NDArray, j: int, branch: int) -> None:
    """Bins at which a row crosses values evenly spaced in ln u, from bright to dark."""
    bins, steps = atlas.shape[1] - 1, when.shape[2]
    dark, bright = int(turns[j, X_DARK]), int(turns[j, X_BRIGHT])
    for a in range(steps):
        target = turns[j, LN_BRIGHT] + a / turns[j, LN_STEPS]
        low, high = (dark, bright) if branch == 0 else (bright, dark + bins)
        while high - low > 1:
            middle = (low + high) // 2
            if (atlas[j, middle % bins] >= target) == (branch == 1):
                high = middle
            else:
                low = middle
        here, there = atlas[j, low % bins], atlas[j, high % bins]
        when[branch, j, a] = low + ((target - here) / (there - here) if there != here else 0.0)
