"""From the tag to all stars: ring by ring over the grid, each star predicted by those around it.

Knows the grid's order; how a star looks is `star_refine`'s, how the grid bends is `grid_map`'s.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from calib.grid_map import apply_homography, fit_homography, predict_locally
from calib.star_refine import SEARCH_RADII, StarTemplate, search_stars
from calib.tag_seed import TagSeed
from calib.target import StarTarget

#: Correlation with its print from which a star is taken for one while growing.
MIN_CORRELATION = 0.45
#: How far from its prediction a star is looked for, in pitches: beside the tag, and beside other stars.
FIRST_REACH, REACH = 0.15, 0.08
#: Stars closer than this cannot be told, px.
MIN_PITCH_PX = 10.0
#: How often a node is tried, each time with more neighbours to predict it.
TRIES = 3
_AROUND = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)])


@dataclass
class Grown:
    """Stars found so far: node (column, row) to image point, px."""

    points: dict[tuple[int, int], NDArray[np.float64]] = field(default_factory=dict)
    tries: dict[tuple[int, int], int] = field(default_factory=dict)

    def nodes(self) -> NDArray[np.int64]:
        """(N, 2) columns and rows."""
        return np.array(list(self.points), np.int64).reshape(-1, 2)

    def places(self) -> NDArray[np.float64]:
        """(N, 2) px, in the order of `nodes`."""
        return np.array(list(self.points.values()), np.float64).reshape(-1, 2)


def grow(image: NDArray[np.float32], seed: TagSeed, target: StarTarget) -> Grown:
    """Find the stars around the tag, then around these, until no more are found.

    Parameters
    ----------
    image
        (H, W), smoothed; of either contrast, the seed says which.
    seed
        The tag.
    target
        Which nodes carry stars.

    Returns
    -------
    Places to about half a pixel; empty where no star stands around the tag.
    """
    grown = Grown()
    template = StarTemplate.of(target.segments, SEARCH_RADII)
    corners = target.tag_corners_mm / target.pitch_mm
    h = seed.homography
    wanted = _around(corners.round().astype(np.int64), target, grown, whole_tag=True)
    reach = FIRST_REACH
    while len(wanted):
        at = predict_locally(h, grown.nodes().astype(float), grown.places(), wanted.astype(float))
        linear = linear_at(h, wanted.astype(float))
        pitch = np.sqrt(np.abs(np.linalg.det(linear)))
        seen = (pitch >= MIN_PITCH_PX) & _inside(at, image.shape)
        found, score = search_stars(image, at[seen], linear[seen], reach * pitch[seen], template, seed.sign)
        for node in wanted:
            key = (int(node[0]), int(node[1]))
            grown.tries[key] = grown.tries.get(key, 0) + 1
        good = score >= MIN_CORRELATION
        if not good.any():
            break
        new = wanted[seen][good]
        grown.points.update({(int(c), int(r)): place for (c, r), place in zip(new, found[good], strict=True)})
        nodes, places = grown.nodes().astype(float), grown.places()
        h = fit_homography(np.vstack([nodes, corners]), np.vstack([places, seed.corners_px]))
        wanted = _around(new, target, grown)
        reach = REACH
    return grown


def linear_at(h: NDArray[np.float64], grid: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, 2, 2) px a pitch of a homography at (N, 2) grid positions."""
    q = grid @ h[:, :2].T + h[:, 2]
    at = apply_homography(h, grid)
    return np.asarray((h[None, :2, :2] - at[:, :, None] * h[None, 2:, :2]) / q[:, 2, None, None])


def _around(
    nodes: NDArray[np.int64], target: StarTarget, grown: Grown, *, whole_tag: bool = False
) -> NDArray[np.int64]:
    """(M, 2) nodes with a star next to some others that are not found yet and may be tried again."""
    if whole_tag:
        low, high = nodes.min(axis=0), nodes.max(axis=0)
        columns, rows = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
        nodes = np.column_stack([columns.ravel(), rows.ravel()])
    next_to = np.unique((nodes[:, None, :] + _AROUND[None]).reshape(-1, 2), axis=0)
    next_to = next_to[target.id_at(next_to[:, 0], next_to[:, 1]) >= 0]
    open_ = [
        (int(c), int(r)) not in grown.points and grown.tries.get((int(c), int(r)), 0) < TRIES
        for c, r in next_to
    ]
    return next_to[np.array(open_, bool)] if len(next_to) else next_to


def _inside(points: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Whether points lie in the image."""
    return np.asarray(
        (points[:, 0] >= 0) & (points[:, 1] >= 0) & (points[:, 0] < shape[1]) & (points[:, 1] < shape[0])
    )
