"""How well stars are really placed: the scatter of neighbouring stars scales their covariances.

Knows star centres on a grid and what their residuals promise; no image. Neighbouring stars share no
pixels but lie on a smooth map, so what a star differs from its eight neighbours is noise, measured in the
view itself, with the stencil

    e = c(0, 0) - (c(1, 0) + c(-1, 0) + c(0, 1) + c(0, -1)) / 2
        + (c(1, 1) + c(1, -1) + c(-1, 1) + c(-1, -1)) / 4

every map of degree three or less, and every x^4 and y^4, drops out.
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
#: Stars surrounded by eight others from which their scatter is trusted alone; below, it is mixed with what is
#: usual.
TRUSTED_FROM = 30
#: Normalised squares beyond this do not take part: chi-square of two degrees of freedom, 1 in 22,000.
_CUT = 20.0


def stencil_residuals(
    nodes: NDArray[np.int64], points: NDArray[np.float64], promised: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Compare each star that has all eight neighbours with them.

    Parameters
    ----------
    nodes
        (N, 2) columns and rows.
    points
        (N, 2) px.
    promised
        (N, 2, 2) covariances, px^2, known up to a factor.

    Returns
    -------
    (M, 2) residuals e, px, and (M, 2, 2) their covariances by the same promise.
    """
    index = {(int(c), int(r)): i for i, (c, r) in enumerate(nodes)}
    residuals, covariances = [], []
    for (column, row), i in index.items():
        around = [index.get((column + dc, row + dr), -1) for dc, dr in _STENCIL]
        if min(around) < 0:
            continue
        weights = np.array(list(_STENCIL.values()))
        residuals.append(points[i] + weights @ points[around])
        covariances.append(promised[i] + np.einsum("k,kij->ij", weights**2, promised[around]))
    return np.array(residuals).reshape(-1, 2), np.array(covariances).reshape(-1, 2, 2)


def variance_factor(
    nodes: NDArray[np.int64], points: NDArray[np.float64], promised: NDArray[np.float64], *, usual: float
) -> float:
    """By what the promised covariances must be multiplied so that neighbouring stars scatter as they say.

    Parameters
    ----------
    nodes, points, promised
        As for `stencil_residuals`.
    usual
        The factor as it usually is, for views in which too few stars are surrounded by others.
    """
    residuals, covariances = stencil_residuals(nodes, points, promised)
    count, total = 0.0, 0.0
    if len(residuals):
        squares = np.einsum("mi,mij,mj->m", residuals, np.linalg.inv(covariances), residuals)
        factor = float(np.median(squares)) / (2 * np.log(2))
        if factor > 0:
            near = squares < _CUT * factor
            count, total = float(np.count_nonzero(near)), float(squares[near].sum()) / 2.0
    borrowed = max(TRUSTED_FROM - count, 0.0)
    return (total + borrowed * usual) / (count + borrowed)
