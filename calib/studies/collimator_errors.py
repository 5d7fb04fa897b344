"""Expected errors of a collimator: how far its views deviate from an ideal one, for forecasts.

The joint adjustment describes them by amplitudes (`calib.joint.amplitudes`). The sizes here say how many times larger
these are than those of a good collimator.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.errors import InputMismatch

#: `CollimatorErrors.rms_px` of a typical real collimator before a gimbal, px.
TYPICAL_RMS_PX = 0.12
#: Defocus of a collimator whose defocus is not stated.
TYPICAL_DEFOCUS = 0.066
#: RMS error of a good collimator per axis, rad: what all views share, and what differs from pose to pose. They follow
#: from the medians of the amplitudes: a degree each, added in squares.
GOOD_RAD, GOOD_POSE_RAD = 1.9e-5, 4e-6
#: An ideal collimator is found to be this many times better than a good one: the views do not show more.
_IDEAL = 0.05
#: What differs from pose to pose if a gimbal holds the camera, over what is expected of a good collimator beforehand.
_STEADY = 0.3
#: Field of a view over the displacement of the pupil, as a share of the squared tangent of the field's edge.
_KEYSTONE = 0.09


@dataclass(frozen=True)
class CollimatorErrors:
    """Size of the errors of a collimator.

    rms_px: Root mean square length of the errors that follow the collimator, star noise included, px; 0 for an ideal
      collimator.
    pupil_wander_mm: Random displacement of the camera's entrance pupil across the beam from pose to pose, 1
      sigma per axis, mm: 0 if a gimbal holds the camera.
    defocus: The collimator's defocus (`calib.model.gimbal_readings.ParallaxBound`).
    pose_rms_px: Root mean square length of the errors that differ from pose to pose, star noise included, px; 0 if
      they are as small as those of a good collimator.
    Raises InputMismatch: If a size is negative, or a number is not finite.
    """

    rms_px: float = 0.0
    pupil_wander_mm: float = 0.0
    defocus: float = TYPICAL_DEFOCUS
    pose_rms_px: float = 0.0

    def __post_init__(self) -> None:
        for name in ("rms_px", "pupil_wander_mm", "pose_rms_px"):
            if not 0 <= getattr(self, name) < np.inf:
                raise InputMismatch(f"{name} is {getattr(self, name)}; it must not be negative.")
        if not np.isfinite(self.defocus):
            raise InputMismatch(f"defocus is {self.defocus}; it must be a number.")

    def times_good(self, focal_px: float, star_sigma_px: float) -> float:
        """Return how many times larger the errors are than those of a good collimator."""
        return max(_per_axis(self.rms_px, star_sigma_px) / focal_px / GOOD_RAD, _IDEAL)

    def pose_times_good(self, focal_px: float, star_sigma_px: float, r_mm: float, edge: float) -> float:
        """Return the same of the errors that differ from pose to pose.

        r_mm: Radius of the collimator, mm. edge: Tangent of the half angle of the beam.
        """
        own = _per_axis(self.pose_rms_px, star_sigma_px) / focal_px
        own = float(np.hypot(own, _KEYSTONE * edge**2 * self.pupil_wander_mm / r_mm))
        return max(own / GOOD_POSE_RAD, _STEADY * self.times_good(focal_px, star_sigma_px), _IDEAL)


def _per_axis(rms_px: float, star_sigma_px: float) -> float:
    """Return the part of an RMS length that is not star noise, 1-sigma per axis, px; 0 if star noise explains it."""
    return float(np.sqrt(max(0.5 * rms_px**2 - star_sigma_px**2, 0.0)))
