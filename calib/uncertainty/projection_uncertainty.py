"""Projection uncertainty of a camera over its sensor, for points at infinity.

A camera that is rotated a little and calibrated again is the same camera. Therefore the rotation implied by a change of
the parameters is removed first; the remaining uncertainty cannot be removed by any mounting. Points at infinity have no
position, so there is no translation. The idea is that of mrcal's projection uncertainty (Kogan).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.arrays import Array, Bools, ReadOnlyArrays
from calib.errors import InputMismatch
from calib.model.camera import CameraModel
from calib.model.rotation import ARCSEC, exp_map, skew

URAD_PER_ARCSEC = 1e6 / ARCSEC
_TURNS = 10  # Steps at most: they end when nothing changes


@dataclass(frozen=True)
class ProjectionMap(ReadOnlyArrays):
    """Projection uncertainty over the sensor."""

    grid_px: Array  # (h, w, 2) float64 image points, px
    # (h, w) float64 1-sigma of the projected point along the worse direction, px; NaN beyond the fold of the
    # distortion.
    sigma_px: Array
    # (h, w) float64 1-sigma of the direction of the ray seen there, along the worse direction, arc seconds.
    sigma_arcsec: Array

    @property
    def worst_px(self) -> float:
        """Largest uncertainty over the sensor, px."""
        return float(np.nanmax(self.sigma_px))

    @property
    def worst_arcsec(self) -> float:
        """Largest uncertainty over the sensor, arc seconds."""
        return float(np.nanmax(self.sigma_arcsec))


@dataclass(frozen=True)
class CameraDifference(ReadOnlyArrays):
    """Difference between the projections of two cameras at infinity, after the best rotation between them."""

    grid_px: Array  # (h, w, 2) float64 image points of the first camera, px
    # (h, w, 2) float64 image point of the same direction in the second camera, minus that point, px.
    offset_px: Array

    @property
    def rms_px(self) -> float:
        """Root mean square length over the sensor, px."""
        return float(np.sqrt(np.nanmean((self.offset_px**2).sum(axis=2))))

    @property
    def worst_px(self) -> float:
        """Largest length over the sensor, px."""
        return float(np.nanmax(np.linalg.norm(self.offset_px, axis=2)))


def projection_uncertainty(camera: CameraModel, covariance: Array, points_across: int = 33) -> ProjectionMap:
    """Map the projection uncertainty of a camera: var(q) = dq/db var(b) dq/db^T, without the implied rotation.

    The law of propagation is that of JCGM 100:2008, section 5.2. The implied rotation is an idea of mrcal (Kogan). Own
    form for points at infinity: for a change db, the rotation t minimises the sum of the squared lengths of
    dq/db db - dq/dt t over the grid.

    Parameters
    ----------
    camera
        The camera.
    covariance
        (K, K) covariance of its parameters, in the order of `CameraModel.parameter_names`.
    points_across
        Number of grid points along the width of the sensor.

    Returns
    -------
    ProjectionMap
        Uncertainty at each grid point.

    Raises
    ------
    InputMismatch
        If the covariance is not that of the camera's parameters.
    """
    shape, k = np.shape(covariance), len(camera.parameter_names)
    if shape != (k, k):
        raise InputMismatch(
            f"The covariance has the shape {shape}, and the {k} parameters of the camera need {(k, k)}.",
            remedy="Give the covariance of the camera alone: `camera_covariance` of a run or a calibration.",
        )
    grid = sensor_grid(camera.image_size, points_across)
    pixels = grid.reshape(-1, 2)
    left, by_ray, rays, seen = _without_turn(camera, pixels)
    variance = left @ covariance @ np.swapaxes(left, 1, 2)

    to_angle = np.linalg.inv(by_ray @ _across(rays))
    angular = to_angle @ variance @ np.swapaxes(to_angle, 1, 2)
    sigmas = np.full((2, len(pixels)), np.nan)
    sigmas[:, seen] = _larger(variance), ARCSEC * _larger(angular)
    return ProjectionMap(grid, *sigmas.reshape(2, *grid.shape[:2]))


def projection_derivatives(camera: CameraModel, points_across: int = 33) -> tuple[Array, Bools]:
    """Return how image points over the sensor follow the camera's parameters, as `projection_uncertainty` uses it.

    Without the implied rotation: (P, 2, K) derivatives, in the order of `CameraModel.parameter_names`, at those of the
    N points of `sensor_grid`, (N,) bool, that do not lie beyond the fold of the distortion.
    """
    pixels = sensor_grid(camera.image_size, points_across).reshape(-1, 2)
    left, _, _, seen = _without_turn(camera, pixels)
    return left, seen


def _without_turn(camera: CameraModel, pixels: Array) -> tuple[Array, Array, Array, Bools]:
    """Return the derivatives of image points by parameters without the implied rotation, and what they rest on.

    (P, 2, K) derivatives, (P, 2, 3) derivatives by the rays, (P, 3) rays, and (N,) bool: pixels that have a ray.
    """
    rays = camera.rays(pixels)
    seen = np.asarray(np.isfinite(rays).all(axis=1))
    _, by_ray, by_parameters = camera.project_with_jacobians(rays[seen])
    by_turn = -by_ray @ skew(rays[seen])
    flat = by_parameters.reshape(-1, by_parameters.shape[2])
    turn = np.linalg.lstsq(by_turn.reshape(-1, 3), flat, rcond=None)[0]
    return by_parameters - by_turn @ turn, by_ray, rays[seen], seen


def camera_difference(first: CameraModel, second: CameraModel, points_across: int = 33) -> CameraDifference:
    """Compare two calibrations of one camera over its sensor.

    The rotation between their frames is estimated by least squares over the sensor (Gauss-Newton). The implied
    transformation is an idea of mrcal (Kogan); here it is a rotation, fitted with equal weights.
    """
    grid = sensor_grid(first.image_size, points_across)
    pixels = grid.reshape(-1, 2)
    rays = first.rays(pixels)
    seen = np.isfinite(rays).all(axis=1)
    turn = np.eye(3)
    for _ in range(_TURNS):
        turned = rays[seen] @ turn.T
        there, by_ray, _ = second.project_with_jacobians(turned)
        by_turn = (-by_ray @ skew(turned)).reshape(-1, 3)
        step = np.linalg.lstsq(by_turn, (pixels[seen] - there).reshape(-1), rcond=None)[0]
        turn = exp_map(np.asarray(step, np.float64)) @ turn
        if np.abs(step).max() < 1e-12:
            break
    offset = np.full((len(pixels), 2), np.nan)
    offset[seen] = second.project(rays[seen] @ turn.T) - pixels[seen]
    return CameraDifference(grid, offset.reshape(grid.shape))


def sensor_grid(image_size: Sequence[int], points_across: int) -> Array:
    """Return an (h, w, 2) grid of image points, px, from the centre of the first pixel to that of the last one."""
    width, height = image_size
    down = max(2, round(points_across * height / width))
    across = max(2, points_across)
    x, y = np.linspace(0, width - 1, across), np.linspace(0, height - 1, down)
    return np.stack(np.meshgrid(x, y), axis=-1)


def _larger(variances: Array) -> Array:
    """Return (N,) the larger 1-sigma of (N, 2, 2) covariances."""
    return np.asarray(np.sqrt(np.maximum(np.linalg.eigvalsh(variances)[:, 1], 0.0)))


def _across(rays: Array) -> Array:
    """Return (N, 3, 2) two directions perpendicular to each unit ray and to each other."""
    helper = np.where(np.abs(rays[:, :1]) < 0.7, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(rays, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(rays, first)], axis=2)


def worst_point(camera: CameraModel, covariance: Array) -> Array:
    """Return the (K,) gradient of the point and direction of the sensor with the largest projection uncertainty.

    The eigenvector of the largest eigenvalue of dq/db C dq/db^T over the grid, times dq/db (`projection_uncertainty`).
    """
    derivatives = projection_derivatives(camera)[0]
    spread = derivatives @ covariance @ np.swapaxes(derivatives, 1, 2)
    values, vectors = np.linalg.eigh(spread)
    worst = int(np.argmax(values[:, 1]))
    return np.asarray(vectors[worst, :, 1] @ derivatives[worst])
