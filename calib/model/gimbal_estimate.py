"""What a calibration found out about the gimbal, if its readings took part: data only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class GimbalEstimate:
    """Parameters of the gimbal after the joint adjustment with the stars."""

    # Whether the readings entered the estimate; False if they contradicted the stars, and all other numbers
    # then tell how.
    entered: bool
    # values, sigma: Parameters by name and their 1-sigma: rotation vectors of mounting and standing, deg;
    # scales (true angle over reading); the angle between pan and tilt minus a right angle, deg; parallax
    # along x and y (displacement of the pattern per unit tangent of the turn, as a share of r).
    values: Mapping[str, float]
    sigma: Mapping[str, float]
    chi_square: float
    degrees_of_freedom: int
    rms_deg: float  # Root mean square rotation between reading and stars, degrees
    # Standard uncertainty of a reading with which the readings entered, degrees; larger than stated if they
    # scatter more than stated.
    reading_sigma_deg: float
    scatter: float  # How many times more than stated the readings scatter; 1 is agreement
    source: str = ""  # Where the statements come from

    def to_dict(self) -> dict[str, Any]:
        """Return the estimate as plain numbers and names, ready for JSON."""
        return {**asdict(self), "values": dict(self.values), "sigma": dict(self.sigma)}
