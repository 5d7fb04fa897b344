"""What a camera of a calibration file must be, whoever wrote it."""

from __future__ import annotations

from typing import Final

import numpy as np

from bench.plan.camera_text import OtherForm
from calib.model.camera import SKEW, CameraModel
from calib.model.lens import FISHEYE, OPENCV, TILT

LARGEST: Final = 1e15
"""Of any value: a lens of long focal length has coefficients of 1e9."""
_MOST_PX = 200_000_000
_FAR_FROM_MIDDLE = 0.15
"""Of the width or height: farther from the middle, a principal point is remarkable; `calibrate` has the same share."""
_LEAST_FOCAL_SHARE = 0.08
"""Of the longer side: a fisheye of 220 degrees has 0.26, and this if its image fills a third of the side. A shorter
focal length is in mm, or is a share itself."""
_MOST_TILT_RAD = 0.7
"""Of the sensor against the lens: 40 degrees, more than any Scheimpflug adapter; a larger number is in degrees."""
_AT_CORNER = 0.05
"""Of the width and height: a principal point so near the first pixel is an offset from the middle."""
_MOST_SQUEEZED = 1.25
"""Ratio of fx and fy; event and frame cameras have square pixels."""
_SWAPPED_FROM, _SWAPPED_TO = 0.05, 1 / 3
"""The sides are swapped if the principal point is this share of a side from the middle, and the swapped sides put it
this many times nearer."""


def require_possible_camera(camera: CameraModel) -> None:
    """Raise OtherForm if a value is not finite, or a length is not possible in the image."""
    sides = camera.image_size
    if not (np.abs(camera.values) < LARGEST).all():
        raise OtherForm("a value of the camera is not finite")
    if not set(camera.distortion) <= {*OPENCV, SKEW} and not set(camera.distortion) <= {*FISHEYE, SKEW}:
        raise OtherForm(f"no lens has the coefficients {' '.join(camera.distortion)}")
    tilt_rad = max(abs(camera.distortion.get(name, 0.0)) for name in TILT)
    if tilt_rad > _MOST_TILT_RAD:
        raise OtherForm(
            f"a sensor that is tilted by {tilt_rad:g} rad is not possible", "Write tauX and tauY in rad."
        )
    if min(sides) < 1 or sides[0] * sides[1] > _MOST_PX:
        raise OtherForm(f"an image of {sides[0]} x {sides[1]} px is not possible")
    if min(camera.fx, camera.fy) < _LEAST_FOCAL_SHARE * max(sides):
        raise OtherForm(
            f"focal lengths of {camera.fx:g} and {camera.fy:g} px are not possible with {sides[0]} x {sides[1]} px",
            "Write focal lengths and principal point in px; some programs state them in mm, or as shares of the image.",
        )
    from_middle, from_swapped = (_from_middle(camera, size) for size in (sides, sides[::-1]))
    if is_far_from_middle(camera, sides) and max(np.abs([camera.cx, camera.cy]) / sides) < _AT_CORNER:
        raise OtherForm(
            f"the principal point ({camera.cx:g}, {camera.cy:g}) lies at the first pixel: some programs state it"
            " from the middle of the image",
            "Write it in px from the centre of the first pixel.",
        )
    squeeze = max(camera.fx / camera.fy, camera.fy / camera.fx)
    if is_far_from_middle(camera, sides) and squeeze > _MOST_SQUEEZED:
        raise OtherForm(
            f"fx {camera.fx:g}, fy {camera.fy:g}, cx {camera.cx:g} and cy {camera.cy:g} are not possible together in an"
            f" image of {sides[0]} x {sides[1]} px",
            "Write them in the order fx fy cx cy; some programs have fx cx fy cy.",
        )
    if from_middle > _SWAPPED_FROM and from_swapped < _SWAPPED_TO * from_middle:
        raise OtherForm(
            f"its image has {sides[0]} x {sides[1]} px, and the principal point ({camera.cx:g}, {camera.cy:g}) is the"
            f" middle of {sides[1]} x {sides[0]} px: the height seems to stand before the width",
            "Write the width first. numpy and MATLAB have the height first.",
        )


def is_far_from_middle(camera: CameraModel, sides: tuple[int, int]) -> bool:
    """Return whether the principal point is remarkably far from the middle of an image with these sides, px."""
    return _from_middle(camera, sides) > _FAR_FROM_MIDDLE


def _from_middle(camera: CameraModel, sides: tuple[int, int]) -> float:
    """Return how far the principal point is from the middle of an image with these sides, as a share of a side."""
    return float(np.abs(np.array([camera.cx, camera.cy]) / sides - 0.5).max())
