"""The boresight by the posterior: how the camera is mounted on the stage, jointly with its principal point.

The readings see how the image turns with the axes. The camera's own axis rests on its principal point besides; the ray
through the middle of the image does not, and is known better.
"""

from __future__ import annotations

import numpy as np

from calib.arrays import Array
from calib.joint.posterior import Posterior
from calib.model.camera import CameraModel
from calib.model.gimbal import MOUNTING, Gimbal
from calib.model.result_parts import Boresight
from calib.model.rotation import skew

#: A mounting with a larger 1-sigma is not determined, rad: one axis alone leaves a turn free.
_UNDETERMINED = 0.05


def boresight(posterior: Posterior, camera: CameraModel, gimbal: Gimbal | None) -> Boresight | None:
    """Return the mounting with its uncertainty.

    None if no readings determine it, or if the camera would look backwards: an axis has the wrong sign.
    """
    if gimbal is None:
        return None
    layout = posterior.optimum.marginal.problem.bench.layout
    at = layout.places(MOUNTING)
    covariance = posterior.covariance[np.ix_(at, at)]
    rotation = gimbal.camera_from_head
    if np.linalg.eigvalsh(covariance)[-1] > _UNDETERMINED**2 or rotation[2, 2] < 0.0:
        return None
    unit = np.eye(len(layout.names))
    ray, moved = _moved_sight(camera, unit[layout.places(layout.pose.camera)], unit[at])
    across = np.cross([0.0, 1.0, 0.0], ray)
    across /= np.linalg.norm(across)
    rows = np.stack([across, np.cross(ray, across)]) @ moved
    return Boresight(
        rotation,
        covariance,
        np.degrees([posterior.expanded(row) for row in unit[at]]),
        rotation.T @ ray,
        rows @ posterior.covariance @ rows.T,
        np.degrees([posterior.expanded(row) for row in rows]),
    )


def _moved_sight(camera: CameraModel, parameters: Array, mounting: Array) -> tuple[Array, Array]:
    """Return the ray through the image's middle, (3,), and how it moves on the flange by the unknowns, (3, S)."""
    middle = (np.array([camera.image_size]) - 1.0) / 2.0
    ray = camera.rays(middle)[0]
    _, by_ray, by_parameters = camera.project_with_jacobians(ray[None])
    return ray, skew(ray[None])[0] @ mounting - np.linalg.pinv(by_ray[0]) @ by_parameters[0] @ parameters
