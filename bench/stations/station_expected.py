"""Section `expected` of the station file: approximate values of the bench, for forecasts and studies only."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from bench.stations.station_collimator import CollimatorConfig
from bench.stations.station_fields import FocalLength
from calib.studies.collimator_errors import TYPICAL_DEFOCUS, TYPICAL_RMS_PX, CollimatorErrors
from sequences.plain_number import Within
from sequences.strict_model import StrictModel

_Side = Annotated[int, Within(8, 65_536, "px")]
_Coefficient = Annotated[float, Within(-1000, 1000)]


class ExpectedCollimatorConfig(StrictModel):
    """How far the views of this collimator deviate from an ideal one."""

    rms_px: Annotated[
        float,
        Field(
            ge=0,
            le=100,
            description="RMS length of the errors that follow the collimator, star noise included, px; 0: none.",
        ),
    ] = TYPICAL_RMS_PX
    pupil_wander_mm: Annotated[
        float,
        Field(ge=0, le=1000, description="Random shift of the camera's pupil across the beam between poses."),
    ] = 0.0
    pose_rms_px: Annotated[
        float,
        Field(
            ge=0, le=100, description="RMS length of the errors that differ from pose to pose, px; 0: small."
        ),
    ] = 0.0


class ExpectedConfig(StrictModel):
    """Approximate properties of the bench, for plans and studies only; no estimator uses them."""

    focal_px: Annotated[float, Within(10, 1e6, "px")]
    r_mm: FocalLength
    half_angle_deg: Annotated[float, Field(ge=0.01, lt=60, description="Half angle of the beam.")]
    image_size: tuple[_Side, _Side] = (1280, 720)
    k1: _Coefficient = 0.0
    k2: _Coefficient = 0.0
    star_sigma_px: Annotated[
        float, Within(1e-4, 100, "px"), Field(description="Uncertainty of a star, per axis.")
    ] = 0.02
    collimator: ExpectedCollimatorConfig = ExpectedCollimatorConfig()

    def errors(self, collimator: CollimatorConfig) -> CollimatorErrors:
        """Return the expected errors of the collimator.

        Returns: Errors for a forecast; a defocus that is not stated has a typical size.
        """
        return CollimatorErrors(
            self.collimator.rms_px,
            self.collimator.pupil_wander_mm,
            collimator.defocus.value if collimator.defocus else TYPICAL_DEFOCUS,
            self.collimator.pose_rms_px,
        )
