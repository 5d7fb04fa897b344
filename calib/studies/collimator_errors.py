"""Expected errors of a collimator: how far its views deviate from the model that is fitted to them.

The deviations are random fields on the target, drawn anew in each pose. Their shapes are those of
`calib.uncertainty.variance_components`, so that a forecast and a calibration describe the same errors. Two more shapes
follow the camera's entrance pupil: a shift of the pattern, and the keystone that a moved centre leaves. The sizes in
relation to each other were measured on simulated collimators that are like a published real one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.errors import InputMismatch

Array = NDArray[np.float64]

#: `CollimatorErrors.rms_px` of a typical real collimator before a gimbal, with the radial model, px: of runs on the
#: simulated bench "like-bench".
TYPICAL_RMS_PX = 0.12
#: 1-sigma of a coefficient of each group of `calib.uncertainty.variance_components`, over the 1-sigma of the residuals:
#: shifts along X and Y, polynomials of degree 1 to 4, rim of the beam.
SPECTRUM = (0.5, 0.5, 0.41, 0.31, 0.27, 0.17, 0.31)
#: Largest degree of the polynomials that all views share (`calib.uncertainty.common_errors`).
COMMON_DEGREES = 4
#: 1-sigma of a coefficient of the displacements that all views share, over the 1-sigma of the residuals: polynomials of
#: degree 1 to 4. Of drawn benches "like-bench" with 9 to 50 poses, as the calibration of each finds them.
COMMON_SPECTRUM = (0.36, 0.36, 0.25, 0.22)
#: Keystone of a view over the displacement of the pupil: a moved pupil acts as a moved centre of the collimator.
KEYSTONE_PER_PUPIL = 0.18
#: Defocus of a collimator whose defocus is not stated.
TYPICAL_DEFOCUS = 0.066


@dataclass(frozen=True)
class CollimatorErrors:
    """Size of the errors of a collimator.

    rms_px: Root mean square length of the residuals that a calibration leaves, px (`Calibration.rms_px`),
      star noise included; 0 for an ideal collimator.
    pupil_wander_mm: Random displacement of the camera's entrance pupil across the beam from pose to pose, 1
      sigma per axis, mm: 0 if a gimbal holds the camera.
    defocus: The collimator's defocus (`calib.model.gimbal_readings.ParallaxBound`).
    pupil_off_pivot_mm: Distance of the entrance pupil in front of the gimbal's pivot, mm; the pupil then
      moves across the beam as the camera turns.
    Raises InputMismatch: If a size is negative, or a number is not finite.
    """

    rms_px: float = 0.0
    pupil_wander_mm: float = 0.0
    defocus: float = TYPICAL_DEFOCUS
    pupil_off_pivot_mm: float = 0.0

    def __post_init__(self) -> None:
        for name in ("rms_px", "pupil_wander_mm"):
            if not 0 <= getattr(self, name) < np.inf:
                raise InputMismatch(f"{name} is {getattr(self, name)}; it must not be negative.")
        for name in ("defocus", "pupil_off_pivot_mm"):
            if not np.isfinite(getattr(self, name)):
                raise InputMismatch(f"{name} is {getattr(self, name)}; it must be a number.")

    def field_px(self, star_sigma_px: float) -> float:
        """Return the part of the residuals that is not star noise.

        star_sigma_px: 1-sigma of a star per axis, px.
        Returns: 1-sigma per axis, px; 0 if star noise explains the residuals.
        """
        return float(np.sqrt(max(0.5 * self.rms_px**2 - star_sigma_px**2, 0.0)))

    def pupil_mm(self, turns: Array) -> Array:
        """Return how far the pupil moves across the beam.

        turns: (n, 2) tangents of the camera's turn in each pose, along the target's X and Y.
        Returns: (2,) 1-sigma over the poses along X and Y, mm.
        """
        walk = self.pupil_off_pivot_mm * np.sqrt((turns**2).mean(axis=0))
        return np.hypot(walk, self.pupil_wander_mm)
