"""The place of the rim in each of many sections of a circle, from samples of white print.

A section is as long as a pitch of the grid. In each, the level of the samples falls from 1 to 0 across the rim, by a
logistic function of the distance, with one width for all sections of a view. A section counts if it has enough samples
on both sides, and few on the wrong side. A section without a fall shows only that the rim lies beyond its outermost
bright sample. The module uses samples with places and levels, no image.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from calib.compiled import KERNEL
from calib.view import RimPoints

Array = NDArray[np.float64]

#: Samples farther than this from the border between bright and dark cells, pitches, do not take part in a section.
_BAND = 1.6
#: Widths of the fall of the level that are tried, mm: scale of a logistic function.
_WIDTHS_MM = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6)
#: Least number of samples on each side of the rim, within `_NEAR` pitches, for a section to count.
_FEWEST, _NEAR = 6, 0.75
#: Largest share of the samples of a section on the wrong side of its rim.
_MOST_WRONG = 0.12
#: Standard uncertainty of the map from target to image at the rim, px, and of the brightest level.
_MAP_SIGMA_PX, _LEVEL_SIGMA = 0.4, 0.05
_ROUNDS = 12
#: Sum of squares from which a width is clearly worse, in units of the best one.
_CLEARLY_WORSE = 1.5
#: Distance from the rim, in widths, beyond which the logistic function is 0 or 1.
_SATURATED = 14.0


class Samples(NamedTuple):
    """Samples of white print."""

    places_mm: Array  # (M, 2) float64, mm, their places on the target
    levels: Array  # (M,) float64, 0 is black print and 1 is white print inside the beam


def rim_in_sections(
    sampled: tuple[Samples, Samples],
    border_mm: Array,
    centre: Array,
    radius: float,
    pitch_mm: float,
    px_per_mm: float,
) -> RimPoints:
    """Find the rim in each section of a circle, one pitch long; elsewhere the last bright point in the frame.

    Own procedure; the head of the module describes it. ``border_mm`` are (B, 2) places between bright and dark cells.
    """
    count = max(int(np.ceil(2.0 * np.pi * radius / pitch_mm)), 8)
    middle = (np.arange(count) + 0.5) * (2.0 * np.pi / count) - np.pi
    (all_sections, all_rho, _), (section, rho, phi) = (_polar(s.places_mm - centre, count) for s in sampled)
    coarse, fine = sampled
    start = _start(border_mm, centre, section, rho, fine.levels, count)
    near = np.abs(rho - start[section]) < _BAND * pitch_mm
    section, rho, phi, levels = section[near], rho[near], phi[near], fine.levels[near]
    fit = _fall(section, rho, (phi - middle[section]) * radius, levels, start)
    found = _accepted(section, rho, levels, fit, pitch_mm)
    direction = middle + fit.shift / radius
    points = centre + fit.place[:, None] * np.column_stack([np.cos(direction), np.sin(direction)])
    lit = _last_bright(all_sections, all_rho, coarse.levels > 0.5, np.isnan(start), pitch_mm)
    return RimPoints(
        points[found],
        np.hypot(fit.sigma[found], _MAP_SIGMA_PX / px_per_mm),
        coarse.places_mm[lit],
        _LEVEL_SIGMA * fit.width,
    )


def _polar(away: Array, count: int) -> tuple[NDArray[np.int64], Array, Array]:
    """Return section, distance and direction of points relative to the circle's centre."""
    phi = np.arctan2(away[:, 1], away[:, 0])
    section = np.minimum(((phi + np.pi) * (count / (2.0 * np.pi))).astype(np.int64), count - 1)
    return section, np.hypot(*away.T), phi


class _Fall(NamedTuple):
    """Where the level falls in each section."""

    # place, sigma: (C,) distance of the rim from the circle's centre and its 1-sigma, mm; nan if a section
    # has no rim.
    place: Array
    sigma: Array
    # (C,) distance along the rim from the middle of the section to the middle of the samples that show it,
    # mm.
    shift: Array
    width: float  # Width of the fall from 1 to 0, mm, alike in all sections


def _start(
    border_mm: Array, centre: Array, section: NDArray[np.int64], rho: Array, levels: Array, count: int
) -> Array:
    """Return the (C,) distances, mm, that part bright from dark samples best; nan in sections without a border."""
    start = np.full(count, np.nan)
    if not len(border_mm):
        return start
    away = border_mm - centre
    at = ((np.arctan2(away[:, 1], away[:, 0]) + np.pi) * (count / (2.0 * np.pi))) - 0.5
    apart = np.abs((at[None, :] - np.arange(count)[:, None] + count / 2) % count - count / 2)
    distance = np.hypot(*away.T)
    near = apart < 1.2
    has = near.any(axis=1)
    start[has] = (near[has] * distance).sum(axis=1) / near[has].sum(axis=1)
    # The best split of each section, in steps of a tenth of a millimetre.
    step, half = 0.1, 70
    split = np.rint((rho - start[section]) / step)
    used = np.abs(split) < half
    index = section[used] * (2 * half) + (split[used] + half).astype(np.int64)
    votes = np.bincount(index, np.where(levels[used] > 0.5, 1.0, -1.0), count * 2 * half)
    best = np.argmax(np.cumsum(votes.reshape(count, -1), axis=1), axis=1)
    return np.asarray(start + (best + 0.5 - half) * step)


def _fall(section: NDArray[np.int64], rho: Array, along: Array, levels: Array, start: Array) -> _Fall:
    """Fit a logistic fall of the level in each section: its place and its slope along the rim; and one width for all.

    Nonlinear least squares by Gauss-Newton (Björck, 1996, section 9.2) of 1 / (1 + exp((rho - place - slope t) /
    width)), with t along the rim. The sums have one minimum over the width: wider than a clearly worse one is not
    tried.
    """
    level = np.clip(levels, -0.3, 1.3)
    nothing = np.full(len(start), np.nan)
    best, best_squares = _Fall(start, nothing, nothing, 0.0), np.inf
    for width in _WIDTHS_MM:
        place, slope = start.copy(), np.zeros(len(start))
        for _ in range(_ROUNDS):
            sums, squares = _fall_sums(section, rho, along, level, place, slope, width)
            a, b, c = sums[0] + 1e-3, sums[1], sums[2] + 1e-1
            determinant = a * c - b * b
            step = (c * sums[3] - b * sums[4]) / determinant
            if np.nanmax(np.abs(step), initial=0.0) < 2e-3:
                break
            place = place + np.clip(step, -0.5, 0.5)
            slope = np.clip(slope + np.clip((a * sums[4] - b * sums[3]) / determinant, -0.2, 0.2), -1.5, 1.5)
        if squares < best_squares:
            noise = float(sums[5].sum() / max(sums[0].sum(), 1e-12))
            shift = b / a
            best = _Fall(place + slope * shift, np.sqrt(noise / a), shift, 4.0 * width)
            best_squares = squares
        elif squares > _CLEARLY_WORSE * best_squares:
            break
    return best


@njit(**KERNEL)
def _fall_sums(
    section: Any, rho: Any, along: Any, levels: Any, place: Any, slope: Any, width: float
) -> tuple[Any, float]:
    """Return (6, C) sums of the normal equations and of the noise of each section, and the sum of squares of all."""
    sums, squares = np.zeros((6, place.size)), 0.0
    for i in range(rho.size):
        k = section[i]
        t = along[i]
        beyond = (rho[i] - place[k] - slope[k] * t) / width
        if abs(beyond) > _SATURATED:
            off = levels[i] - (1.0 if beyond < 0.0 else 0.0)
            squares += off * off
            continue
        model = 1.0 / (1.0 + math.exp(beyond))
        off = levels[i] - model
        squares += off * off
        gain = model * (1.0 - model) / width
        weighted = gain * gain
        sums[0, k] += weighted
        sums[1, k] += weighted * t
        sums[2, k] += weighted * t * t
        sums[3, k] += gain * off
        sums[4, k] += gain * off * t
        sums[5, k] += weighted * off * off
    return sums, squares


def _accepted(
    section: NDArray[np.int64], rho: Array, levels: Array, fit: _Fall, pitch_mm: float
) -> NDArray[np.bool_]:
    """Return which sections have enough samples on both sides of the rim and few on the wrong side, (C,) bool."""
    count = len(fit.place)
    beyond = rho - fit.place[section]
    inner = np.bincount(section[(beyond < 0) & (beyond > -_NEAR * pitch_mm)], minlength=count)
    outer = np.bincount(section[(beyond > 0) & (beyond < _NEAR * pitch_mm)], minlength=count)
    clear = np.abs(beyond) > 0.5 * fit.width
    wrong = np.bincount(section[clear & ((levels > 0.5) == (beyond > 0))], minlength=count)
    total = np.maximum(np.bincount(section[clear], minlength=count), 1)
    good = (inner >= _FEWEST) & (outer >= _FEWEST) & (wrong <= _MOST_WRONG * total)
    return np.asarray(good & np.isfinite(fit.place) & (fit.sigma < 0.5 * pitch_mm))


def _last_bright(
    section: NDArray[np.int64],
    rho: Array,
    bright: NDArray[np.bool_],
    open_: NDArray[np.bool_],
    pitch_mm: float,
) -> NDArray[np.int64]:
    """Return the numbers of the outermost bright samples of open sections that are bright out to the frame's border."""
    last = np.zeros(len(open_))
    np.maximum.at(last, section, rho)
    outer = rho > last[section] - 2.0 * pitch_mm
    count = len(open_)
    dark = np.bincount(section[outer & ~bright], minlength=count)
    lit = np.bincount(section[outer & bright], minlength=count)
    whole = open_ & (dark <= 0.03 * lit) & (lit >= _FEWEST)
    chosen = np.flatnonzero(bright & whole[section])
    order = chosen[np.lexsort((rho[chosen], section[chosen]))]
    ends = np.flatnonzero(np.diff(section[order], append=-1))
    return np.asarray(order[ends])
