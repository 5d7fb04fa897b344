"""How well stars are located: the scatter of neighbouring stars scales their covariances.

The module uses the centres of stars on a grid, and covariances that are known up to a factor. It uses no image.

Neighbouring stars share no pixels but lie on a smooth map. So the difference of a star from its eight neighbours is
noise, and it is measured in the view itself with the stencil

    e = c(0, 0) - (c(1, 0) + c(-1, 0) + c(0, 1) + c(0, -1)) / 2
        + (c(1, 1) + c(1, -1) + c(-1, 1) + c(-1, -1)) / 4 .

This is the mask of Immerkær (1996) for the noise of images, here for positions. It cancels every map of degree three
or less, and x^4 and y^4.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Neighbours of a star in the stencil, and their weights.
_STENCIL = {
    (1, 0): -0.5,
    (-1, 0): -0.5,
    (0, 1): -0.5,
    (0, -1): -0.5,
    (1, 1): 0.25,
    (1, -1): 0.25,
    (-1, 1): 0.25,
    (-1, -1): 0.25,
}
#: Number of surrounded stars from which their scatter alone is used; below it, the typical factor is mixed in.
TRUSTED_FROM = 30
#: Largest normalised square that takes part: chi-square of two degrees of freedom exceeds it 1 in 22,000 times.
_MAX_SQUARE = 20.0


def stencil_residuals(
    nodes: NDArray[np.int64], points: NDArray[np.float64], nominal: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Compare each star that has all eight neighbours with them: (M, 2) e, px, and (M, 2, 2) covariances, px^2.

    The stencil is the mask of Immerkær (1996). The covariance of e is the sum of w^2 V over the stars, with their
    weights w and covariances V (JCGM 100:2008, section 5.1), known up to a factor.
    """
    low = nodes.min(axis=0, initial=0) - 1
    size = nodes.max(axis=0, initial=0) - low + 2
    star_at = np.full(size, -1)
    star_at[tuple((nodes - low).T)] = np.arange(len(nodes))
    around = star_at[tuple(np.moveaxis((nodes - low)[:, None, :] + np.array(list(_STENCIL)), 2, 0))]
    whole = (around >= 0).all(axis=1)
    around, weights = around[whole], np.array(list(_STENCIL.values()))
    residuals = points[whole] + weights @ points[around]
    return residuals, nominal[whole] + np.einsum("k,mkij->mij", weights**2, nominal[around])


def variance_factor(
    nodes: NDArray[np.int64], points: NDArray[np.float64], nominal: NDArray[np.float64], *, typical: float
) -> float:
    """Estimate the factor of the (N, 2, 2) covariances from the scatter of neighbouring stars.

    A first value is the median of the normalised squares over 2 ln 2, the median of chi-square with two degrees of
    freedom. The result is the mean of those squares that are not far above it. This estimator is this project's own.
    The ``typical`` factor is mixed in if fewer than `TRUSTED_FROM` stars have all eight neighbours.
    """
    residuals, covariances = stencil_residuals(nodes, points, nominal)
    count, total = 0.0, 0.0
    if len(residuals):
        squares = np.einsum("mi,mij,mj->m", residuals, np.linalg.inv(covariances), residuals)
        factor = float(np.median(squares)) / (2 * np.log(2))
        if factor > 0:
            near = squares < _MAX_SQUARE * factor
            count, total = float(np.count_nonzero(near)), float(squares[near].sum()) / 2.0
    borrowed = max(TRUSTED_FROM - count, 0.0)
    return (total + borrowed * typical) / (count + borrowed)
