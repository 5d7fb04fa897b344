"""The smooth map from the target's grid of nodes to the image, as far as stars found so far tell it.

Knows pairs of grid positions (columns and rows, in pitches) and image points; no image, no star's look. A
homography carries the perspective; what lens and collimator bend beside it is a polynomial, fitted locally
where stars are being predicted and over the whole view once they are found.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.model.homography import apply_homography, fit_homography
from calib.stars.centring import LocalMap

#: Neighbours that predict a star.
NEIGHBOURS = 12
#: Ridge on local polynomials, in squared pitches: keeps them flat where neighbours lie on one side or line.
RIDGE = (0.0, 0.5, 0.5, 8.0, 8.0, 8.0)
#: Stars needed for a polynomial of degree 2, 3, 4 and 5 over a view.
STARS_FOR_DEGREE = {2: 20, 3: 40, 4: 80, 5: 160}
#: Residuals beyond this many robust sigmas do not take part in the fit of a view.
OUTLIER_SIGMAS = 5.0
_STEP = 0.05


def predict_locally(
    h: NDArray[np.float64],
    grid: NDArray[np.float64],
    points: NDArray[np.float64],
    wanted: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Predict where grid positions lie, from the homography and what the nearest stars found differ from it.

    Parameters
    ----------
    h
        (3, 3) homography of about all stars.
    grid, points
        (N, 2) pitches, (N, 2) px of the stars found.
    wanted
        (M, 2) grid positions to predict.

    Returns
    -------
    (M, 2) px.
    """
    base = apply_homography(h, wanted)
    if len(grid) == 0:
        return base
    off = points - apply_homography(h, grid)
    k = min(NEIGHBOURS, len(grid))
    distance = np.linalg.norm(wanted[:, None, :] - grid[None, :, :], axis=2)
    near = np.argpartition(distance, k - 1, axis=1)[:, :k]
    delta = grid[near] - wanted[:, None, :]
    weight = 1.0 / (1.0 + np.take_along_axis(distance, near, axis=1) ** 2)
    design = _monomials(delta, 2)
    normal = np.einsum("mki,mk,mkj->mij", design, weight, design) + np.diag(RIDGE) + 1e-9 * np.eye(6)
    right = np.einsum("mki,mk,mkc->mic", design, weight, off[near])
    return np.asarray(base + np.linalg.solve(normal, right)[:, 0, :])


@dataclass(frozen=True)
class GridMap:
    """Map of a whole view: a homography, and a polynomial in scaled grid coordinates beside it.

    Attributes
    ----------
    homography
        (3, 3) from grid to px.
    centre, scale
        Grid coordinates are centred and scaled by these for the polynomial.
    degree
        Of the polynomial, 0 where stars are few.
    coefficients
        (terms, 2) px.
    sigma_px
        Robust scatter of the stars about the map, per axis.
    """

    homography: NDArray[np.float64]
    centre: NDArray[np.float64]
    scale: float
    degree: int
    coefficients: NDArray[np.float64]
    sigma_px: float

    def at(self, grid: NDArray[np.float64]) -> NDArray[np.float64]:
        """Map (N, 2) grid positions to (N, 2) px."""
        bent = _monomials((grid - self.centre) / self.scale, self.degree) @ self.coefficients
        return apply_homography(self.homography, grid) + bent

    def shape(self, grid: NDArray[np.float64]) -> LocalMap:
        """First and second derivatives at (N, 2) grid positions, by central differences."""
        h = _STEP
        right, down = np.array([h, 0.0]), np.array([0.0, h])
        east, west = self.at(grid + right), self.at(grid - right)
        south, north = self.at(grid + down), self.at(grid - down)
        here = self.at(grid)
        mixed = (
            self.at(grid + h)
            + self.at(grid - h)
            - self.at(grid + right - down)
            - self.at(grid - right + down)
        )
        linear = np.stack([(east - west) / (2 * h), (south - north) / (2 * h)], axis=-1)
        xx, yy = (east + west - 2 * here) / (2 * h * h), (south + north - 2 * here) / (2 * h * h)
        return LocalMap(linear, np.stack([xx, mixed / (4 * h * h), yy], axis=-1))


def fit_grid_map(
    grid: NDArray[np.float64], points: NDArray[np.float64]
) -> tuple[GridMap, NDArray[np.float64]]:
    """Fit the map of a whole view, leaving out stars that lie off it.

    Parameters
    ----------
    grid, points
        (N, 2) pitches, (N, 2) px; N >= 4 and not on a line.

    Returns
    -------
    The map, and (N, 2) px what each star differs from it.

    Raises
    ------
    TooFewStars
        When the stars do not tell a homography.
    """
    centre = grid.mean(axis=0)
    scale = float(max(np.abs(grid - centre).max(), 1.0))
    degree = max((d for d, n in STARS_FOR_DEGREE.items() if len(grid) >= n), default=0)
    kept = np.ones(len(grid), bool)
    for _ in range(4):
        h = fit_homography(grid[kept], points[kept])
        design = _monomials((grid - centre) / scale, degree)
        off = points - apply_homography(h, grid)
        coefficients = np.zeros((1, 2))
        if degree:
            # Scaled grid positions keep the normal equations well conditioned, and they are quicker than an SVD.
            some = design[kept]
            coefficients = np.asarray(np.linalg.solve(some.T @ some, some.T @ off[kept]), np.float64)
        residuals = off - design @ coefficients
        lengths = np.linalg.norm(residuals, axis=1)
        # The median length of a two-dimensional normal vector is 1.1774 sigma.
        spare = max(1.0 - design.shape[1] / max(np.count_nonzero(kept), 1), 0.2)
        sigma = float(np.median(lengths[kept])) / 1.1774 / np.sqrt(spare)
        now = lengths <= OUTLIER_SIGMAS * max(sigma, 1e-6)
        if (now == kept).all():
            break
        kept = now if np.count_nonzero(now) >= max(4, len(grid) // 2) else kept
    return GridMap(h, centre, scale, degree, coefficients, sigma), residuals


def _monomials(at: NDArray[np.float64], degree: int) -> NDArray[np.float64]:
    """All products x^i y^j up to a degree, along a new last axis: 1, x, y, x^2, x y, y^2, ..."""
    x, y = at[..., 0], at[..., 1]
    terms = [x ** (total - j) * y**j for total in range(degree + 1) for j in range(total + 1)]
    return np.stack(terms, axis=-1)
