"""The smooth map from a board to an image of a lens that distorts: a homography, radial terms, and what they leave.

A polynomial alone cannot follow a lens with the few points of a board: of 54 points, one of degree three was wrong by a
tenth in the curvature at the border, and the centres of circles shift in proportion to it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from calib.arrays import Array
from calib.model.homography import apply_homography, fit_homography
from calib.stars.grid_map import GridMap, fit_grid_map

#: Radial terms: r^2, r^4 and r^6 of the distorted radius, in half diagonals of the image.
_TERMS = 3
#: More than enough: each step of Newton's method doubles the number of right digits.
_NEWTON_STEPS = 12


class LensMap(NamedTuple):
    """Map of a view: the ideal image by a `GridMap`, then the lens about the middle of the image."""

    ideal: GridMap
    radial: Array  # (3,) ideal radius over radius, minus 1, is their sum with the even powers of the radius
    middle: Array  # (2,) px
    unit_px: float

    def apply(self, grid: Array) -> Array:
        """Map (N, 2) pitches to px; the radial terms (as Brown, 1971, from distorted to ideal) by Newton's method."""
        ideal = (self.ideal.apply(grid) - self.middle) / self.unit_px
        at = ideal
        for _ in range(_NEWTON_STEPS):
            straight, slope = _straight(at, self.radial)
            at = at + np.linalg.solve(slope, (ideal - straight)[..., None])[..., 0]
        return self.middle + self.unit_px * at


def fit_lens_map(grid: Array, points: Array, image_size: tuple[int, int]) -> LensMap:
    """Fit the map to (N, 2) px points of N >= 9 places of the grid, by least squares (own procedure)."""
    middle, unit = 0.5 * (np.array(image_size) - 1.0), 0.5 * float(np.hypot(*image_size))
    at = (points - middle) / unit
    centre, scale = grid.mean(axis=0), float(np.ptp(grid))
    places = (grid - centre) / scale
    first = fit_homography(places, at)

    def off(unknowns: Array) -> Array:
        straight, slope = _straight(at, unknowns[8:])
        h = np.append(unknowns[:8], 1.0).reshape(3, 3)
        return np.asarray(np.linalg.solve(slope, (straight - apply_homography(h, places))[..., None]).ravel())

    start = np.concatenate([(first / first[2, 2]).ravel()[:8], np.zeros(_TERMS)])
    radial = least_squares(off, start, method="lm", max_nfev=400).x[8:]
    ideal = middle + unit * _straight(at, radial)[0]
    return LensMap(fit_grid_map(grid, ideal)[0], radial, middle, unit)


def _straight(at: Array, radial: Array) -> tuple[Array, Array]:
    """Return ideal points p (1 + a r^2 + b r^4 + ...) of (N, 2) distorted ones p (Brown, 1971), and the derivatives."""
    square = (at * at).sum(axis=1)
    powers = square[:, None] ** np.arange(1, len(radial) + 1)
    factor = 1.0 + powers @ radial
    by_square = (powers / np.maximum(square, 1e-300)[:, None]) @ (radial * np.arange(1, len(radial) + 1))
    slope = factor[:, None, None] * np.eye(2) + 2 * by_square[:, None, None] * at[:, :, None] * at[:, None, :]
    return at * factor[:, None], slope
