"""Stars that contradict their neighbours: gross errors of points or ids, found without any camera.

An image of a plane through any lens is smooth, so the neighbours of a star predict its point. The module compares each
star with the prediction of its neighbours. It works on arrays and knows nothing of views.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from calib.arrays import RAYLEIGH_MEDIAN, Array, Bools, Ints, median

#: Fewer stars than this cannot be compared with their neighbours.
MIN_STARS = 8
#: A star contradicts its neighbours beyond this many robust standard deviations per axis, and beyond this many pixels.
LIMIT_SIGMAS = 8.0
LIMIT_PX = 0.5
#: Smallest numbers on the diagonals of the local fits: of the constant, and of all other terms (Hoerl and Kennard,
#: 1970). They matter for neighbours on one line only.
_RIDGE_CONSTANT, _RIDGE_OTHERS = 1e-9, 1e-3
#: Number of neighbours that predict a star; on a lattice they lie within about two pitches.
_NEIGHBOURS = 14
#: On a lattice, so many more neighbours may be as far as the last one; of equals, the first ones count.
_EQUALLY_FAR = 8
#: Neighbours that differ by more than this share of their distance do not belong to one patch. Stars are compared with
#: neighbours within `_BESIDE` times the spacing of the stars: those at the corners of a square lie 1.41 away, the next
#: 2.
_PATCH_SHARE = 0.5
_BESIDE = 1.5
#: If fewer than this share of the pairs of neighbours agree, the view has no order that patches could show.
_ORDERED_SHARE = 0.4
#: Reweightings of a local fit; and tests of the stars at most: they end when none changes.
_ROUNDS = 6
#: The least limit is larger by this factor times the mean offset of the neighbours, in spacings of the stars.
_RIM_FACTOR = 4.0
#: If more than this share of the stars is suspicious, all stars are tested: the plain fits are then spoilt.
_MANY = 0.25
#: The noise of the best stars is this quantile of the stated ones.
_BEST_STARS = 0.1
#: A prediction needs this number of trusted neighbours: as many as an affine map has unknowns along an axis.
_FEWEST = 3
#: Least spread of neighbours: points without errors have none.
_ROUNDING_PX = 1e-6
#: Cut of the biweight in robust standard deviations: the usual value, 4.685, times the root of the two components.
_CUT = 6.6


@dataclass(frozen=True)
class Nearest:
    """The neighbours of N stars on the target."""

    target: Array  # (N, 2) float64 positions on the target, any unit
    which: Ints  # (N, K) int64 indices of the nearest stars of each star, nearest first
    distance: Array  # (N, K) float64 their distances
    spacing: float  # Typical distance of a star from the nearest one: the pitch of a lattice

    @cached_property
    def one_sidedness(self) -> Array:
        """(N,) float64 distance of the neighbours' mean from the star, in spacings: 0 inside, about 1 at the rim."""
        mean = (self.target[self.which] - self.target[:, None]).mean(axis=1)
        return np.hypot(mean[:, 0], mean[:, 1]) / self.spacing

    def design(self, stars: Any, *, quadratic: bool = False) -> Array:
        """Return terms of local maps about (M,) stars, in spacings: (M, K, 3) 1, x, y; or 6, with x^2, x y and y^2."""
        off = self.target[self.which[stars]] - self.target[stars][:, None]
        x, y = np.moveaxis(off / self.spacing, 2, 0)
        terms = [np.ones_like(x), x, y]
        return np.stack([*terms, x * x, x * y, y * y] if quadratic else terms, axis=2)


def nearest_stars(target: Array, most: int = _NEIGHBOURS) -> Nearest:
    """Return at most so many neighbours of each star from (N, 2) positions on the target, any unit; N >= 2."""
    from scipy.spatial import KDTree

    target, count = np.ascontiguousarray(target, np.float64), min(most, len(target) - 1)
    _, which = KDTree(target).query(target, k=min(count + 1 + _EQUALLY_FAR, len(target)))
    offsets = target[which] - target[:, None]
    squares = (offsets * offsets).sum(axis=2)
    squares[which == np.arange(len(target))[:, None]] = np.inf
    order = np.lexsort((which, squares), axis=1)[:, :count]
    which, distance = (np.take_along_axis(each, order, axis=1) for each in (which, np.sqrt(squares)))
    spacing = max(median(distance[:, 0]), np.finfo(float).tiny)
    return Nearest(target, which, distance, spacing)


def contradicts_neighbours(
    target: Array, mapped: Array, points: Array, sigmas: Array | None = None, nearest: Nearest | None = None
) -> Bools:
    """Return which stars, (N,) bool, lie far from where their neighbours predict them; none of fewer than 8 stars.

    A rough map of the plane is subtracted first, so that little but distortion and errors remains. Two tests follow.
    First: stars that agree with the stars beside them form patches. A patch is wrong if it lies beside the largest one
    and does not agree with it. Second: a local affine map of the neighbours, fitted robustly, predicts each star.
    Iteratively reweighted least squares with Tukey's biweight (Holland and Welsch, 1977), started from the median of
    the neighbours. The limit is the larger of `LIMIT_SIGMAS` robust standard deviations and `LIMIT_PX`. The deviations
    are those of all stars or of the neighbours, whichever are larger. `LIMIT_PX` is enlarged by `_RIM_FACTOR` where the
    neighbours lie on one side: at the rim of a real beam, aberrations move a star by up to 2 px against its neighbours.
    A star that is stated to be noisier than the best stars has a wider limit. Own procedure. ``target`` and ``sigmas``
    may have any unit; ``mapped``, px, is by any smooth map that roughly fits.
    """
    if len(target) < MIN_STARS:
        return np.zeros(len(target), bool)
    off = points - mapped
    nearest = nearest or nearest_stars(target)
    apart = _outside_the_largest_patch(mapped, off, nearest)
    wrong = apart.copy()
    wider = 1.0 if sigmas is None else np.maximum(sigmas / np.quantile(sigmas, _BEST_STARS), 1.0)
    least = LIMIT_PX * (1.0 + _RIM_FACTOR * nearest.one_sidedness) * wider
    plain = _plain_deviations(nearest, off)
    suspects = np.flatnonzero(wrong | ~(plain <= least))
    if len(suspects) > _MANY * len(off):
        suspects = np.arange(len(off))
    for _ in range(_ROUNDS if len(suspects) else 0):
        deviations, local = _robust_deviations(nearest, off, suspects, ~wrong)
        some = deviations if len(suspects) == len(off) else plain
        general = median(some[~wrong]) / RAYLEIGH_MEDIAN if not wrong.all() else 0.0
        noise = np.maximum(local, general * np.broadcast_to(wider, len(off))[suspects])
        beyond = deviations > np.maximum(LIMIT_SIGMAS * noise, least[suspects])
        # A star is trusted again if enough trusted neighbours now predict it.
        certain = np.count_nonzero(~wrong[nearest.which[suspects]], axis=1) >= _FEWEST
        now = apart[suspects] | beyond | (wrong[suspects] & ~certain)
        if (wrong[suspects] == now).all():
            break
        wrong[suspects] = now
    return wrong


def local_sigma_px(target: Array, mapped: Array, points: Array, nearest: Nearest | None = None) -> float:
    """Return the 1-sigma per axis, px, that neighbouring stars show, without any camera; NaN for fewer than 8.

    The median of the distances between stars and local quadratic least squares predictions, over 1.1774 = sqrt(2 ln 2),
    the median length of a two-dimensional standard normal vector. Own estimate. Arrays as of `contradicts_neighbours`.
    """
    if len(target) < MIN_STARS:
        return float("nan")
    deviations = _plain_deviations(nearest or nearest_stars(target), points - mapped, quadratic=True)
    return median(deviations) / RAYLEIGH_MEDIAN


def local_spacing(target: Array) -> float:
    """Return the typical distance of a star from the nearest one, the pitch of a lattice, for N >= 2."""
    return nearest_stars(target, 1).spacing


def _outside_the_largest_patch(mapped: Array, off: Array, nearest: Nearest) -> Bools:
    """Return which stars belong to a patch beside the largest one that does not agree with it.

    Patches are the connected components of the graph of agreeing neighbours. If hardly any neighbours agree, as with
    random ids, all stars that contradict most of their neighbours are returned instead. Own rule.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    which = nearest.which
    is_near = nearest.distance <= _BESIDE * nearest.spacing
    apart = np.linalg.norm(mapped[:, None] - mapped[which], axis=2)
    agree = is_near & (np.linalg.norm(off[:, None] - off[which], axis=2) <= _PATCH_SHARE * apart)
    if agree.sum() < _ORDERED_SHARE * is_near.sum():
        return np.asarray(2 * agree.sum(axis=1) < is_near.sum(axis=1))
    # SciPy 1.11 finds components of graphs with 32-bit indices only.
    star, neighbour = np.nonzero(agree)[0].astype(np.int32), which[agree].astype(np.int32)
    graph = coo_array((np.ones(len(star)), (star, neighbour)), shape=(len(off), len(off)))
    _, patch = connected_components(graph, directed=False)
    largest = patch == np.argmax(np.bincount(patch))
    touched = is_near & (largest[:, None] != largest[which])
    here = np.broadcast_to(np.arange(len(off))[:, None], which.shape)
    return np.isin(patch, patch[np.where(largest[:, None], which, here)[touched]])


def _plain_deviations(nearest: Nearest, off: Array, *, quadratic: bool = False) -> Array:
    """Return (N,) distances between stars and least squares predictions, in units of equal variance."""
    design = nearest.design(slice(None), quadratic=quadratic)
    solution, leverage = _solve(design, off[nearest.which], np.ones(nearest.which.shape))
    return np.asarray(np.linalg.norm(off - solution[:, 0], axis=1) / np.sqrt(1.0 + leverage))


def _robust_deviations(nearest: Nearest, off: Array, stars: Ints, trusted: Bools) -> tuple[Array, Array]:
    """Return the distances between some stars and robust predictions, and the spread of their neighbours.

    Both have the shape of `stars`; distances are in units of equal variance, spreads are standard deviations per axis.
    """
    near, design = nearest.which[stars], nearest.design(stars)
    values, usable = off[near], trusted[near]
    # A star whose neighbours are all distrusted is compared with all of them.
    usable[usable.sum(axis=1) < _FEWEST] = True
    centre = np.stack([_row_medians(values[:, :, axis], usable) for axis in (0, 1)], axis=1)
    lengths = np.linalg.norm(values - centre[:, None], axis=2)
    leverage = np.zeros(len(stars))
    for _ in range(_ROUNDS):
        local = _row_medians(lengths, usable) / RAYLEIGH_MEDIAN
        cut = _CUT * np.maximum(local, _ROUNDING_PX)[:, None]
        weights = usable * np.maximum(1.0 - (lengths / cut) ** 2, 0.0) ** 2
        solution, leverage = _solve(design, values, weights)
        centre = solution[:, 0]
        lengths = np.linalg.norm(values - design @ solution, axis=2)
    local = _row_medians(lengths, usable) / RAYLEIGH_MEDIAN
    return np.linalg.norm(off[stars] - centre, axis=1) / np.sqrt(1.0 + leverage), local


def _solve(design: Array, values: Array, weights: Array) -> tuple[Array, Array]:
    """Return weighted local fits, (N, T, 2), and the (N,) variances of their constants for unit weights.

    Normal equations with a small ridge on all but the constants, for neighbours on one line (Hoerl and Kennard, 1970).
    """
    weighted = design * weights[:, :, None]
    ridge = np.diag([_RIDGE_CONSTANT] + [_RIDGE_OTHERS] * (design.shape[2] - 1))
    inverse = np.linalg.inv(np.swapaxes(weighted, 1, 2) @ design + ridge)
    return inverse @ (np.swapaxes(weighted, 1, 2) @ values), np.maximum(inverse[:, 0, 0], 0.0)


def _row_medians(numbers: Array, usable: Bools) -> Array:
    """Return the (N,) lower medians of the usable numbers of each row; each row has at least one."""
    ordered = np.sort(np.where(usable, numbers, np.inf), axis=1)
    return np.asarray(ordered[np.arange(len(ordered)), (usable.sum(axis=1) - 1) // 2])
