"""Compiled loops over views that were left out: their costs, and their residuals with a rotation of their own.

This module is arithmetic only; `calib.adjustment.left_out` calls it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from calib.adjustment.search_kernel import search
from calib.adjustment.star_kernels import LOSSES, residuals_px, robust_cost, whiten

_LEAST_SQUARES = LOSSES["l2"]


@njit(cache=True, error_model="numpy")
def costs_of_views(
    target: Any,
    displacements: Any,
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

    Parameters
    ----------
    target, displacements, points, factors, bounds, fisheye
        As for `calib.adjustment.search_kernel.search`.
    states, rotations, offsets
        (P, 16 + T), (P, n, 3, 3) and (P, n, 3) float64 parameters.
    loss, limit
        As for `calib.adjustment.star_kernels.robust_cost`.
    costs
        (P, n) float64 result; infinite if a star cannot be projected.
    """
    views, first = len(bounds), 0
    residuals = np.empty((2, (bounds[:, 1] - bounds[:, 0]).sum()))
    for p in range(len(states)):
        residuals_px(
            target, displacements, points, bounds, states[p], fisheye, rotations[p], offsets[p], residuals
        )
        whiten(residuals, factors, bounds)
        first = 0
        for i in range(views):
            end = first + bounds[i, 1] - bounds[i, 0]
            costs[p, i] = robust_cost(residuals, first, end, loss, limit)
            first = end


@njit(cache=True, error_model="numpy")
def rms_alone(
    target: Any,
    displacements: Any,
    points: Any,
    factors: Any,
    bounds: Any,
    fisheye: bool,
    states: Any,
    rotations: Any,
    offsets: Any,
    free_centres: Any,
    max_iterations: int,
    tolerances: Any,
    rms: Any,
) -> None:
    """Compute the root mean square residual of each view after least squares of its rotation, or its pose, alone.

    The search is that of `calib.adjustment.search_kernel.search` (Marquardt, 1963).

    Parameters
    ----------
    target, displacements, points, factors, bounds, fisheye, max_iterations, tolerances
        As for `calib.adjustment.search_kernel.search`.
    states
        (n, 16 + T) float64 camera and collimator of each view.
    rotations, offsets
        (n, 3, 3) and (n, 3) float64 start of each view, which becomes its end.
    free_centres
        (n,) bool, whether the centre of the view is free too.
    rms
        (n,) float64 result, px.
    """
    nowhere, none, no_prior = np.empty(0, np.int64), np.empty(0), np.empty((0, 0))
    for i in range(len(bounds)):
        own, turn, offset = bounds[i : i + 1], rotations[i : i + 1], offsets[i : i + 1]
        search(
            target, displacements, points, factors, own, fisheye, nowhere, states[i], turn, offset,
            free_centres[i], _LEAST_SQUARES, np.inf, 0.0, nowhere, no_prior, none, max_iterations, tolerances,
        )  # fmt: skip
        residuals = np.empty((2, bounds[i, 1] - bounds[i, 0]))
        residuals_px(target, displacements, points, own, states[i], fisheye, turn, offset, residuals)
        rms[i] = np.sqrt((residuals**2).sum() / residuals.shape[1])
