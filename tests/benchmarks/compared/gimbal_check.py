"""What a bench shows without the truth: the gimbal's angles as a check from outside.

A star is the same direction in every image, so the rotation between two images follows from the camera alone: no
collimator enters. With a focal length that is too long by some share, the camera seems to turn less by that share.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from calib import CameraModel, View
from calib.model.rotation import exp_map, log_map, nearest_rotation

Array = NDArray[np.float64]

_FEWEST_COMMON = 12
_SMALLEST_TURN_DEG = 1.0


def gimbal_ratio_error(
    camera: CameraModel, views: Sequence[View], readings_deg: Sequence[Mapping[str, float]]
) -> float | None:
    """Return by what share the camera turns more than the gimbal says; None without two views and readings.

    Rotation between two images by Kabsch (1976), from common stars; pairs of poses are weighted by the squared angle.
    """
    if len(readings_deg) != len(views):
        return None
    product, square = 0.0, 0.0
    for first, second in combinations(range(len(views)), 2):
        read = _turn(_gimbal(readings_deg[first]).T @ _gimbal(readings_deg[second]))
        _, at_first, at_second = np.intersect1d(views[first].ids, views[second].ids, return_indices=True)
        if len(at_first) < _FEWEST_COMMON or read < np.radians(_SMALLEST_TURN_DEG):
            continue
        rays_first, rays_second = (
            camera.rays(view.points_px[at])
            for view, at in ((views[first], at_first), (views[second], at_second))
        )
        seen = _turn(nearest_rotation(_unit(rays_first).T @ _unit(rays_second)))
        product += seen * read
        square += read * read
    return product / square - 1.0 if square else None


def _gimbal(angles_deg: Mapping[str, float]) -> Array:
    """Return the rotation of a gimbal: pan about the vertical axis carries tilt about the horizontal one."""
    pan, tilt = (np.radians(angles_deg.get(f"{axis}_deg", 0.0)) for axis in ("pan", "tilt"))
    return exp_map(np.array([0.0, pan, 0.0])) @ exp_map(np.array([tilt, 0.0, 0.0]))


def _unit(rays: Array) -> Array:
    return np.asarray(rays / np.linalg.norm(rays, axis=1)[:, None])


def _turn(rotation: Array) -> float:
    """Return the angle of a rotation, rad."""
    return float(np.linalg.norm(log_map(rotation)))
