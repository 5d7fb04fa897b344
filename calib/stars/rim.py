"""The rim of the beam in an image: points of the target's plane at which the light ends.

White print inside the beam is bright in the image, and white print outside of it is dark. The stars of the view map the
print into the image. So the boundary between bright and dark white print is the rim, as far as it lies in the frame.
The steps are:

1. predict where the nodes of the grid lie in the image, also those up to `_REACH` pitches beyond the last star;
2. sample the image where the print around each node is white, away from edges of the print, and express each value as
   a level: 0 is black print, 1 is white print inside the beam;
3. fit a coarse circle between bright and dark cells, and divide it into sections of one pitch;
4. fit in each section the place at which the level falls to one half.

In an event image the level falls where pixels stop firing. It does not matter which share of the light that is, if it
is the same in all directions. The module uses an image and its view; it uses no camera model.

A section counts if it has enough samples on both sides, and few on the wrong side; one without a fall shows only that
the rim lies beyond its outermost bright sample. Vignetted stars, the outermost of the beam, get a larger uncertainty:
across them the light falls off, which moves their edges outwards, and the focal length would absorb it.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from calib.arrays import Array, Bools, Ints, selected
from calib.compiled import KERNEL
from calib.errors import TooFewStars
from calib.model.homography import apply_homography, linear_at, view_homography
from calib.stars.grid_map import fit_grid_map, predict_locally
from calib.target import StarTarget
from calib.view import RimPoints, View

#: Samples farther than this from the border between bright and dark cells, pitches, do not take part in a section: from
#: 1.2 on, drawn rims are found the same, with waves of 12 % and a fall over 6 mm, too.
_BAND = 1.6
#: Widths of the fall of the level that are tried, mm: scale of a logistic function, each twice the one before.
_WIDTHS_MM = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6)
#: Least number of samples on each side of the rim, within `_NEAR` pitches, for a section to count.
_FEWEST, _NEAR = 6, 0.75
#: Largest share of the samples of a section on the wrong side of its rim.
_MOST_WRONG = 0.12
#: Standard uncertainty of the map from target to image at the rim, px, and of the brightest level: drawn rims whose
#: light falls over 4 mm lie within them (z-score 0.3 to 0.7), over 6 mm not (1.7).
_MAP_SIGMA_PX, _LEVEL_SIGMA = 0.4, 0.05
#: At most: a fit ends when no place moves farther than 0.002 mm.
_ROUNDS = 12
#: Sum of squares from which a width is clearly worse, in units of the best one.
_CLEARLY_WORSE = 1.5
#: Distance from the rim, in widths, beyond which the logistic function is 0 or 1 to a millionth.
_SATURATED = 14.0
#: Nodes farther than this from all stars, pitches, are outside of the beam.
_REACH = 3
#: Samples along each side of a node's cell, and their least distance from an edge of the print, pitches: first of all
#: cells, then of those near the rim.
_COARSE, _FINE = (24, 0.055), (56, 0.04)

#: A border whose width is at most this share of its length may be straight.
_FLAT = 0.35

#: Grey values of dark and bright print inside the beam, and whether white print is the dark one.
_Levels = tuple[float, float, bool]

#: Standard uncertainty per axis that is added to a vignetted star's own, px. In simulated beams the outermost stars
#: are all shifted outwards by 0.03 px, which changes f by 2 sigma. With this uncertainty they have little weight.
VIGNETTED_SIGMA_PX = 0.2
#: Distance from the border of the frame, pitches, within which a neighbour is missing because of the border: a star
#: counts only with its whole cell, half a pitch to each side.
_BORDER_PITCHES = 0.55
_NEIGHBOURS = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)])


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
    is_rim = _accepted(section, rho, levels, fit, pitch_mm)
    direction = middle + fit.shift / radius
    points = centre + fit.place[:, None] * np.column_stack([np.cos(direction), np.sin(direction)])
    lit = _last_bright(all_sections, all_rho, coarse.levels > 0.5, np.isnan(start), pitch_mm)
    sigmas_mm = np.hypot(fit.sigma[is_rim], _MAP_SIGMA_PX / px_per_mm)
    return RimPoints(points[is_rim], sigmas_mm, coarse.places_mm[lit], _LEVEL_SIGMA * fit.width)


def _polar(offsets: Array, count: int) -> tuple[Ints, Array, Array]:
    """Return section, distance and direction of points relative to the circle's centre."""
    phi = np.arctan2(offsets[:, 1], offsets[:, 0])
    section = np.minimum(((phi + np.pi) * (count / (2.0 * np.pi))).astype(np.int64), count - 1)
    return section, np.hypot(*offsets.T), phi


class _Fall(NamedTuple):
    """Where the level falls in each section."""

    place: Array  # (C,) distance of the rim from the circle's centre, mm; nan if a section has no rim
    sigma: Array  # (C,) 1-sigma of the place, mm; nan if a section has no rim
    # (C,) distance along the rim from the middle of the section to the middle of the samples that show it,
    # mm.
    shift: Array
    width: float  # Width of the fall from 1 to 0, mm, alike in all sections


def _start(border_mm: Array, centre: Array, section: Ints, rho: Array, levels: Array, count: int) -> Array:
    """Return the (C,) distances, mm, that part bright from dark samples best; nan in sections without a border."""
    start = np.full(count, np.nan)
    if not len(border_mm):
        return start
    _, distance, phi = _polar(border_mm - centre, count)
    at = (phi + np.pi) * (count / (2.0 * np.pi)) - 0.5
    apart = np.abs((at[None, :] - np.arange(count)[:, None] + count / 2) % count - count / 2)
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


def _fall(section: Ints, rho: Array, along: Array, levels: Array, start: Array) -> _Fall:
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
            # Ridges, for sections without samples near the fall, and with all of them at one place along it.
            a, b, c = sums[0] + 1e-3, sums[1], sums[2] + 1e-1
            determinant = a * c - b * b
            step = (c * sums[3] - b * sums[4]) / determinant
            if np.nanmax(np.abs(step), initial=0.0) < 2e-3:
                break
            # Steps are cut: beyond some widths the logistic function is flat, and a whole step would run away.
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


def _accepted(section: Ints, rho: Array, levels: Array, fit: _Fall, pitch_mm: float) -> Bools:
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


def _last_bright(section: Ints, rho: Array, bright: Bools, open_: Bools, pitch_mm: float) -> Ints:
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


class _Map(NamedTuple):
    """Map of a view: (N, 2) nodes, and for each its (2,) image point and (2, 2) derivatives, px and px per pitch."""

    nodes: Ints
    points: Array
    linear: Array


def find_rim(image: NDArray[Any], view: View, target: StarTarget) -> RimPoints | None:
    """Find the rim of the beam in the image, of events or a photograph, in which the stars of a view were found.

    Points at which the light ends, and at which the frame ends inside the beam. None if the stars are too few for a
    map, or bright and dark print do not differ. Own procedure; the head of the module describes it.
    """
    try:
        mapped = _map_nodes(view, target)
    except TooFewStars:
        return None
    own = np.isin(target.id_at(mapped.nodes[:, 0], mapped.nodes[:, 1]), view.ids)
    levels = _levels(image, selected(mapped, own), target)
    if levels is None:
        return None
    coarse, values, inside = _sample(image, mapped, levels, target, _COARSE)
    border = _border_mm(*_cells(mapped.nodes, values, inside, target), target.pitch_mm)
    centre, radius = _coarse_circle(border, coarse)
    fine = coarse
    if len(border):
        apart = np.abs(mapped.nodes[:, None, :] * target.pitch_mm - border).max(axis=2).min(axis=1)
        fine, _, _ = _sample(image, selected(mapped, apart < 2.0 * target.pitch_mm), levels, target, _FINE)
    spread_px, spread_mm = (each - each.mean(axis=0) for each in (view.points_px, view.target_mm))
    px_per_mm = float(np.sqrt((spread_px**2).sum() / (spread_mm**2).sum()))
    return rim_in_sections((coarse, fine), border, centre, radius, target.pitch_mm, px_per_mm)


@lru_cache(maxsize=8)
def _print_offsets(target: StarTarget, along: int, clearance: float) -> tuple[Array, Array]:
    """Return a cell's white (W, 2) and black (B, 2) places, pitches; print within the clearance is of one kind."""
    steps = (np.arange(along) + 0.5) / along - 0.5
    places = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    turn = np.arange(12) * np.pi / 6.0
    around = np.vstack([[[0.0, 0.0]], clearance * np.column_stack([np.cos(turn), np.sin(turn)])])
    if not len(target.surrounded):
        return np.zeros((0, 2)), np.zeros((0, 2))
    at = (target.surrounded[0] + places[:, None, :] + around) * target.pitch_mm
    bright = target.reflectance(at[..., 0], at[..., 1])
    return places[(bright > 0.5).all(axis=1)], places[(bright < 0.5).all(axis=1)]


def _map_nodes(view: View, target: StarTarget) -> _Map:
    """Map the nodes near the stars into the image. Raises TooFewStars."""
    grid = target.node_of(view.ids)
    nodes = _nodes_near(grid, target)
    fitted, _ = fit_grid_map(grid.astype(float), view.points_px)
    points = predict_locally(fitted.homography, grid.astype(float), view.points_px, nodes.astype(float))
    return _Map(nodes, points, linear_at(fitted.homography, nodes.astype(float)))


def _levels(image: NDArray[Any], stars: _Map, target: StarTarget) -> _Levels | None:
    """Return the levels of dark and bright print at the stars; None if they do not differ clearly."""
    white, black = _print_offsets(target, *_COARSE)
    if not len(white) or not len(black):
        return None
    bright, dark = (_values(image, stars, offsets)[0] for offsets in (white, black))
    at_white, at_black = float(np.nanmedian(bright)), float(np.nanmedian(dark))
    # From 1 sigma below the median to 1 above it, of normal levels.
    low, high = np.nanpercentile(bright if at_white > at_black else dark, [16.0, 84.0])
    if not abs(at_white - at_black) > 0.5 * (high - low):
        return None
    return min(at_white, at_black), max(at_white, at_black), at_white < at_black


def _sample(
    image: NDArray[Any], mapped: _Map, levels: _Levels, target: StarTarget, density: tuple[int, float]
) -> tuple[Samples, Array, Bools]:
    """Sample the bright print around nodes; return also the (N, K) levels, nan outside, and which are inside."""
    dark, bright, inverted = levels
    offsets = _print_offsets(target, *density)[int(inverted)]
    values, inside = _values(image, mapped, offsets)
    values = (values - dark) / (bright - dark)
    places = ((mapped.nodes[:, None, :] + offsets) * target.pitch_mm)[inside]
    return Samples(places, values[inside]), values, inside


def _cells(nodes: Ints, values: Array, inside: Bools, target: StarTarget) -> tuple[Bools, Bools]:
    """Return which nodes of the target have bright cells, (rows, columns), and which are in the frame."""
    framed = np.zeros((target.rows, target.columns), np.bool_)
    bright, seen = framed.copy(), inside.sum(axis=1)
    at = nodes[:, 1], nodes[:, 0]
    framed[at] = seen >= 0.25 * inside.shape[1]
    bright[at] = (values > 0.5).sum(axis=1) > 0.5 * np.maximum(seen, 1)
    return bright & framed, framed


def _nodes_near(grid: Ints, target: StarTarget) -> Ints:
    """Return the (N, 2) printed nodes near the stars."""
    taken = np.zeros((target.rows, target.columns), np.uint8)
    taken[grid[:, 1], grid[:, 0]] = 1
    near = cv2.dilate(taken, np.ones((2 * _REACH + 1, 2 * _REACH + 1), np.uint8))
    nodes = target.node_of(target.ids)
    return nodes[near[nodes[:, 1], nodes[:, 0]] > 0]


def _values(image: NDArray[Any], mapped: _Map, offsets: Array) -> tuple[Array, Bools]:
    """Return the (N, K) grey values at K places around each node, nan outside of the frame, and which are inside."""
    at = mapped.points[:, :, None] + mapped.linear @ offsets.T
    u, v = np.rint(at).astype(np.int32).transpose(1, 0, 2)
    inside = (u >= 0) & (u < image.shape[1]) & (v >= 0) & (v < image.shape[0])
    values = np.full(inside.shape, np.nan)
    values[inside] = image[v[inside], u[inside]]
    return values, inside


def _border_mm(bright: Bools, framed: Bools, pitch_mm: float) -> Array:
    """Return the (B, 2) mm places half-way between neighbouring bright and dark cells.

    Dark cells count only if they reach the frame's border or the last nodes; others are spots inside the beam.
    """
    dark = (framed & ~bright).astype(np.uint8)
    _, parts = cv2.connectedComponents(dark, connectivity=8)
    outside = cv2.dilate((~framed).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    outside[[0, -1]] = outside[:, [0, -1]] = True
    reaching = np.unique(parts[outside & (dark > 0)])
    outer = np.isin(parts, reaching) & (dark > 0)
    places = []
    for axis in (0, 1):
        step = np.array([axis == 1, axis == 0], float)
        a, b = (np.delete(bright, i, axis=axis) for i in (-1, 0))
        c, d = (np.delete(outer, i, axis=axis) for i in (-1, 0))
        places.append(np.argwhere((a & d) | (b & c))[:, ::-1] + 0.5 * step)
    return np.asarray(np.concatenate(places) * pitch_mm)


def _coarse_circle(border_mm: Array, samples: Samples) -> tuple[Array, float]:
    """Fit a circle to the border between bright and dark cells; without a border, one about the bright samples.

    Linear least squares for x^2 + y^2 = 2 a x + 2 b y + c (Kåsa, 1976). The circle only divides the rim into sections:
    if the border is almost straight or curved the other way, it is twice as large as the bright part, on its side.
    """
    lit = samples.places_mm[samples.levels > 0.5]
    middle = lit.mean(axis=0)
    reach = float(np.linalg.norm(lit - middle, axis=1).max())
    if len(border_mm) < 3:
        return middle, reach
    origin = border_mm.mean(axis=0)
    offset = border_mm - origin
    design = np.column_stack([2.0 * offset, np.full(len(offset), reach)])
    weak = np.diag([1.0, 1.0, 0.0])
    a, b, _ = np.linalg.solve(design.T @ design + weak, design.T @ (offset**2).sum(axis=1))
    centre = np.array([a, b])
    inward = middle - origin
    _, lengths, axes = np.linalg.svd(offset, full_matrices=False)
    least = (0.5 if lengths[1] < _FLAT * lengths[0] else -0.5) * lengths[0] ** 2 / len(offset)
    if centre @ inward <= least or np.linalg.norm(centre) > 4.0 * reach:
        normal = axes[1] * np.sign(axes[1] @ inward)
        centre = 2.0 * reach * normal
    return origin + centre, float(np.sqrt(np.mean(((offset - centre) ** 2).sum(axis=1))))


def vignetted_stars(view: View, target: StarTarget) -> Bools:
    """Find the outermost stars of the beam: those without a neighbour that would lie inside the frame.

    Own rule: the neighbour must be expected more than `_BORDER_PITCHES` from the frame's border, and not at the tag.
    """
    mapping = view_homography(view)
    nodes = target.node_of(view.ids)
    around = nodes[:, None, :] + _NEIGHBOURS
    ids = target.id_at(around[..., 0], around[..., 1])
    absent = (ids >= 0) & ~np.isin(ids, view.ids)
    expected_px = apply_homography(mapping, (around * target.pitch_mm).reshape(-1, 2)).reshape(*around.shape)
    pitch_px = np.linalg.norm(expected_px - view.points_px[:, None, :], axis=2).min(axis=1)
    border_px = _BORDER_PITCHES * pitch_px[:, None, None]
    last = np.array(view.image_size) - 1.0
    inside = ((expected_px >= border_px) & (expected_px <= last - border_px)).all(axis=2)
    return np.asarray((absent & inside).any(axis=1))


def downweight_vignetted(view: View, target: StarTarget) -> View:
    """Add the variance of `VIGNETTED_SIGMA_PX`, per axis, to vignetted stars: an independent error (own model)."""
    added = np.where(vignetted_stars(view, target), VIGNETTED_SIGMA_PX**2, 0.0)
    return replace(view, covariances_px2=view.covariances_px2 + added[:, None, None] * np.eye(2))
