"""The light as the pixels respond to it: its waveform, the photoreceptor's constants, and tables of the steady state.

Under a square light everything is closed form and nothing is tabulated, if the photoreceptor's is the only pole. Under
any other light with one rise and one fall a period, and with the source follower's pole or the high-pass (which act on
V, linearly), an atlas holds the periodic steady state of ln u over light and phase (u = exp(-V); see
``photoreceptor``). Further tables hold where each of its rows turns, and about when it crosses which value.
"""

from __future__ import annotations

import math
from functools import lru_cache
from math import exp, log, sqrt
from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulators.pixels.biases import PixelSettings
from simulators.pixels.fast_math import INNER, JIT
from simulators.world.world import LightState

# Kinds of Drive.
SQUARE: Final = 0
SMOOTH: Final = 1
BENT: Final = 2

# Rows of Drive.turns.
LN_BRIGHT: Final = 0  # smallest ln u of a period
LN_DARK: Final = 1  # largest ln u of a period
T_BRIGHT: Final = 2  # phase of the smallest; it follows T_DARK and may exceed a period
T_DARK: Final = 3  # phase of the largest
N_TURNS: Final = 4

EDGE_BEND: Final = 6.0
"""ln of the ratio of the longest to the shortest bin in a part of a square's period: curves bend most after an edge."""
ATLAS_LEVELS: Final = 128  # From one to the next, ln u is nearly linear; see ``log_step``
ATLAS_BINS: Final = 2048  # 8 us each at 60 Hz
SINE_STEPS: Final = 4
"""Steps per bin in which a sine's curves are computed, as their error falls with its square."""
WHEN_STEPS: Final = 256
"""Steps of ``Drive.when`` from one extreme of the curve to the other."""
BRIGHTEST: Final = 1.5
"""Largest light of a pixel that the atlas covers: gradients of 0.5 in all, four times the usual ones."""
LOWEST_CONTRAST: Final = 0.02
"""Relative change of brightness below which no pixel comes near its threshold."""
LEAST: Final = 1.0 + LOWEST_CONTRAST


_NO_TABLE: Final = np.zeros(1, np.float32)
_NO_TABLES: Final = np.zeros((1, 1), np.float32)


class Drive(NamedTuple):
    """The light's waveform, the photoreceptor's constants, and the tables of the steady state."""

    # SQUARE (closed form), SMOOTH (atlas with even bins) or BENT (atlas of a square light, with uneven bins).
    kind: int
    period_us: float  # Length of a period
    high_us: float  # Length of the high part of a square's period
    w_high: float  # Upper level of the light, nominal brightness = 1
    w_low: float  # Lower level of the light, nominal brightness = 1
    ambient: float  # Constant light, nominal brightness = 1
    q_us: float
    start_us: float
    # (bins + 1, levels) float32: ln u over a period; the light increases from level to level.
    atlas: NDArray[np.float32] = _NO_TABLES
    # (levels * (bins + 1),) float32: the same, one row after the other.
    flat: NDArray[np.float32] = _NO_TABLE
    # (N_TURNS, levels) float32: extremes of each level's curve, and their phases in us.
    turns: NDArray[np.float32] = _NO_TABLES
    # (2 * levels * (WHEN_STEPS + 2),) float32: phase of a crossing in us, ON and OFF, by light and height.
    when: NDArray[np.float32] = _NO_TABLE
    # (bins + 1,) float32: phases of the bins' edges, us; BENT: half of the bins in either part.
    grid: NDArray[np.float32] = _NO_TABLE
    lowest: float = 1.0  # Light of the first level; a pixel with less light never crosses a threshold
    contrast: float = 1.0  # Relative change of brightness for a light of 1
    # Step between levels in ln(1 + light * contrast), in which levels are evenly spaced: ln u is nearly
    # linear in it.
    log_step: float = 1.0


def make_drive(light: LightState, start_us: float, settings: PixelSettings) -> Drive:
    """Return the light as the pixels respond to it, with tables where there is no closed form."""
    period = light.period_us
    plain = settings.follower_us == 0.0 and settings.high_pass_hz == 0.0
    closed = light.high == light.low or (light.waveform == "square" and plain)
    shape = (light.waveform, period, light.high_share, light.high, light.low)
    tables = {} if closed else _tables(*shape, settings)
    return Drive(
        SQUARE if closed else BENT if light.waveform == "square" else SMOOTH,
        period,
        period * light.high_share,
        light.high,
        light.low,
        settings.ambient,
        settings.q_us,
        start_us,
        **tables,
    )


@lru_cache(maxsize=4)
def _tables(
    waveform: str, period: float, high_share: float, high: float, low: float, settings: PixelSettings
) -> dict[str, Any]:
    """Return the tables of a light's periodic steady states, by their names in `Drive`."""
    first = math.log(LEAST)
    log_step = (math.log1p(BRIGHTEST * high / settings.ambient) - first) / (ATLAS_LEVELS - 1)
    lights = np.expm1(first + log_step * np.arange(ATLAS_LEVELS)) * settings.ambient / high
    if waveform == "square":
        grid = _bent_grid(period, high_share)
        wave = np.tile(np.where(np.arange(ATLAS_BINS) < ATLAS_BINS // 2, high, low), (3, 1))
    else:
        grid = np.linspace(0.0, period, ATLAS_BINS + 1)
        turns = (np.arange(ATLAS_BINS * SINE_STEPS) + np.array([[0.0], [0.5], [1.0]])) / (
            ATLAS_BINS * SINE_STEPS
        )
        wave = 0.5 * (high + low) + 0.5 * (high - low) * np.sin(2.0 * np.pi * turns)
    curves = np.empty((ATLAS_LEVELS, ATLAS_BINS + 1))
    fill_curves(curves, lights, wave, settings.ambient, np.diff(grid) / settings.q_us)
    if settings.follower_us > 0.0:
        low_pass(curves, np.diff(grid) / settings.follower_us)
    if settings.high_pass_hz > 0.0:
        slow = curves.copy()
        low_pass(slow, np.diff(grid) * 1e-6 * 2.0 * math.pi * settings.high_pass_hz)
        curves -= slow
    turns = np.empty((N_TURNS, ATLAS_LEVELS), np.float32)
    when = np.empty((2, ATLAS_LEVELS, WHEN_STEPS + 2), np.float32)
    fill_when(curves, turns, when, grid)
    atlas = np.ascontiguousarray(curves.T, np.float32)
    return {
        "atlas": atlas,
        "flat": atlas.ravel(),
        "turns": turns,
        "when": when.ravel(),
        "grid": grid.astype(np.float32),
        "lowest": LOWEST_CONTRAST * settings.ambient / high,
        "contrast": high / settings.ambient,
        "log_step": log_step,
    }


def _bent_grid(period: float, high_share: float) -> NDArray[np.float64]:
    """Return the edges of bins, half of them in either part of a square's period; bins are short after an edge.

    Own choice: t = part (exp(b x) - 1) / (exp(b) - 1) for x from 0 to 1, with b = `EDGE_BEND`.
    """
    half = np.expm1(EDGE_BEND * np.linspace(0.0, 1.0, ATLAS_BINS // 2 + 1)) / np.expm1(EDGE_BEND)
    high_us = period * high_share
    return np.concatenate([high_us * half[:-1], high_us + (period - high_us) * half])


@njit(**JIT)
def fill_curves(
    curves: NDArray[np.float64],
    lights: NDArray[np.float64],
    wave: NDArray[np.float64],
    ambient: float,
    bin_q: NDArray[np.float64],
) -> None:
    """Tabulate the periodic steady state of ln u for each light in ``curves``, (levels, bins + 1) at the bins' edges.

    It solves du/dt = (1 - I u) / q; see ``photoreceptor``. Within a step, the time constant is that of the step's
    middle, and the limit 1 / I goes linearly from begin to end (a first-order hold). This is exact for a square light,
    and of second order in the step's length for a smooth one; it stays accurate however short q is. ``lights`` is
    (levels,); ``wave``, (3, steps), w at the begin, in the middle and at the end of each step, with a whole number of
    steps per bin; ``bin_q``, (bins,), the length of each bin in units of q; all float64.
    """
    bins, steps = bin_q.size, wave.shape[1] // bin_q.size
    for j in range(lights.size):
        scale, offset, u = 1.0, 0.0, 0.0  # u after a period = scale * u + offset
        for lap in range(2):
            for k in range(bins * steps):
                if lap == 1 and k % steps == 0:
                    curves[j, k // steps] = log(u)
                taus = (ambient + lights[j] * wave[1, k]) * bin_q[k // steps] / steps
                decay = exp(-taus)
                mean = (1.0 - decay) / taus
                before, after = (
                    1.0 / (ambient + lights[j] * wave[0, k]),
                    1.0 / (ambient + lights[j] * wave[2, k]),
                )
                gain = before * (mean - decay) + after * (1.0 - mean)
                scale *= decay
                offset = offset * decay + gain
                u = u * decay + gain
            if lap == 0:
                u = offset / (1.0 - scale)
        curves[j, bins] = log(u)


@njit(**JIT)
def low_pass(curves: NDArray[np.float64], bin_tau: NDArray[np.float64]) -> None:
    """Apply a first-order low-pass to each curve, in place, in its periodic steady state.

    Exact for a curve that is linear within a bin (first-order hold). ``curves``, (levels, bins + 1) float64, are values
    at the bins' edges; ``bin_tau``, (bins,) float64, is the length of each bin in time constants.
    """
    bins = bin_tau.size
    for j in range(curves.shape[0]):
        scale, offset = 1.0, 0.0  # the output after a period = scale * output + offset
        for i in range(bins):
            decay = exp(-bin_tau[i])
            mean = (1.0 - decay) / bin_tau[i]
            scale *= decay
            offset = offset * decay + curves[j, i] * (mean - decay) + curves[j, i + 1] * (1.0 - mean)
        out = offset / (1.0 - scale)
        before = curves[j, 0]
        for i in range(bins):
            decay = exp(-bin_tau[i])
            mean = (1.0 - decay) / bin_tau[i]
            curves[j, i], after = out, curves[j, i + 1]
            out = out * decay + before * (mean - decay) + after * (1.0 - mean)
            before = after
        curves[j, bins] = out


@njit(**JIT)
def fill_when(
    curves: NDArray[np.float64],
    turns: NDArray[np.float32],
    when: NDArray[np.float32],
    grid: NDArray[np.float64],
) -> None:
    """Find the extremes of each curve, and the phases at which it crosses heights between them; see ``Drive``.

    ``curves``, (levels, bins + 1) float64, hold ln u at the bins' edges, whose phases, us, are ``grid``, (bins + 1,)
    float64. Filled in: ``turns``, (N_TURNS, levels) float32, and ``when``, (2, levels, WHEN_STEPS + 2) float32, us.
    """
    bins = curves.shape[1] - 1
    period = grid[bins]
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
        turns[T_DARK, j] = grid[dark]
        turns[T_BRIGHT, j] = grid[bright - bins] + period if bright >= bins else grid[bright]
        for off in range(2):
            first, last = (bright, dark + bins) if off else (dark, bright)
            for k in range(WHEN_STEPS + 2):
                s = min(k / WHEN_STEPS, 1.0) * sqrt(2.0)
                height = s * s if s < sqrt(0.5) else 1.0 - (sqrt(2.0) - s) ** 2
                x = crossing_bin(curve, first, last, lowest + span * height, off == 1)
                whole = int(x)
                i = whole - bins if whole >= bins else whole
                t = grid[i] + (x - whole) * (grid[min(i + 1, bins)] - grid[i])
                when[off, j, k] = t + period if whole >= bins else t


@njit(**INNER)
def crossing_bin(curve: NDArray[np.float64], first: int, last: int, target: float, off: bool) -> float:
    """Return where a curve, (bins + 1,), crosses a target, by bisection between two bins, where it is monotone."""
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
