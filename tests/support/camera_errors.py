"""Error of a calibrated camera against the truth of a drawn bench: the focal length, and the corners of the sensor.

A camera that is rotated a little is the same camera, so the best common rotation is removed before corners are
compared.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.model.camera import CameraModel
from calib.uncertainty.projection_uncertainty import sensor_grid
from simulators.world.truth import CameraTruth

FloatArray = NDArray[np.float64]

_ACROSS = 17


def true_camera(truth: CameraTruth) -> CameraModel:
    """Return the true camera as the engine describes cameras.

    truth: Lens and sensor; not a fisheye.
    Returns: Camera with k1, k2, p1, p2 and k3.
    """
    lens = {name: getattr(truth, name) for name in ("k1", "k2", "p1", "p2", "k3")}
    return CameraModel(truth.fx, truth.fy, truth.cx, truth.cy, (truth.width, truth.height), lens)


def corner_errors_urad(camera: CameraModel, truth: CameraTruth) -> FloatArray:
    """Return the angles between calibrated and true rays of the sensor's corners, after the best common rotation.

    The rotation is that of Kabsch (1976) over a grid on the whole sensor.

    Returns: (4,) angles, urad.
    """
    exact = true_camera(truth)
    grid = sensor_grid(camera.image_size, _ACROSS).reshape(-1, 2)
    found, right = _unit(camera.rays(grid)), _unit(exact.rays(grid))
    u, _, v = np.linalg.svd(right.T @ found)
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    w, h = truth.width - 1.0, truth.height - 1.0
    corners = np.array([[0.0, 0.0], [w, 0.0], [0.0, h], [w, h]])
    away = _unit(camera.rays(corners)) @ turn.T - _unit(exact.rays(corners))
    return np.asarray(1e6 * np.linalg.norm(away, axis=1))


def _unit(rays: FloatArray) -> FloatArray:
    """Return rays of length 1."""
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))
