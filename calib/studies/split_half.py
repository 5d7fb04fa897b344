"""Split-half test: two halves share no view, so their difference shows whether the uncertainties are too small."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.calibration import Calibration, CalibrationOptions
from calib.engine import calibrate
from calib.errors import DegenerateViews
from calib.uncertainty.projection_uncertainty import (
    CameraDifference,
    camera_difference,
    projection_uncertainty,
)
from calib.view import View

#: Each half must determine a camera.
_MIN_VIEWS = 4


@dataclass(frozen=True)
class SplitHalf:
    """Two calibrations of one camera, and their difference at infinity."""

    halves: tuple[Calibration, Calibration]
    difference: CameraDifference
    # Root mean square difference over the sensor that their uncertainties let expect, px.
    expected_px: float

    @property
    def ratio(self) -> float:
        """Difference found over difference expected: 1 or below if the uncertainties are right.

        Below 1 where both halves have an error in common, such as that of the collimator, which their difference lacks.
        """
        return self.difference.rms_px / self.expected_px


def split_half(views: Sequence[View], options: CalibrationOptions | None = None) -> SplitHalf:
    """Calibrate every other view of at least 4, and the rest, and compare.

    Own statistic: the expected difference is the root of the mean of s1^2 + s2^2 over the sensor, with the projection
    uncertainties s1 and s2. Each half must constrain the camera.
    """
    if len(views) < _MIN_VIEWS:
        raise DegenerateViews(f"{len(views)} views; two halves need at least {_MIN_VIEWS}.")
    first, second = (calibrate(views[begin::2], _every_other(options, begin)) for begin in (0, 1))
    maps = [projection_uncertainty(half.camera, half.camera_covariance).sigma_px for half in (first, second)]
    expected = float(np.sqrt(np.nanmean(maps[0] ** 2 + maps[1] ** 2)))
    return SplitHalf((first, second), camera_difference(first.camera, second.camera), expected)


def _every_other(options: CalibrationOptions | None, begin: int) -> CalibrationOptions | None:
    """Return the options for every other view: the gimbal's readings are those of these views."""
    if options is None or options.gimbal is None:
        return options
    readings = replace(options.gimbal, angles_deg=options.gimbal.angles_deg[begin::2])
    return replace(options, gimbal=readings)
