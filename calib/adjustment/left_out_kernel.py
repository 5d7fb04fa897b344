"""Compiled loop over views that were left out: their costs.

This module is arithmetic only; `calib.adjustment.left_out` calls it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from calib.adjustment.star_kernels import residuals_px, robust_cost, whiten
from calib.compiled import KERNEL


@njit(**KERNEL)
def costs_of_views(
    target: Any,
    points: Any,
    factors: Any,
    bounds: Any,
    fisheye: bool,
    states: Any,
    rotations: Any,
    offsets: Any,
    loss: int,
    limit: float,
    costs: Any,
) -> None:
    """Compute the robust cost of each view with each of P sets of parameters (Huber, 1964; Holland and Welsch, 1977).

    target, points, factors, bounds, fisheye: As for `calib.adjustment.search_kernel.search`.
    states, rotations, offsets: (P, 16), (P, n, 3, 3) and (P, n, 3) float64 parameters.
    loss, limit: As for `calib.adjustment.star_kernels.robust_cost`.
    costs: (P, n) float64 result; infinite if a star cannot be projected.
    """
    views, first = len(bounds), 0
    residuals = np.empty((2, (bounds[:, 1] - bounds[:, 0]).sum()))
    for p in range(len(states)):
        residuals_px(target, points, bounds, states[p], fisheye, rotations[p], offsets[p], residuals)
        whiten(residuals, factors, bounds)
        first = 0
        for i in range(views):
            end = first + bounds[i, 1] - bounds[i, 0]
            costs[p, i] = robust_cost(residuals, first, end, loss, limit)
            first = end
