"""From some first stars to all: ring by ring over the grid, each star predicted by those around it.

Knows the grid's order; how a star looks is `star_refine`'s, how the grid bends is `grid_map`'s.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.model.homography import apply_homography, fit_affine, fit_homography
from calib.stars.centring import SEARCH_RADII, StarTemplate, search_stars
from calib.stars.grid_map import predict_locally
from calib.stars.tag import TagDetection
from calib.target import StarTarget

#: Correlation with its print from which a star is taken for one while growing.
MIN_CORRELATION = 0.45
#: How far from its prediction a star is looked for, in pitches: at first, and beside other stars.
FIRST_REACH, REACH = 0.15, 0.08
#: Stars closer than this cannot be told, px.
MIN_PITCH_PX = 10.0
#: How often a node is tried, each time with more neighbours to predict it.
TRIES = 3
#: Points from which perspective is fitted.
PERSPECTIVE_FROM = 16
_AROUND = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)])


@dataclass
class StarGrid:
    """Stars found so far: node (column, row) to image point, px."""

    points: dict[tuple[int, int], NDArray[np.float64]] = field(default_factory=dict)
    tries: dict[tuple[int, int], int] = field(default_factory=dict)

    def note(self, tried: NDArray[np.int64], found: NDArray[np.int64], places: NDArray[np.float64]) -> None:
        """Take up the nodes tried and, of them, the stars found with their places."""
        for column, row in tried:
            key = (int(column), int(row))
            self.tries[key] = self.tries.get(key, 0) + 1
        self.points.update({(int(c), int(r)): place for (c, r), place in zip(found, places, strict=True)})

    def nodes(self) -> NDArray[np.int64]:
        """(N, 2) columns and rows."""
        return np.array(list(self.points), np.int64).reshape(-1, 2)

    def places(self) -> NDArray[np.float64]:
        """(N, 2) px, in the order of `nodes`."""
        return np.array(list(self.points.values()), np.float64).reshape(-1, 2)


class GrowthStart(NamedTuple):
    """Where growth begins.

    Attributes
    ----------
    homography
        (3, 3) from [column row 1] to [u v 1] px, good near the first nodes.
    sign
        +1 where white is bright, -1 where it is dark.
    nodes
        (M, 2) nodes to look at first.
    anchor_grid, anchor_px
        (K, 2) points known beforehand, on the grid and in the image, that go into the fits.
    """

    homography: NDArray[np.float64]
    sign: float
    nodes: NDArray[np.int64]
    anchor_grid: NDArray[np.float64]
    anchor_px: NDArray[np.float64]


def start_at_tag(seed: TagDetection, target: StarTarget) -> GrowthStart:
    """Begin with the ring of stars around the tag."""
    corners = target.tag_corners_mm / target.pitch_mm
    low, high = corners[0].round().astype(np.int64) - 1, corners[2].round().astype(np.int64) + 1
    columns, rows = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    nodes = np.column_stack([columns.ravel(), rows.ravel()])
    ring = nodes[target.id_at(nodes[:, 0], nodes[:, 1]) >= 0]
    return GrowthStart(seed.homography, seed.sign, ring, corners, seed.corners_px)


def grow_star_grid(
    image: NDArray[np.float32],
    start: GrowthStart,
    segments: int,
    exists: Callable[[NDArray[np.int64]], NDArray[np.bool_]],
) -> StarGrid:
    """Find the first stars, then those around them, until no more are found.

    Parameters
    ----------
    image
        (H, W), smoothed; of either contrast.
    start
        Where to begin.
    segments
        Segments of a star.
    exists
        Says of (N, 2) nodes whether a star may stand there, (N,) bool.

    Returns
    -------
    Places to about half a pixel; empty where the first nodes have no star.
    """
    grown = StarGrid()
    template = StarTemplate.of(segments, SEARCH_RADII)
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
        new = wanted[seen][good]
        grown.note(wanted, new, found[good])
        h = _refitted(h, start, grown)
        wanted = _around(new, grown, exists)
        reach = REACH
    return grown


def _refitted(h: NDArray[np.float64], start: GrowthStart, grown: StarGrid) -> NDArray[np.float64]:
    """Fit the homography again to the stars found and the points known beforehand."""
    grid = np.vstack([grown.nodes().astype(float), start.anchor_grid])
    places = np.vstack([grown.places(), start.anchor_px])
    if len(grid) >= PERSPECTIVE_FROM:
        return fit_homography(grid, places)
    return fit_affine(grid, places) if len(grid) >= PERSPECTIVE_FROM // 2 else h


def linear_at(h: NDArray[np.float64], grid: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, 2, 2) px a pitch of a homography at (N, 2) grid positions."""
    q = grid @ h[:, :2].T + h[:, 2]
    at = apply_homography(h, grid)
    return np.asarray((h[None, :2, :2] - at[:, :, None] * h[None, 2:, :2]) / q[:, 2, None, None])


def _around(
    nodes: NDArray[np.int64], grown: StarGrid, exists: Callable[[NDArray[np.int64]], NDArray[np.bool_]]
) -> NDArray[np.int64]:
    """(M, 2) nodes next to some stars that are not found yet and may be tried again."""
    next_to = np.unique((nodes[:, None, :] + _AROUND[None]).reshape(-1, 2), axis=0)
    next_to = next_to[exists(next_to)]
    keys = [(int(c), int(r)) for c, r in next_to]
    open_ = [key not in grown.points and grown.tries.get(key, 0) < TRIES for key in keys]
    return next_to[np.array(open_, bool)]


def _inside(points: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Whether points lie in the image."""
    return np.asarray(
        (points[:, 0] >= 0) & (points[:, 1] >= 0) & (points[:, 0] < shape[1]) & (points[:, 1] < shape[0])
    )
