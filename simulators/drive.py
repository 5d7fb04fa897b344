"""The light as the pixels feel it: its waveform, the photoreceptor's constants, and tables of where they lead.

Under a square light everything is closed form and there is nothing to tabulate. Under any other light with one
rise and one fall a period, an atlas holds the periodic steady state of ln u over light and phase (u = exp(-V);
see ``photoreceptor``), where each of its rows turns, and about when it crosses which value.
"""

from __future__ import annotations

import math
from math import exp, log, sqrt
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulators.biases import PixelSettings
from simulators.fast_math import JIT
from simulators.world import LightState

SQUARE: Final = 0
SMOOTH: Final = 1

# Rows of Drive.turns.
LN_BRIGHT: Final = 0  # smallest ln u of a period
LN_DARK: Final = 1  # largest
T_BRIGHT: Final = 2  # phase of the smallest, after the largest: up to a period later
T_DARK: Final = 3
N_TURNS: Final = 4

ATLAS_LEVELS: Final = 128
ATLAS_BINS: Final = 2048
WHEN_STEPS: Final = 256
"""Steps of ``Drive.when`` from one turn of the curve to the other."""
BRIGHTEST: Final = 1.5
"""Highest light of a pixel that the atlas covers."""
LOWEST_CONTRAST: Final = 0.02
"""Relative change of brightness below which no pixel is ever near its threshold."""
LEAST: Final = 1.0 + LOWEST_CONTRAST


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
    atlas: NDArray[
        np.float32
    ]  # smooth: (bins + 1, levels) ln u over a period, light rising from level to level
    flat: NDArray[np.float32]  # the same, one row after the other
    turns: NDArray[np.float32]  # (N_TURNS, levels) where each level's curve turns
    when: NDArray[
        np.float32
    ]  # (2 * levels * (WHEN_STEPS + 2),) phase of a crossing, ON and OFF, by light and height
    lowest: float  # light of the first row; below, nothing ever crosses
    contrast: float  # relative change of brightness for a light of 1; levels are evenly spaced in
    log_step: float  # ln of 1 + light * contrast: ln u is nearly linear in it


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
    NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], float, float, float
]


def _no_atlas() -> _Atlas:
    """Placeholders where u is closed form."""
    one = np.zeros((1, 1), np.float32)
    flat = np.zeros(1, np.float32)
    return one, flat, one, flat, 1.0, 1.0, 1.0


def _atlas(light: LightState, settings: PixelSettings) -> _Atlas:
    """Atlas of a sine's periodic steady states, as ``Drive`` has it."""
    lowest = LOWEST_CONTRAST * settings.ambient / light.high
    first = math.log(LEAST)
    log_step = (math.log1p(BRIGHTEST * light.high / settings.ambient) - first) / (ATLAS_LEVELS - 1)
    lights = np.expm1(first + log_step * np.arange(ATLAS_LEVELS)) * settings.ambient / light.high
    phase = (np.arange(ATLAS_BINS) + 0.5) / ATLAS_BINS
    wave = 0.5 * (light.high + light.low) + 0.5 * (light.high - light.low) * np.sin(2.0 * np.pi * phase)
    curves = np.empty((ATLAS_LEVELS, ATLAS_BINS + 1))
    turns = np.empty((N_TURNS, ATLAS_LEVELS), np.float32)
    when = np.empty((2, ATLAS_LEVELS, WHEN_STEPS + 2), np.float32)
    bin_q = light.period_us / ATLAS_BINS / settings.q_us
    fill_curves(curves, lights, wave, settings.ambient, bin_q)
    fill_when(curves, turns, when, light.period_us)
    contrast = light.high / settings.ambient
    atlas = np.ascontiguousarray(curves.T, np.float32)
    return atlas, atlas.ravel(), turns, when.ravel(), lowest, contrast, log_step


@njit(**JIT)
def fill_curves(curves: NDArray, lights: NDArray, wave: NDArray, ambient: float, bin_q: float) -> None:
    """Tabulate the periodic steady state of ln u for each light.

    Parameters
    ----------
    curves
        (levels, bins + 1) ln u at the bins' edges; filled in.
    lights
        (levels,) light of each level.
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
            curves[j, i] = log(u)
            intensity = ambient + lights[j] * wave[i % bins]
            u = 1.0 / intensity + (u - 1.0 / intensity) * exp(-intensity * bin_q)


@njit(**JIT)
def fill_when(curves: NDArray, turns: NDArray, when: NDArray, period: float) -> None:
    """Find where each curve turns, and when it crosses the heights between its turns; as in ``Drive``."""
    bins = curves.shape[1] - 1
    bin_us = period / bins
    for j in range(curves.shape[0]):
        curve = curves[j]
        dark = bright = 0
        for i in range(bins):
            if curve[i] > curve[dark]:
                dark = i
            if curve[i] < curve[bright]:
                bright = i
        lowest, span = curve[bright], curve[dark] - curve[bright]
        if bright < dark:
            bright += bins
        turns[LN_BRIGHT, j], turns[LN_DARK, j] = lowest, lowest + span
        turns[T_BRIGHT, j], turns[T_DARK, j] = bright * bin_us, dark * bin_us
        for off in range(2):
            first, last = (bright, dark + bins) if off else (dark, bright)
            for k in range(WHEN_STEPS + 2):
                s = min(k / WHEN_STEPS, 1.0) * sqrt(2.0)
                height = s * s if s < sqrt(0.5) else 1.0 - (sqrt(2.0) - s) ** 2
                x = crossing_bin(curve, first, last, lowest + span * height, off == 1)
                when[off, j, k] = x * bin_us


@njit(**JIT)
def crossing_bin(curve: NDArray, first: int, last: int, target: float, off: bool) -> float:
    """Bin at which a curve crosses the target, sought by halving on the branch between two bins."""
    bins = curve.size - 1
    low, high = first, last
    while high - low > 1:
        middle = (low + high) // 2
        if (curve[middle % bins] >= target) == off:
            high = middle
        else:
            low = middle
    here, there = curve[low % bins], curve[high % bins]
    share = (target - here) / (there - here) if there != here else 0.0
    return low + min(max(share, 0.0), 1.0)
