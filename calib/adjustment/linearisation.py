"""Derivatives of the image points of many views, and the normal equations of each view.

The derivatives are kept in planes: one contiguous row over the stars for each parameter and image axis. Views are
handled in blocks that stay in the processor's cache. This module is arithmetic only; `calib.adjustment.bundle` says
which parameters are free.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.adjustment import equation_kernels, star_kernels
from calib.adjustment.observations import Observations
from calib.adjustment.parameters import AdjustmentParameters
from calib.adjustment.state import packed, state_places
from calib.model.collimator import CENTRE

Array = NDArray[np.float64]

#: Number of stars of a block: its derivatives by 15 parameters are about half a megabyte.
_BLOCK_STARS = 2000


@dataclass(frozen=True)
class Places:
    """Where the derivatives by the free parameters come from."""

    # For each of G free shared parameters its kind (``camera``, ``centre``, ``aberration`` or ``gimbal``) and
    # its index among the parameters of that kind.
    shared: Sequence[tuple[str, int]]
    local: int  # Number L of local parameters of each view: 3 for the rotation; 6 with a free centre


@dataclass(frozen=True)
class Pull:
    """How the cost of each star depends on its image point."""

    gradient: Array  # (2, N) float64 negative gradient of the cost, 1 / px
    curvature: Array  # (3, N) float64 elements xx, xy and yy of the second derivative, 1 / px^2


@dataclass(frozen=True)
class Block:
    """Consecutive views with their derivatives."""

    views: range
    rows: slice
    own: Sequence[slice]  # For each view, its rows within the block
    # (G + L, 2, N) derivatives of the block's N image points, px per unit, by the G free shared and the L
    # local parameters (rotation in rad, then centre in mm).
    jacobian: Array


def _turned(
    observations: Observations, displacements: Array | None, parameters: AdjustmentParameters, rows: slice
) -> tuple[Array, Array]:
    """Return the rotation of each star's view, (3, 3, M), and its point in the camera frame, (3, M) mm."""
    view = observations.view[rows]
    turn = np.ascontiguousarray(parameters.rotations.transpose(1, 2, 0))[:, :, view]
    x, y, z = observations.target_rows[:, rows] - np.ascontiguousarray(parameters.centres.T)[:, view]
    if displacements is not None:
        coefficients = np.array(list(parameters.collimator.aberrations.values()))
        dx, dy = (displacements[rows] @ coefficients).T
        x, y = x + dx, y + dy
    return turn, turn[:, 0] * x + turn[:, 1] * y + turn[:, 2] * z


def blocks(
    observations: Observations,
    displacements: Array | None,
    parameters: AdjustmentParameters,
    places: Places,
) -> Iterator[Block]:
    """Yield the views in blocks, with the derivatives of their image points.

    Own derivation, by the chain rule: with P = R (X - c), a rotation t on the camera's side moves P by t x P, and a
    shift s of the centre moves it by -R s.

    displacements: (N, 2, T) float64 displacement of each star by a unit of each aberration, mm; None if there
      are none.
    Yields: At least one view each.
    """
    for views in _views_in_blocks(observations.slices):
        own = [observations.slices[i] for i in views]
        rows = slice(own[0].start, own[-1].stop)
        turn, points = _turned(observations, displacements, parameters, rows)
        _, by_points, by_camera = parameters.camera.project_with_jacobians(points.T)
        shifts = None if displacements is None else displacements[rows].transpose(2, 1, 0)
        jacobian = _jacobian(
            turn, points, by_points.transpose(2, 1, 0), by_camera.transpose(2, 1, 0), shifts, places
        )
        own = [slice(one.start - rows.start, one.stop - rows.start) for one in own]
        yield Block(views, rows, own, jacobian)


def _views_in_blocks(slices: Sequence[slice]) -> Iterator[range]:
    """Yield the indices of consecutive views that have about as many stars as a block."""
    first = 0
    for i, rows in enumerate(slices):
        if rows.stop - slices[first].start > _BLOCK_STARS and i > first:
            yield range(first, i)
            first = i
    yield range(first, len(slices))


def _jacobian(
    turn: Array, points: Array, along: Array, by_camera: Array, shifts: Array | None, places: Places
) -> Array:
    """Return the derivatives (G + L, 2, N) of N image points, from those by the points (3, 2, N) and by the camera."""
    x, y, z = points
    u, v, w = along
    count = len(places.shared)
    jacobian = np.empty((count + places.local, 2, len(x)))
    jacobian[count] = y * w - z * v
    jacobian[count + 1] = z * u - x * w
    jacobian[count + 2] = x * v - y * u
    by_centre = -(turn[0][:, None] * u + turn[1][:, None] * v + turn[2][:, None] * w)
    jacobian[count + 3 :] = by_centre[: places.local - 3]
    for row, (kind, at) in zip(jacobian, places.shared, strict=False):
        if kind == "camera":
            row[:] = by_camera[at]
        elif kind == "centre":
            row[:] = -by_centre[at] if CENTRE[at] == "r" else by_centre[at]
        elif kind == "gimbal":
            row[:] = 0.0
        elif shifts is not None:
            row[:] = -(by_centre[0] * shifts[at, 0] + by_centre[1] * shifts[at, 1])
    return jacobian


def view_equations(
    observations: Observations,
    displacements: Array | None,
    parameters: AdjustmentParameters,
    names: Sequence[str],
    free_centres: bool,
    pull: Pull,
) -> tuple[Array, Array]:
    """Return the normal matrix and the gradient of each view, without priors.

    J^T C J and J^T g, with the curvature C of the robust cost (Triggs et al., 2000, section 4.3).

    observations, parameters: As for `blocks`.
    displacements: (N, 2, T) float64 displacement of each star by a unit of each aberration, mm; None if there
      are none.
    free_centres: Whether the centre of each view is free.
    Returns: (n, G + L, G + L) normal matrices and (n, G + L) gradients.
    """
    obs, state = observations, packed(parameters)
    views, width = len(obs.slices), len(names) + (6 if free_centres else 3)
    normal, gradient = np.empty((views, width, width)), np.empty((views, width))
    equation_kernels.view_equations(
        obs.target_rows,
        shifts_of(obs, displacements),
        obs.bounds,
        state,
        parameters.camera.is_fisheye,
        np.ascontiguousarray(parameters.rotations),
        np.ascontiguousarray(parameters.offsets),
        state_places(parameters, names, displacements),
        pull.gradient,
        pull.curvature,
        normal,
        gradient,
    )
    return normal, gradient


def residuals_px(
    observations: Observations, displacements: Array | None, parameters: AdjustmentParameters
) -> Array:
    """Return the residuals of all stars: image point found minus image point predicted (arXiv:2512.16092, eq. 6).

    observations, parameters: As for `blocks`.
    displacements: (N, 2, T) float64 displacement of each star by a unit of each aberration, mm; None if there
      are none.
    Returns: (2, N) float64 residuals, px; NaN for a star that cannot be projected.
    """
    found = np.empty_like(observations.point_rows)
    star_kernels.residuals_px(
        observations.target_rows,
        shifts_of(observations, displacements),
        observations.point_rows,
        observations.bounds,
        packed(parameters),
        parameters.camera.is_fisheye,
        np.ascontiguousarray(parameters.rotations),
        np.ascontiguousarray(parameters.offsets),
        found,
    )
    return found


def shifts_of(observations: Observations, displacements: Array | None) -> Array:
    """Return displacements for `calib.adjustment.star_kernels`.

    displacements: (N, 2, T) float64 displacements, mm; None if there are none.
    Returns: (N, 2, T) float64 contiguous displacements; T is 0 if there are none.
    """
    if displacements is None:
        return np.empty((len(observations.view), 2, 0))
    return np.ascontiguousarray(displacements)


def squares(observations: Observations, curvature_root: Array | None) -> Array:
    """Return the curvature of the cost by the image points, W^T C W: whitening W, curvature C of the robust cost.

    curvature_root: (N, 2, 2) symmetric square root of C; None for the identity.
    Returns: (3, N) elements xx, xy and yy, 1 / px^2.
    """
    a, b, c = observations.factors
    if curvature_root is None:
        return np.array([a * a + b * b, b * c, c * c])
    xx, xy, yy = curvature_root[:, 0, 0], curvature_root[:, 0, 1], curvature_root[:, 1, 1]
    left, right = xx * a + xy * b, xy * a + yy * b
    upper, lower = xy * c, yy * c
    return np.array(
        [left * left + right * right, left * upper + right * lower, upper * upper + lower * lower]
    )


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
