"""The smooth map from the target's grid of nodes (column, row; in pitches) to the image, fitted to the stars found.

A homography describes the perspective. A polynomial describes what distortion adds; it is fitted locally while stars
are being predicted, and over the whole view when all are found. The module uses no image.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.arrays import Array, Bools
from calib.model.homography import apply_homography, fit_homography

#: Number of neighbours that predict a star: twice as many as the local polynomial has terms.
NEIGHBOURS = 12
#: Ridge of the local polynomials for 1, x, y, x^2, x y, y^2. It keeps them flat if all neighbours lie on one side or
#: on a line.
RIDGE = (0.0, 0.5, 0.5, 8.0, 8.0, 8.0)
#: Least number of stars for a polynomial of each degree over a view: three or more for each of its terms.
STARS_FOR_DEGREE = {2: 20, 3: 40, 4: 80, 5: 160}
#: Largest residual of a star that takes part in the fit of a view, in robust standard deviations: chance alone exceeds
#: it 4 times in a million.
OUTLIER_SIGMAS = 5.0
_STEP_PITCHES = 0.05  # Of central differences: the map bends little over it, and rounding does not matter yet


class LocalMap(NamedTuple):
    """Map from the target plane to the image around each of N stars, without its centre."""

    linear: Array  # (N, 2, 2) float64, A, px per pitch
    # (N, 2, 3) float64, B, px per pitch^2, coefficients of s_x^2, s_x s_y and s_y^2.
    quadratic: Array

    @property
    def pitch_px(self) -> float:
        """Typical distance, px, of neighbouring stars: the root of the median Jacobian determinant."""
        return float(np.sqrt(np.median(np.abs(np.linalg.det(self.linear)))))


def predict_locally(h: Array, grid: Array, points: Array, wanted: Array) -> Array:
    """Predict (M, 2) image points, px, of grid positions from a homography and the nearest stars' deviations from it.

    The deviations are fitted by a local polynomial of degree two, with weights that fall with the distance. Locally
    weighted regression (Cleveland, 1979) with a ridge (Hoerl and Kennard, 1970). The weights 1 / (1 + distance^2) are
    this project's own. The homography fits about all stars; grid positions are in pitches.
    """
    base = apply_homography(h, wanted)
    if len(grid) == 0:
        return base
    off = points - apply_homography(h, grid)
    k = min(NEIGHBOURS, len(grid))
    dx, dy = (np.subtract.outer(wanted[:, axis], grid[:, axis]) for axis in (0, 1))
    near = np.argpartition(dx * dx + dy * dy, k - 1, axis=1)[:, :k]
    return base + _local_deviations(off, grid, wanted, near)


def _local_deviations(off: Array, grid: Array, wanted: Array, near: NDArray[np.intp]) -> Array:
    """Return the local fit (Cleveland, 1979) of deviations at each grid position, (M, 2) px; ``near`` (M, k) stars."""
    dx, dy = np.moveaxis(grid[near] - wanted[:, None], -1, 0)
    terms = np.stack([np.ones_like(dx), dx, dy, dx * dx, dx * dy, dy * dy], axis=-1)
    weighted = np.swapaxes(terms / (1.0 + dx * dx + dy * dy)[..., None], 1, 2)
    normal = weighted @ terms + np.diag(np.asarray(RIDGE) + 1e-9)
    return np.asarray(np.linalg.solve(normal, weighted @ off[near])[:, 0])


@dataclass(frozen=True)
class GridMap:
    """Map of a whole view: a homography plus a polynomial in scaled grid coordinates."""

    homography: Array  # (3, 3) float64, from grid to px
    centre: Array  # (2,) float64, pitches, origin of the polynomial's coordinates
    scale: float  # Unit of the polynomial's coordinates, pitches
    degree: int  # Degree of the polynomial; 0 if there are few stars
    coefficients: Array  # (terms, 2) float64, px
    sigma_px: float  # Robust standard deviation of the stars about the map, px, per axis

    def apply(self, grid: Array) -> Array:
        """Map (N, 2) pitches to px: a homography (Hartley and Zisserman, 2004, 2.3) and a polynomial of the grid."""
        bent = _monomials((grid - self.centre) / self.scale, self.degree) @ self.coefficients
        return apply_homography(self.homography, grid) + bent


def expanded(apply: Callable[[Array], Array], grid: Array) -> LocalMap:
    """Expand a map to second order around (N, 2) pitches, by central differences (Abramowitz, Stegun, 1972, 25.3)."""
    h = _STEP_PITCHES
    steps = h * np.array([(i, j) for j in (-1, 0, 1) for i in (-1, 0, 1)])
    nw, north, ne, west, here, east, sw, south, se = (apply(grid + step) for step in steps)
    linear = np.stack([(east - west) / (2 * h), (south - north) / (2 * h)], axis=-1)
    xx, yy = (east + west - 2 * here) / (2 * h * h), (south + north - 2 * here) / (2 * h * h)
    return LocalMap(linear, np.stack([xx, (nw + se - ne - sw) / (4 * h * h), yy], axis=-1))


def fit_grid_map(grid: Array, points: Array) -> tuple[GridMap, Array]:
    """Fit the map of a whole view without outliers; return also points minus map, (N, 2) px, of all stars.

    The scale of the residuals is the median length over 1.1774 = sqrt(2 ln 2), the median length of a two-dimensional
    vector of standard normal components. Own procedure: linear least squares, repeated without the stars beyond
    `OUTLIER_SIGMAS`; sigma is enlarged by (1 - terms / stars)^(-1/2). The grid, N >= 4 pitches, is not on a line.
    """
    centre = grid.mean(axis=0)
    scale = float(max(np.abs(grid - centre).max(), 1.0))
    degree = max((d for d, n in STARS_FOR_DEGREE.items() if len(grid) >= n), default=0)
    kept = np.ones(len(grid), bool)
    design = _monomials((grid - centre) / scale, degree)
    for _ in range(4):
        h = fit_homography(grid[kept], points[kept])
        off = points - apply_homography(h, grid)
        coefficients = np.zeros((1, 2))
        if degree:
            # Scaled coordinates keep the normal equations well conditioned. They are faster than an SVD.
            some = design[kept]
            coefficients = np.asarray(np.linalg.solve(some.T @ some, some.T @ off[kept]), np.float64)
        residuals = off - design @ coefficients
        lengths = np.linalg.norm(residuals, axis=1)
        spare = max(1.0 - design.shape[1] / max(np.count_nonzero(kept), 1), 0.2)
        # 1.1774: the median of Rayleigh's distribution of unit sigma
        sigma = float(np.median(lengths[kept])) / 1.1774 / np.sqrt(spare)
        now = lengths <= OUTLIER_SIGMAS * max(sigma, 1e-6)
        if (now == kept).all():
            break
        kept = now if np.count_nonzero(now) >= max(4, len(grid) // 2) else kept
    return GridMap(h, centre, scale, degree, coefficients, sigma), residuals


def without_outliers(grid: Array, points: Array, good: Bools, *, sigmas: float, least_px: float) -> Bools:
    """Return which good points lie on the smooth map of the others: within ``sigmas`` or ``least_px`` (own rule)."""
    fitted, residuals = fit_grid_map(grid[good], points[good])
    kept = good.copy()
    kept[good] = np.linalg.norm(residuals, axis=1) <= max(sigmas * fitted.sigma_px, least_px)
    return kept


def _monomials(at: Array, degree: int) -> Array:
    """Return all products x^i y^j up to a degree along a new last axis."""
    powers = np.arange(degree + 1)
    products = np.polynomial.polynomial.polyvander2d(at[..., 0], at[..., 1], [degree, degree])
    return np.asarray(products[..., np.add.outer(powers, powers).ravel() <= degree])
