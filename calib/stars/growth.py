"""From the first stars to all: growth over the grid, where the stars found predict their neighbours.

The order is outwards (Schöps et al., 2020, arXiv:1912.02908). `calib.stars.grid_map` predicts a star's place; around it
the place that correlates best with `calib.stars.template` is searched, in steps of one pixel, by compiled functions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from calib.compiled import INNER, INNER_WITH_ARRAYS, KERNEL
from calib.model.homography import apply_homography, fit_affine, fit_homography, linear_at
from calib.stars.grid_map import predict_locally
from calib.stars.tag import TagDetection
from calib.stars.template import MIN_COVERED, SEARCH_RADII, SHARP_CORRELATION, StarTemplate
from calib.target import StarTarget

# Search of a star around a guess: the place, in steps of one pixel, that correlates best with its pattern.

#: Standard deviation, as a share of the brightness, up to which an image counts as flat: single precision is right to
#: 6e-8.
FLAT = 2e-6
#: Relative error of a sum in single precision, with a margin: a variance that is smaller than this share of the squared
#: mean is rounding.
ROUNDED = 1e-6


class _Places(NamedTuple):
    """Samples of a star at its guess, as pixels and how far the samples lie beyond them, each (S,).

    ``column``, ``row`` and ``pixel``, row by row, are those of the pixel to the upper left, int32; ``right`` and
    ``down`` are float32, 0 to 1 px; ``expected`` is that of the template, float32.
    """

    column: NDArray[np.int32]
    row: NDArray[np.int32]
    pixel: NDArray[np.int32]
    right: NDArray[np.float32]
    down: NDArray[np.float32]
    expected: NDArray[np.float32]


@njit(**INNER)
def _find_places(
    guess: Any, linear: Any, template: StarTemplate, width: int, places: _Places
) -> tuple[int, int, int, int]:
    """Fill in the samples of a star; return their least and largest column, and their least and largest row."""
    left = top = 1 << 30
    right = bottom = -left
    for i in range(template.values.size):
        u, v = template.offsets[i, 0], template.offsets[i, 1]
        x = guess[0] + linear[0, 0] * u + linear[0, 1] * v
        y = guess[1] + linear[1, 0] * u + linear[1, 1] * v
        c, r = int(np.floor(x)), int(np.floor(y))
        places.column[i], places.row[i], places.pixel[i] = c, r, r * width + c
        places.right[i], places.down[i] = x - c, y - r
        left, right, top, bottom = min(left, c), max(right, c), min(top, r), max(bottom, r)
    return left, right, top, bottom


@njit(**INNER, fastmath={"reassoc", "contract", "nsz"})
def _sums_at(pixels: Any, width: Any, shift: Any, level: Any, places: _Places) -> tuple[float, float, float]:
    """Return the sums of the values at the samples, of their squares, and of their products with the template.

    ``level`` is subtracted from all values, float32. ``shift`` is by how many pixels, row by row, the samples are
    moved, int32. There is no branch and no store, so that the loop runs over several samples at once. Bilinear
    interpolation: Abramowitz and Stegun (1972), section 25.2.
    """
    total = squares = product = np.float32(0.0)
    one = np.int32(1)
    for i in range(places.pixel.size):
        at = places.pixel[i] + shift
        nw, ne = pixels[np.uint64(at)], pixels[np.uint64(at + one)]
        sw, se = pixels[np.uint64(at + width)], pixels[np.uint64(at + width + one)]
        top, bottom = nw + places.right[i] * (ne - nw), sw + places.right[i] * (se - sw)
        value = top + places.down[i] * (bottom - top) - level
        total += value
        squares += value * value
        product += value * places.expected[i]
    return float(total), float(squares), float(product)


@njit(**INNER)
def _correlation_inside(
    pixels: Any, width: int, shift: int, level: Any, balance: float, places: _Places
) -> float:
    """Return the correlation of samples that all lie in the image with a star; nan if a pixel has no value.

    Lewis (1995), with 1 as the variance of the template; ``balance`` is the sum of the template.
    """
    total, squares, product = _sums_at(pixels, np.int32(width), np.int32(shift), level, places)
    n = places.pixel.size
    mean = total / n
    variance = squares / n - mean * mean
    if np.isnan(variance):
        return np.nan
    flat = (FLAT * level) ** 2 + ROUNDED * mean * mean
    return (product - mean * balance) / n / np.sqrt(variance) if variance > flat else 0.0


@njit(**INNER)
def _correlation_partly(image: Any, across: int, below: int, places: _Places) -> float:
    """Return the correlation of samples of which some lie outside of the image; nan if too many of them do.

    Normalised cross-correlation (Lewis, 1995). ``across`` and ``below`` are by how many pixels the samples are moved.
    """
    total = squares = product = balance = 0.0
    n = 0
    for i in range(places.column.size):
        c, r = places.column[i] + across, places.row[i] + below
        if not (0 <= c < image.shape[1] - 1 and 0 <= r < image.shape[0] - 1):
            continue
        a, b, expected = places.right[i], places.down[i], places.expected[i]
        top = (1.0 - a) * image[r, c] + a * image[r, c + 1]
        bottom = (1.0 - a) * image[r + 1, c] + a * image[r + 1, c + 1]
        value = (1.0 - b) * top + b * bottom
        if not np.isnan(value):
            n += 1
            total += value
            squares += value * value
            product += value * expected
            balance += expected
    if n < MIN_COVERED * places.column.size:
        return np.nan
    mean = total / n
    variance = squares / n - mean * mean
    return (product - mean * balance) / n / np.sqrt(variance) if variance > 0.0 else 0.0


@njit(**KERNEL)
def search_stars(
    image: Any, guesses: Any, linear: Any, reach_px: Any, template: StarTemplate, sign: float
) -> tuple[Any, Any]:
    """Find the best place, px, of a star around each guess, in steps of one pixel, and its correlation, -1 to 1.

    Normalised cross-correlation (Lewis, 1995); nan if no place lies sufficiently inside the image, (H, W) float32,
    smoothed. Guesses (N, 2), px; linear maps (N, 2, 2), px per pitch; radii (N,), px; the sign is +1 if white is
    bright, else -1.
    """
    n, samples = len(guesses), template.values.size
    best, score = np.empty((n, 2)), np.empty(n)
    numbers, shares = np.empty((3, samples), np.int32), np.empty((2, samples), np.float32)
    expected = template.expected.astype(np.float32)
    places = _Places(numbers[0], numbers[1], numbers[2], shares[0], shares[1], expected)
    for k in range(n):
        best[k] = np.nan
        score[k] = _search_star(image, guesses[k], linear[k], reach_px[k], template, sign, places, best[k])
    return best, score


@njit(**INNER_WITH_ARRAYS)
def _search_star(
    image: Any,
    guess: Any,
    linear: Any,
    reach_px: float,
    template: StarTemplate,
    sign: float,
    places: _Places,
    best: Any,
) -> float:
    """Find the best place around one guess; return its correlation."""
    height, width = image.shape
    pixels, balance, score = image.ravel(), template.expected.sum(), np.nan
    left, right, top, bottom = _find_places(guess, linear, template, width, places)
    level = image[min(max(int(guess[1]), 0), height - 1), min(max(int(guess[0]), 0), width - 1)]
    square = reach_px**2 + 0.5
    steps = int(np.sqrt(square))
    for i in range(-steps, steps + 1):
        aside = int(np.sqrt(square - i * i))
        for j in range(-aside, aside + 1):
            found = np.nan
            if left + j >= 0 and right + j < width - 1 and top + i >= 0 and bottom + i < height - 1:
                found = _correlation_inside(pixels, width, i * width + j, level, balance, places)
            if np.isnan(found):
                found = _correlation_partly(image, j, i, places)
            found *= sign
            if not found <= score and not np.isnan(found):
                score, best[0], best[1] = found, guess[0] + j, guess[1] + i
    return score


# From the first stars to all: growth over the grid, where the stars found predict their neighbours.

#: Least correlation with its pattern of a star during growth.
MIN_CORRELATION = 0.45
#: Radius of the search around a predicted star, pitches: for the first stars, and next to stars already found.
FIRST_REACH, REACH = 0.15, 0.08
#: Least distance of neighbouring stars, px.
MIN_PITCH_PX = 10.0
#: How often the pattern of a star is learnt from the first nodes, each time at places that are nearer to the stars.
LEARNING_ROUNDS = 3
#: How often a node is searched, each time with more neighbours that predict it.
MAX_TRIES = 3
#: Least number of points for a homography; from half of it on, an affine map is fitted.
PERSPECTIVE_FROM = 16
_AROUND = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)])


@dataclass
class StarGrid:
    """Stars found so far, by their nodes."""

    # Image point, (2,) float64, px, of each node (column, row).
    points: dict[tuple[int, int], NDArray[np.float64]] = field(default_factory=dict)
    tries: dict[tuple[int, int], int] = field(default_factory=dict)

    def record(self, tried: NDArray[np.int64], found: NDArray[np.int64], places: NDArray[np.float64]) -> None:
        """Add a search: (M, 2) nodes tried, (N, 2) nodes at which a star was found, and these stars' places, px."""
        for column, row in tried:
            key = (int(column), int(row))
            self.tries[key] = self.tries.get(key, 0) + 1
        self.points.update({(int(c), int(r)): place for (c, r), place in zip(found, places, strict=True)})

    def nodes(self) -> NDArray[np.int64]:
        """Return the (N, 2) nodes, columns and rows, of the stars found."""
        return np.array(list(self.points), np.int64).reshape(-1, 2)

    def places(self) -> NDArray[np.float64]:
        """Return the stars found as (N, 2) image points, px, in the order of `nodes`."""
        return np.array(list(self.points.values()), np.float64).reshape(-1, 2)


class GrowthStart(NamedTuple):
    """Where growth starts."""

    # (3, 3) float64, from [column row 1] to [u v 1] px, right near the first nodes.
    homography: NDArray[np.float64]
    sign: float  # +1 if white is bright in the image, -1 if it is dark
    nodes: NDArray[np.int64]  # (M, 2) int64, nodes that are searched first
    # anchor_grid, anchor_px: (K, 2) float64, pitches and px, points known beforehand on the grid and in the
    # image, which take part in all fits.
    anchor_grid: NDArray[np.float64]
    anchor_px: NDArray[np.float64]


def start_at_tag(tag: TagDetection, target: StarTarget) -> GrowthStart:
    """Start growth with the ring of stars around the tag."""
    corners = target.tag_corners_mm / target.pitch_mm
    low, high = corners[0].round().astype(np.int64) - 1, corners[2].round().astype(np.int64) + 1
    columns, rows = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    nodes = np.column_stack([columns.ravel(), rows.ravel()])
    ring = nodes[target.id_at(nodes[:, 0], nodes[:, 1]) >= 0]
    return GrowthStart(tag.homography, tag.sign, ring, corners, tag.corners_px)


def grow_star_grid(
    image: NDArray[np.float32],
    start: GrowthStart,
    segments: int,
    exists: Callable[[NDArray[np.int64]], NDArray[np.bool_]],
) -> StarGrid:
    """Find the first stars, then those around them, until no more are found; none if the first nodes have no star.

    Growth of this kind is that of Schöps et al. (2020), arXiv:1912.02908. If the stars correlate badly with the sharp
    pattern, the pattern is learnt from the image, and growth starts again with it; the larger result is used. Stars are
    located to half a pixel, to two if out of focus. The image is smoothed; ``exists`` tells which (N, 2) nodes may be
    stars.
    """
    grown, scores = _grow(image, start, StarTemplate.of(segments, SEARCH_RADII), exists)
    if scores and np.median(scores) >= SHARP_CORRELATION:
        return grown
    learnt = _learn_at_start(image, start, StarTemplate.of(segments))
    if learnt is None:
        return grown
    again, _ = _grow(image, start, learnt, exists)
    return again if len(again.points) > len(grown.points) else grown


def _learn_at_start(
    image: NDArray[np.float32], start: GrowthStart, sharp: StarTemplate
) -> StarTemplate | None:
    """Learn the pattern from the first nodes; None if they show no stars.

    Own procedure: each node's best place with the sharp pattern, then with the one learnt there, and so on.
    """
    grid = start.nodes.astype(float)
    at, linear = apply_homography(start.homography, grid), linear_at(start.homography, grid)
    reach = FIRST_REACH * np.sqrt(np.abs(np.linalg.det(linear)))
    template = sharp
    for _ in range(LEARNING_ROUNDS):
        found, score = search_stars(image, at, linear, reach, template, start.sign)
        seen = np.isfinite(score)
        learnt = sharp.learnt(image, found[seen], linear[seen], start.sign)
        if learnt is None:
            return None
        template = learnt
    return template


def _grow(
    image: NDArray[np.float32],
    start: GrowthStart,
    template: StarTemplate,
    exists: Callable[[NDArray[np.int64]], NDArray[np.bool_]],
) -> tuple[StarGrid, list[float]]:
    """Grow the grid with one template; return it, and the correlations of its stars."""
    grown = StarGrid()
    scores: list[float] = []
    h, wanted, reach = start.homography, start.nodes, FIRST_REACH
    while len(wanted):
        grid = wanted.astype(float)
        at = predict_locally(h, grown.nodes().astype(float), grown.places(), grid)
        linear = linear_at(h, grid)
        pitch = np.sqrt(np.abs(np.linalg.det(linear)))
        seen = (pitch >= MIN_PITCH_PX) & _inside(at, image.shape)
        found, score = search_stars(image, at[seen], linear[seen], reach * pitch[seen], template, start.sign)
        good = score >= MIN_CORRELATION
        if not good.any():
            break
        scores += score[good].tolist()
        new = wanted[seen][good]
        grown.record(wanted, new, found[good])
        h = _refitted(h, start, grown)
        wanted = _neighbours(new, grown, exists)
        reach = REACH
    return grown, scores


def _refitted(h: NDArray[np.float64], start: GrowthStart, grown: StarGrid) -> NDArray[np.float64]:
    """Fit the homography again to the stars found and the anchors; with too few of them, return the old one."""
    grid = np.vstack([grown.nodes().astype(float), start.anchor_grid])
    places = np.vstack([grown.places(), start.anchor_px])
    if len(grid) >= PERSPECTIVE_FROM:
        return fit_homography(grid, places)
    return fit_affine(grid, places) if len(grid) >= PERSPECTIVE_FROM // 2 else h


def _neighbours(
    nodes: NDArray[np.int64], grown: StarGrid, exists: Callable[[NDArray[np.int64]], NDArray[np.bool_]]
) -> NDArray[np.int64]:
    """Return the (M, 2) nodes next to some stars that have no star yet and may be searched again."""
    next_to = np.unique((nodes[:, None, :] + _AROUND[None]).reshape(-1, 2), axis=0)
    next_to = next_to[exists(next_to)]
    keys = [(int(c), int(r)) for c, r in next_to]
    open_ = [key not in grown.points and grown.tries.get(key, 0) < MAX_TRIES for key in keys]
    return next_to[np.array(open_, bool)]


def _inside(points: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return whether points lie in the image."""
    return np.asarray(
        (points[:, 0] >= 0) & (points[:, 1] >= 0) & (points[:, 0] < shape[1]) & (points[:, 1] < shape[0])
    )
