"""From the first stars to all: growth over the grid, where the stars found predict their neighbours.

The order is outwards (Schöps et al., 2020, arXiv:1912.02908). `calib.stars.grid_map` predicts a star's place; around it
the place that correlates best with `calib.stars.template` is searched, in steps of one pixel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from calib.arrays import Array, Array32, Bools, Ints
from calib.model.homography import apply_homography, fit_affine, fit_homography, linear_at
from calib.stars.grid_map import predict_locally
from calib.stars.tag import TagDetection
from calib.stars.template import SEARCH_RADII, SHARP_CORRELATION, StarTemplate, correlations, values_at
from calib.target import StarTarget


def search_stars(
    image: Array32, guesses: Array, linear: Array, reach_px: Array, template: StarTemplate, sign: float
) -> tuple[Array, Array]:
    """Find the best place, px, of a star around each guess, in steps of one pixel, and its correlation, -1 to 1.

    Nan if no place lies sufficiently inside the image, (H, W) float32, smoothed. Guesses (N, 2), px; linear maps (N, 2,
    2), px per pitch; radii (N,), px; the sign is +1 if white is bright, else -1.
    """
    squares = reach_px**2 + 0.5
    farthest = squares.max(initial=0.0)
    steps = np.arange(-int(np.sqrt(farthest)), int(np.sqrt(farthest)) + 1)
    moves = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    moves = moves[(moves**2).sum(axis=1) <= farthest]
    places = template.places(guesses, linear).astype(np.float32)
    x, y = (at[:, None] + by[:, None] for at, by in zip(places, moves.T.astype(np.float32), strict=True))
    seen = values_at(image, x, y)
    score = sign * correlations(seen, template)
    score[(moves**2).sum(axis=1) > squares[:, None]] = np.nan
    best = np.where(np.isnan(score), -np.inf, score).argmax(axis=1)
    score = score[np.arange(len(score)), best]
    return np.where(np.isnan(score)[:, None], np.nan, guesses + moves[best]), score


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
_AROUND = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]


@dataclass
class StarGrid:
    """Stars found so far, by their nodes."""

    # Image point, (2,) float64, px, of each node (column, row).
    points: dict[tuple[int, int], Array] = field(default_factory=dict)
    tries: dict[tuple[int, int], int] = field(default_factory=dict)

    def record(self, tried: Ints, found: Ints, places: Array) -> None:
        """Add a search: (M, 2) nodes tried, (N, 2) nodes at which a star was found, and these stars' places, px."""
        for column, row in tried:
            key = (int(column), int(row))
            self.tries[key] = self.tries.get(key, 0) + 1
        self.points.update({(int(c), int(r)): place for (c, r), place in zip(found, places, strict=True)})

    def nodes(self) -> Ints:
        """Return the (N, 2) nodes, columns and rows, of the stars found."""
        return np.array(list(self.points), np.int64).reshape(-1, 2)

    def places(self) -> Array:
        """Return the stars found as (N, 2) image points, px, in the order of `nodes`."""
        return np.array(list(self.points.values()), np.float64).reshape(-1, 2)


class GrowthStart(NamedTuple):
    """Where growth starts."""

    # (3, 3) float64, from [column row 1] to [u v 1] px, right near the first nodes.
    homography: Array
    sign: float  # +1 if white is bright in the image, -1 if it is dark
    nodes: Ints  # (M, 2) int64, nodes that are searched first
    # anchor_grid, anchor_px: (K, 2) float64, pitches and px, points known beforehand on the grid and in the
    # image, which take part in all fits.
    anchor_grid: Array
    anchor_px: Array


def start_at_tag(tag: TagDetection, target: StarTarget) -> GrowthStart:
    """Start growth with the ring of stars around the tag."""
    corners = target.tag_corners_mm / target.pitch_mm
    low, high = corners[0].round().astype(np.int64) - 1, corners[2].round().astype(np.int64) + 1
    columns, rows = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    nodes = np.column_stack([columns.ravel(), rows.ravel()])
    ring = nodes[target.id_at(nodes[:, 0], nodes[:, 1]) >= 0]
    return GrowthStart(tag.homography, tag.sign, ring, corners, tag.corners_px)


def grow_star_grid(
    image: Array32, start: GrowthStart, segments: int, exists: Callable[[Ints], Bools]
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


def _learn_at_start(image: Array32, start: GrowthStart, sharp: StarTemplate) -> StarTemplate | None:
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
    image: Array32, start: GrowthStart, template: StarTemplate, exists: Callable[[Ints], Bools]
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


def _refitted(h: Array, start: GrowthStart, grown: StarGrid) -> Array:
    """Fit the homography again to the stars found and the anchors; with too few of them, return the old one."""
    grid = np.vstack([grown.nodes().astype(float), start.anchor_grid])
    places = np.vstack([grown.places(), start.anchor_px])
    if len(grid) >= PERSPECTIVE_FROM:
        return fit_homography(grid, places)
    return fit_affine(grid, places) if len(grid) >= PERSPECTIVE_FROM // 2 else h


def _neighbours(nodes: Ints, grown: StarGrid, exists: Callable[[Ints], Bools]) -> Ints:
    """Return the (M, 2) nodes next to some stars that have no star yet and may be searched again."""
    around = {(c + i, r + j) for c, r in nodes.tolist() for i, j in _AROUND}
    open_ = [key for key in around if key not in grown.points and grown.tries.get(key, 0) < MAX_TRIES]
    next_to = np.array(sorted(open_), np.int64).reshape(-1, 2)
    return next_to[exists(next_to)]


def _inside(points: Array, shape: tuple[int, ...]) -> Bools:
    """Return whether points lie in the image."""
    return np.asarray(
        (points[:, 0] >= 0) & (points[:, 1] >= 0) & (points[:, 0] < shape[1]) & (points[:, 1] < shape[0])
    )
