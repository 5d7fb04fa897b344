"""Which star is which, where the tag could not be read whole: by what is seen of it, or by an expected pose.

Knows stars found on a grid of their own, numbered from any star and turned by any quarter turns, and what the
target should look like; it refuses where more than one numbering would do.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.errors import StarsUnnamed
from calib.model.homography import apply_homography, fit_homography
from calib.stars.grid_map import predict_locally
from calib.stars.growth import StarGrid
from calib.target import TAG_MODULES, StarTarget

#: Share of the visible modules of a tag that may look wrong.
MAX_WRONG_MODULES = 0.08
#: Modules of the tag's inside, of 36, that must be visible.
MIN_INNER_MODULES = 12
#: How much better, in share of right modules, the best numbering must be than any other.
MARGIN = 0.15
#: How far from whole nodes, and from each other, an expected pose may put the stars, in pitches.
MAX_OFF_NODE, MAX_SCATTER = 0.3, 0.35
_QUARTERS = [
    np.array(m) for m in ([[1, 0], [0, 1]], [[0, -1], [1, 0]], [[-1, 0], [0, -1]], [[0, 1], [-1, 0]])
]


class StarLabels(NamedTuple):
    """Target node = turn @ node found + shift."""

    turn: NDArray[np.int64]
    shift: NDArray[np.int64]

    def apply(self, nodes: NDArray[np.int64]) -> NDArray[np.int64]:
        """(N, 2) nodes of the target."""
        return np.asarray(nodes @ self.turn.T + self.shift, np.int64)


def grid_homography(
    matrix: NDArray[np.float64],
    rotation: NDArray[np.float64],
    centre_mm: NDArray[np.float64],
    pitch_mm: float,
) -> NDArray[np.float64]:
    """Where a known collimator's grid of stars lies in the image of a known camera, for `label_by_pose`.

    H = K [r1 r2 -R c] diag(p, p, 1); the lens's distortion is left out, a few pixels at most.

    Parameters
    ----------
    matrix
        (3, 3) K, px.
    rotation
        (3, 3) R, camera <- target.
    centre_mm
        (3,) c = (x, y, -r), mm.
    pitch_mm
        Distance of neighbouring stars, mm.

    Returns
    -------
    (3, 3) from [column row 1] to [u v 1] px.
    """
    columns = np.column_stack([rotation[:, 0], rotation[:, 1], -rotation @ centre_mm])
    return np.asarray(matrix @ columns @ np.diag([pitch_mm, pitch_mm, 1.0]), np.float64)


def label_by_pose(grown: StarGrid, expected: NDArray[np.float64], *, name: str) -> StarLabels:
    """Number stars by where they should lie.

    Parameters
    ----------
    grown
        Stars found, on a grid of their own.
    expected
        (3, 3) from [column row 1] of the target's grid to [u v 1] px, to a third of a pitch.
    name
        The view's name, for messages.

    Raises
    ------
    StarsUnnamed
        When the stars do not lie on the expected grid, or half-way between two numberings.
    """
    nodes, there = (
        grown.nodes(),
        apply_homography(np.asarray(np.linalg.inv(expected), np.float64), grown.places()),
    )
    fits = []
    for turn in _QUARTERS:
        off = there - nodes @ turn.T
        middle = np.median(off, axis=0)
        fits.append((float(np.sqrt(np.mean(np.sum((off - middle) ** 2, axis=1)))), middle, turn))
    scatter, middle, turn = min(fits, key=lambda f: f[0])
    shift = np.round(middle)
    if scatter > MAX_SCATTER or np.abs(middle - shift).max() > MAX_OFF_NODE:
        raise StarsUnnamed(
            f"{len(nodes)} stars are seen but no tag, and the expected pose does not say which they are: they lie "
            f"{np.abs(middle - shift).max():.2f} squares beside its nodes, scattered by {scatter:.2f}.",
            where=f"view {name}",
            remedy="Turn the camera so that the tag is in view, or give the pose to a third of a square.",
        )
    return StarLabels(turn, shift.astype(np.int64))


def label_by_tag(
    image: NDArray[np.float32], grown: StarGrid, sign: float, target: StarTarget, *, name: str
) -> StarLabels:
    """Number stars by the part of the tag that is in view.

    Every gap in the grid of stars that could hold the tag is compared with the print, in all four directions,
    module by module.

    Parameters
    ----------
    image
        (H, W), smoothed.
    grown
        Stars found, on a grid of their own.
    sign
        +1 where white is bright.
    target
        The printed target.
    name
        The view's name, for messages.

    Raises
    ------
    StarsUnnamed
        When too little of a tag is seen, it is another one, or two places would do.
    """
    nodes = grown.nodes()
    h = fit_homography(nodes.astype(float), grown.places())
    white, black = _levels(image, grown, h, sign)
    centre = np.array(target.tag_centre_mm) / target.pitch_mm
    found: list[tuple[float, StarLabels]] = []
    for middle in _gaps(nodes, target):
        modules = _modules(image, grown, h, middle, target)
        if modules is None:
            continue
        white_here = np.where(np.isfinite(modules), sign * modules > (white + black) / 2.0, False)
        for quarter, turn in enumerate(_QUARTERS):
            right = np.rot90(white_here, -quarter) == (target.layout.tag_modules > 0)
            share = float(right[np.rot90(np.isfinite(modules), -quarter)].mean())
            shift = np.round(centre - turn @ middle).astype(np.int64)
            found.append((share, StarLabels(turn, shift)))
    found.sort(key=lambda f: -f[0])
    if not found or found[0][0] < 1.0 - MAX_WRONG_MODULES:
        what = "no readable part of the tag is."
    elif len(found) > 1 and found[1][0] > found[0][0] - MARGIN:
        what = "what is seen of the tag fits in more than one way."
    else:
        return found[0][1]
    raise StarsUnnamed(
        f"{len(nodes)} stars are in the image, but {what}",
        where=f"view {name}",
        remedy="Turn the camera so that more of the tag is in view, or say where the camera points.",
    )


def _gaps(nodes: NDArray[np.int64], target: StarTarget) -> NDArray[np.float64]:
    """(M, 2) middles, on the grid found, of squares without stars that are as large as the tag leaves."""
    side = target.tag_squares + 1
    low, high = nodes.min(axis=0) - side, nodes.max(axis=0) + side
    taken = np.zeros(high - low + 1, np.int64)
    taken[nodes[:, 0] - low[0], nodes[:, 1] - low[1]] = 1
    total = np.pad(taken.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    inside = total[side:, side:] - total[:-side, side:] - total[side:, :-side] + total[:-side, :-side]
    return np.argwhere(inside == 0) + low + (side - 1) / 2.0


def _levels(
    image: NDArray[np.float32], grown: StarGrid, h: NDArray[np.float64], sign: float
) -> tuple[float, float]:
    """Typical white and black around the stars, brightness times sign."""
    around = np.array([[np.cos(a), np.sin(a)] for a in np.arange(64) * np.pi / 32]) * 0.4
    at = apply_homography(h, (grown.nodes()[:, None, :] + around[None]).reshape(-1, 2))
    values = sign * _values(image, at)
    values = values[np.isfinite(values)]
    return float(np.quantile(values, 0.8)), float(np.quantile(values, 0.2))


def _modules(
    image: NDArray[np.float32],
    grown: StarGrid,
    h: NDArray[np.float64],
    middle: NDArray[np.float64],
    target: StarTarget,
) -> NDArray[np.float64] | None:
    """Brightness of the tag's modules, were its middle there, (8, 8), nan outside; None where too few are inside."""
    steps = ((np.arange(TAG_MODULES) + 0.5) / TAG_MODULES - 0.5) * target.tag_squares
    on_grid = middle + np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    inner = np.zeros((TAG_MODULES, TAG_MODULES), bool)
    inner[1:-1, 1:-1] = True
    roughly = np.isfinite(_values(image, apply_homography(h, on_grid[inner.ravel()])))
    if np.count_nonzero(roughly) < MIN_INNER_MODULES:
        return None
    at = predict_locally(h, grown.nodes().astype(float), grown.places(), on_grid)
    return _values(image, at).reshape(inner.shape)


def _values(image: NDArray[np.float32], at: NDArray[np.float64]) -> NDArray[np.float64]:
    """Bilinear values at (N, 2) points; nan outside."""
    x, y = (np.ascontiguousarray(at[:, i], np.float32) for i in (0, 1))
    return np.asarray(
        cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan")),
        float,
    ).ravel()
