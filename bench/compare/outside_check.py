"""What a bench shows without the truth: the gimbal's angles as a check from outside, and the time that images take.

A star is the same direction in every image, so the rotation between two images follows from the camera alone: no
collimator enters. With a focal length that is too long by some share, the camera seems to turn less by that share.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from bench.compare.spec import STAR_METHODS, ColumnConfig
from calib.model.camera import CameraModel
from calib.view import View

Array = NDArray[np.float64]

#: Seconds of a run on the simulated bench: before the first pose, and for each (move, settle, record), as planned.
_BEFORE_S, _POSE_S = 3.2, 2.3
#: Seconds in which a person places a board, or moves a camera past it: an assumption.
_PLACEMENT_S, _PASS_S = 20.0, 2.0
_FEWEST_COMMON = 12
_SMALLEST_TURN_DEG = 1.0


def bench_time_s(column: ColumnConfig) -> float:
    """Return how long the images of a column keep a bench busy.

    Returns: Time, s; for boards with the assumption of 20 s a placement, for a moving camera of 2 s a
      picture.
    """
    if column.method in STAR_METHODS:
        return _BEFORE_S + column.images * _POSE_S
    return column.images * (_PASS_S if column.method == "reconstruction" else _PLACEMENT_S)


def gimbal_ratio_error(
    camera: CameraModel, views: Sequence[View], readings_deg: Sequence[Mapping[str, float]]
) -> float | None:
    """Return by what share the camera turns more than the gimbal says.

    Rotation between two images by Kabsch (1976), from the rays of their common stars; the shares of all pairs of poses
    are weighted by the square of their angle.

    readings_deg: Readings of the gimbal for each view, degrees; with pan and tilt about axes at right angles.
    Returns: Share, 0 if both agree; None without two views and readings.
    """
    if len(readings_deg) != len(views):
        return None
    product, square = 0.0, 0.0
    for first, second in combinations(range(len(views)), 2):
        read = _turn(_gimbal(readings_deg[first]).T @ _gimbal(readings_deg[second]))
        _, at_first, at_second = np.intersect1d(views[first].ids, views[second].ids, return_indices=True)
        if len(at_first) < _FEWEST_COMMON or read < np.radians(_SMALLEST_TURN_DEG):
            continue
        rays = [
            _unit(camera.rays(view.points_px[at]))
            for view, at in ((views[first], at_first), (views[second], at_second))
        ]
        seen = _turn(_kabsch(*rays))
        product += seen * read
        square += read * read
    return product / square - 1.0 if square else None


def _gimbal(angles_deg: Mapping[str, float]) -> Array:
    """Return the rotation of a gimbal: pan about the vertical axis carries tilt about the horizontal one."""
    pan, tilt = (np.radians(angles_deg.get(f"{axis}_deg", 0.0)) for axis in ("pan", "tilt"))
    c, s = np.cos(pan), np.sin(pan)
    about_y = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    c, s = np.cos(tilt), np.sin(tilt)
    return np.asarray(about_y @ np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]))


def _kabsch(first: Array, second: Array) -> Array:
    left, _, right = np.linalg.svd(first.T @ second)
    mirror = np.diag([1.0, 1.0, np.linalg.det(left @ right)])
    return np.asarray(left @ mirror @ right)


def _turn(rotation: Array) -> float:
    """Return the angle of a rotation, rad, exact for small angles."""
    skew = np.array(
        [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    )
    return float(np.arctan2(0.5 * np.linalg.norm(skew), 0.5 * (np.trace(rotation) - 1.0)))


def _unit(rays: Array) -> Array:
    return np.asarray(rays / np.linalg.norm(rays, axis=1)[:, None])
