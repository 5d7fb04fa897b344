"""What a camera of a calibration file must be, whoever wrote it."""

from __future__ import annotations

import numpy as np

from bench.camera_files.forms import LARGEST
from bench.camera_files.texts import OtherForm
from calib.model.camera import SKEW, CameraModel
from calib.model.lens import FISHEYE, OPENCV

_MOST_PX = 200_000_000  # The largest sensors that are sold have 150 Mpx
_FAR_FROM_MIDDLE = 0.15
"""Of the width or height: farther from the middle, a principal point is remarkable; `calibrate` has the same share."""
_LEAST_FOCAL_SHARE = 0.08
"""Of the longer side: a fisheye of 220 degrees has 0.26, and this if its image fills a third of the side. A shorter
focal length is in mm, or is a share itself."""
_SWAPPED_FROM, _SWAPPED_TO = 0.05, 1 / 3
"""The sides are swapped if the principal point is this share of a side from the middle, and the swapped sides put it
this many times nearer. A principal point nearer to the middle may lie there by chance."""


def require_possible_camera(camera: CameraModel) -> None:
    """Raise OtherForm if a value is not finite, or a length is not possible in the image."""
    sides = camera.image_size
    if not (np.abs(camera.values) < LARGEST).all():
        raise OtherForm("a value of the camera is not finite")
    if not set(camera.distortion) <= {*OPENCV, SKEW} and not set(camera.distortion) <= {*FISHEYE, SKEW}:
        raise OtherForm(f"no lens has the coefficients {' '.join(camera.distortion)}")
    if min(sides) < 1 or sides[0] * sides[1] > _MOST_PX:
        raise OtherForm(f"an image of {sides[0]} x {sides[1]} px is not possible")
    if min(camera.fx, camera.fy) < _LEAST_FOCAL_SHARE * max(sides):
        raise OtherForm(
            f"focal lengths of {camera.fx:g} and {camera.fy:g} px are not possible with {sides[0]} x {sides[1]} px",
            "Give a file that states them in px.",
        )
    from_middle, from_swapped = (_from_middle(camera, size) for size in (sides, sides[::-1]))
    if from_middle > _SWAPPED_FROM and from_swapped < _SWAPPED_TO * from_middle:
        raise OtherForm(
            f"its image has {sides[0]} x {sides[1]} px, and the principal point ({camera.cx:g}, {camera.cy:g}) is the"
            f" middle of {sides[1]} x {sides[0]} px: the height seems to stand before the width",
            "The width stands first. numpy has the height first.",
        )


def is_far_from_middle(camera: CameraModel, sides: tuple[int, int]) -> bool:
    """Return whether the principal point is remarkably far from the middle of an image with these sides, px."""
    return _from_middle(camera, sides) > _FAR_FROM_MIDDLE


def _from_middle(camera: CameraModel, sides: tuple[int, int]) -> float:
    """Return how far the principal point is from the middle of an image with these sides, as a share of a side."""
    return float(np.abs(np.array([camera.cx, camera.cy]) / sides - 0.5).max())
