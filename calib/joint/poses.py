"""Which views are one pose: they share the errors that differ from pose to pose, and do not count as new.

The camera is turned alike, and its stars differ by a small turn and noise only. A hand that moves the camera, and
places it as it was turned before, shows the glass from elsewhere: then the stars differ smoothly over the image.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.parameters import AdjustmentParameters, poses_of, turned_alike
from calib.arrays import Array
from calib.joint.amplitudes import Pupil
from calib.model.beam import discs_of
from calib.model.camera import CameraModel
from calib.model.rim_fit import Discs
from calib.view import View

#: Stars whose distance from a smooth difference is so many times the median are left out.
_OUTLIER = 4.0
#: Views are other poses if a smooth difference explains so much of what a turn leaves, in 2 log of a likelihood ratio
#: (by chance in 1 of 1000 pairs: 12 coefficients instead of 3), and is larger than this share of the noise's variance.
#: Repeats in 360 drawn pairs had .12 at most. Of 55 pairs that were no repeats, 37 pass.
_DECISIVE, _SMOOTH = 28.0, 0.25
#: Smallest residual that counts, px: views can be copies.
_EXACT_PX = 1e-6


class Poses(NamedTuple):
    """The poses of a search. They are found once: a step of the search could join two poses, or part them."""

    of_views: NDArray[np.int64]  # (V,) pose of each view
    discs: Discs | None = None  # Of each pose, if a rim is in view
    pupil: Pupil = Pupil.HELD


def seen_poses(views: Sequence[View], start: AdjustmentParameters) -> Poses:
    """Return the poses of views, whose camera and rotations are nearly known."""
    moved = np.zeros((len(views), len(views)), np.bool_)
    for i, j in np.argwhere(np.tril(turned_alike(start.rotations), -1)):
        moved[i, j] = moved[j, i] = _moved(views[j], views[i], start.camera)
    poses = np.array(poses_of(start.rotations, moved), np.int64)
    return Poses(poses, discs_of([views[v] for v in np.unique(poses, return_index=True)[1]]))


def _moved(first: View, second: View, camera: CameraModel) -> bool:
    """Tell whether the stars of two views differ smoothly, beyond a small turn and their noise."""
    _, i, j = np.intersect1d(first.ids, second.ids, return_indices=True)
    rays = camera.rays(first.points_px[i])
    kept = np.isfinite(rays).all(axis=1)
    rays, movements = rays[kept], (second.points_px[j] - first.points_px[i])[kept]
    x, y = rays[:, 0], rays[:, 1]
    smooth = np.column_stack([np.ones(len(x)), x, y, x * x, x * y, y * y])
    if len(smooth) <= smooth.shape[1]:
        return False
    left = np.linalg.norm(movements - smooth @ np.linalg.lstsq(smooth, movements)[0], axis=1)
    good = left <= _OUTLIER * np.median(left)
    by_point = camera.project_with_jacobians(rays)[1]
    turned = np.cross(np.eye(3)[:, None], rays[None]).transpose(1, 2, 0)
    by_turn = (by_point @ turned)[good]
    rest = _squares(smooth[good], movements[good])
    more = max(_squares(by_turn.reshape(-1, 3), movements[good].reshape(-1)) - rest, 0.0)
    share = more / max(rest, good.sum() * _EXACT_PX**2)
    return share > _SMOOTH and 2 * (int(good.sum()) - smooth.shape[1]) * math.log1p(share) > _DECISIVE


def _squares(design: Array, values: Array) -> float:
    """Return the sum of the squared residuals of a linear model."""
    return float(np.sum((values - design @ np.linalg.lstsq(design, values)[0]) ** 2))
