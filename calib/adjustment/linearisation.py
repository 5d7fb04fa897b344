"""Residuals of the stars of many views, and the normal equations of each view, by compiled loops.

This module is arithmetic only; `calib.adjustment.bundle` says which parameters are free.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.adjustment import equation_kernels, star_kernels
from calib.adjustment.observations import Observations
from calib.adjustment.parameters import AdjustmentParameters
from calib.adjustment.state import packed, state_places

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Pull:
    """How the cost of each star depends on its image point."""

    gradient: Array  # (2, N) float64 negative gradient of the cost, 1 / px
    curvature: Array  # (3, N) float64 elements xx, xy and yy of the second derivative, 1 / px^2


def view_equations(
    observations: Observations,
    parameters: AdjustmentParameters,
    names: Sequence[str],
    free_centres: bool,
    pull: Pull,
) -> tuple[Array, Array]:
    """Return the normal matrix and the gradient of each view.

    J^T C J and J^T g, with the curvature C of the robust cost (Triggs et al., 2000, section 4.3).

    free_centres: Whether the centre of each view is free.
    Returns: (n, G + L, G + L) normal matrices and (n, G + L) gradients.
    """
    obs, state = observations, packed(parameters)
    views, width = len(obs.slices), len(names) + (6 if free_centres else 3)
    normal, gradient = np.empty((views, width, width)), np.empty((views, width))
    equation_kernels.view_equations(
        obs.target_rows,
        obs.bounds,
        state,
        parameters.camera.is_fisheye,
        np.ascontiguousarray(parameters.rotations),
        np.ascontiguousarray(parameters.offsets),
        state_places(names),
        pull.gradient,
        pull.curvature,
        normal,
        gradient,
    )
    return normal, gradient


def residuals_px(observations: Observations, parameters: AdjustmentParameters) -> Array:
    """Return the residuals of all stars: image point found minus image point predicted (arXiv:2512.16092, eq. 6).

    Returns: (2, N) float64 residuals, px; NaN for a star that cannot be projected.
    """
    found = np.empty_like(observations.point_rows)
    star_kernels.residuals_px(
        observations.target_rows,
        observations.point_rows,
        observations.bounds,
        packed(parameters),
        parameters.camera.is_fisheye,
        np.ascontiguousarray(parameters.rotations),
        np.ascontiguousarray(parameters.offsets),
        found,
    )
    return found


def squares(observations: Observations) -> Array:
    """Return the curvature of least squares by the image points, W^T W with the whitening W.

    Returns: (3, N) elements xx, xy and yy, 1 / px^2.
    """
    a, b, c = observations.factors
    return np.array([a * a + b * b, b * c, c * c])


def robust_pull(observations: Observations, residuals: Array, loss: int, limit: float) -> Pull:
    """Return gradient and curvature of a robust cost (Triggs et al., 2000, section 4.3).

    residuals: (N, 2) weighted residuals.
    loss, limit: As for `calib.adjustment.star_kernels.robust_cost`.
    """
    pull = Pull(np.empty((2, len(residuals))), np.empty((3, len(residuals))))
    star_kernels.robust_curvature(
        np.array(residuals.T, order="C"),
        observations.factors,
        observations.bounds,
        loss,
        limit,
        pull.gradient,
        pull.curvature,
    )
    return pull
