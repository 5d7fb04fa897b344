"""Parts of a result as data: budget rows, statements, their witnesses, amplitudes, gimbal, boresight, a check."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np

from calib.arrays import Array, ReadOnlyArrays
from calib.model.rotation import log_map, skew

#: Share of its distribution that an expanded uncertainty covers (JCGM 100:2008, 6.2.1, for k = 2).
COVERAGE = 0.9545
#: The quantities of a row: the pinhole parameters, and the point of the sensor with the largest projection uncertainty.
WORST_CORNER = "worst_corner"
ROW_QUANTITIES = ("fx", "fy", "cx", "cy", WORST_CORNER)

#: Names of the rows that an adjustment itself gives.
STARS, READINGS = "stars", "readings of the gimbal"
POSE_FIELDS, COMMON_FIELD = "disagreement of the views", "errors that all views share"
TURN_FIELDS, AMPLITUDES = "errors that follow the turn", "sizes of the errors"
UNSTEADY = "focal length that is not steady"
PUPILS = "places of the pupil"
PASSPORT, PRIORS, LENS = "passport of the collimator", "known beforehand", "expected lens"
PARALLAX, UNBOUNDED_PARALLAX = "parallax", "parallax, not bounded"
GIMBAL_SCALE, GIMBAL_AXES = "scale and eccentricity of the gimbal", "mounting and axes of the gimbal"
#: A single kind of change is named if it explains this share of the squared difference.
_EXPLAINS = 0.8


@dataclass(frozen=True)
class BudgetRow:
    """A source of uncertainty and its contribution (JCGM 100:2008, section 7.2.7)."""

    name: str
    # ``A``: evaluated from the views of this calibration. ``B``: evaluated by other means.
    type: Literal["A", "B"]
    source: str  # Where the value comes from
    # Distribution of the value; ``normal``, ``rectangular``, ``triangular`` or ``u-shaped``.
    distribution: str = "normal"
    value: float | None = None  # Stated value; None if the row is not about one value
    unit: str = ""  # Unit of the value; empty if the row is not about one value
    # Value over its standard uncertainty; None if the row is not about one value
    divisor: float | None = None
    degrees_of_freedom: float | None = None  # Degrees of freedom; None if they are infinite
    # For each quantity the change, px, by one unit of the value; empty if the row is not about one value.
    # That of the worst corner, and all of a wavefront, have no sign.
    sensitivity: Mapping[str, float] = field(default_factory=dict)
    # For each quantity the standard uncertainty that the source contributes, px.
    contribution: Mapping[str, float] = field(default_factory=dict)
    # For each quantity the share of the source in the combined variance.
    share: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, name: str, kind: Literal["A", "B"], source: str, variances: Array, whole: Array) -> BudgetRow:
        """Return the row of a source from (5,) its variances of `ROW_QUANTITIES` and (5,) those of the whole result."""
        sigmas, shares = np.sqrt(np.maximum(variances, 0.0)), variances / np.where(whole > 0, whole, 1.0)
        named = [dict(zip(ROW_QUANTITIES, each.tolist(), strict=True)) for each in (sigmas, shares)]
        return cls(name, kind, source, contribution=named[0], share=named[1])


@dataclass(frozen=True)
class Witness:
    """A statement, and what the views and all other statements say of the same quantity."""

    name: str  # What is stated, in words
    source: str  # Who states it
    unit: str  # Unit of the numbers; empty for shares and for a joint statement
    stated: float | None  # Stated value; None for a joint statement of several values
    sigma: float | None  # Standard uncertainty of the stated value; None for a joint statement
    expected: float | None  # Value by all others; None for a joint statement
    expected_sigma: float | None  # Standard uncertainty of that; None for a joint statement
    # Stated minus expected over the sigma of that difference: 2 is unusual, 3 a contradiction. For a joint
    # statement the root mean square, without a sign.
    innovation: float
    # Probability that the statement is at fault: wrong, or its sigma several times too small.
    fault_probability: float


@dataclass(frozen=True)
class Amplitude:
    """The size of a family of errors, estimated from the views."""

    name: str
    value: float  # In the unit below, at the mode of its posterior
    log_sigma: float  # 1-sigma of its natural logarithm
    unit: str  # ``urad`` of the direction; 1 for factors of what is stated, and for coefficients
    expected: float  # Median of its prior

    @property
    def plain(self) -> float:
        """Its value as the adjustment has it: without a unit, a direction in rad."""
        return self.value * (1e-6 if self.unit == "urad" else 1.0)


@dataclass(frozen=True)
class GimbalEstimate:
    """Parameters of the gimbal after the joint adjustment with the stars."""

    # Whether the readings entered the estimate; False if they contradicted the stars, and all other numbers
    # then tell how.
    entered: bool
    # Parameters by name: rotation vectors of mounting and standing, deg; scales (true angle over reading); the
    # angle between pan and tilt minus a right angle, deg; parallax along x and y (displacement of the pattern per
    # unit tangent of the turn, as a share of r).
    values: Mapping[str, float]
    sigma: Mapping[str, float]  # Their 1-sigma, by name
    chi_square: float
    degrees_of_freedom: int
    rms_deg: float  # Root mean square rotation between reading and stars, degrees
    # Standard uncertainty of a reading with which the readings entered, degrees; larger than stated if they
    # scatter more than stated.
    reading_sigma_deg: float
    scatter: float  # How many times more than stated the readings scatter; 1 is agreement
    source: str = ""  # Where the statements come from


@dataclass(frozen=True)
class Boresight(ReadOnlyArrays):
    """The rotation from the stage's flange to the camera, by the gimbal's readings.

    The flange's frame is that of the stage at the zero of its readings: x along the tilt axis, y along the pan axis, as
    far as it is square to tilt, and z along x times y, where the camera looks.
    """

    rotation: Array  # (3, 3) float64, camera <- flange
    covariance: Array  # (3, 3) float64 of its rotation vector about the camera's axes, rad^2
    expanded_deg: Array  # (3,) float64 expanded uncertainties about the camera's x, y and z
    # (3,) float64 unit vector in the flange's frame: the ray through the middle of the image.
    sight: Array
    # (2, 2) float64 covariance of the ray along the camera's x and y, rad^2.
    sight_covariance: Array
    sight_expanded_deg: Array  # (2,) float64 expanded uncertainties of the ray along the camera's x and y

    @property
    def vector_deg(self) -> Array:
        """(3,) float64 rotation vector, degrees."""
        return np.asarray(np.degrees(log_map(self.rotation[None])[0]))

    @property
    def right_down_deg(self) -> tuple[float, float]:
        """Angles of the ray from the flange's z towards its x and towards its y, degrees."""
        x, y, z = self.sight
        return float(np.degrees(np.arctan2(x, z))), float(np.degrees(np.arctan2(y, z)))

    def angle_to(self, normal: Array, sigma_rad: float) -> tuple[float, float]:
        """Return the angle of the ray to a (3,) direction of the flange's frame, and its expanded uncertainty, degrees.

        The angle is atan2(|s x n|, s . n) of ray s and direction n. One near zero has no single gradient, so the larger
        uncertainty of the ray's two directions is taken.
        """
        unit = np.asarray(normal, np.float64) / np.linalg.norm(normal)
        angle = float(np.arctan2(np.linalg.norm(skew(self.sight[None])[0] @ unit), self.sight @ unit))
        own = float(np.linalg.eigvalsh(self.sight_covariance)[-1])
        sigmas = np.degrees(np.sqrt(np.diag(self.sight_covariance)))
        factor = float((self.sight_expanded_deg / sigmas).max())
        return float(np.degrees(angle)), float(np.degrees(factor * np.hypot(np.sqrt(own), sigma_rad)))

    def to_dict(self) -> dict[str, Any]:
        """Return the content as JSON holds it."""
        return {
            "camera_from_flange": self.rotation.tolist(),
            "vector_deg": self.vector_deg.tolist(),
            "expanded_deg": self.expanded_deg.tolist(),
            "covariance_rad2": self.covariance.tolist(),
            "sight": self.sight.tolist(),
            "right_down_deg": list(self.right_down_deg),
            "sight_expanded_deg": self.sight_expanded_deg.tolist(),
            "sight_covariance_rad2": self.sight_covariance.tolist(),
        }

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Boresight:
        """Read what `to_dict` wrote."""
        names = ("camera_from_flange", "covariance_rad2", "expanded_deg", "sight", "sight_covariance_rad2")
        return cls(*(np.array(content[name], np.float64) for name in (*names, "sight_expanded_deg")))


@dataclass(frozen=True)
class RotationErrors(ReadOnlyArrays):
    """A linear form at the posterior's mean: the error of each rotation vector, on the camera's side."""

    names: tuple[str, ...]  # The S shared unknowns
    means: Array  # (S,)
    covariance: Array  # (S, S)
    prior: Array  # (S, S) information of what was known before the views
    prior_pull: Array  # (S,) that information times (what was known - means)
    by_shared: Array  # (3 m, S) rad for a unit of each
    own: Array  # (3 m, 3 m) covariance of what each view adds, rad^2

    @property
    def joint_covariance(self) -> Array:
        """(3 m, 3 m) covariance of all rotation vectors, rad^2."""
        whole = self.by_shared @ self.covariance @ self.by_shared.T + self.own
        return np.asarray(0.5 * (whole + whole.T))


@dataclass(frozen=True)
class RegionCheck:
    """The worst place of one part of the sensor."""

    name: str
    at_px: tuple[float, float]
    offset_px: float  # Length of the change of the projection
    expanded_px: float  # Its expanded uncertainty, for the whole sensor at once

    @property
    def normalised(self) -> float:
        """The E_n number: above 1, the change is larger than its expanded uncertainty."""
        return self.offset_px / self.expanded_px


@dataclass(frozen=True)
class CameraCheck:
    """What a check of a camera found."""

    regions: tuple[RegionCheck, ...]  # Three rows of three
    rms_px: float  # Root mean square of the change over the sensor
    coverage_factor: float  # k of the expanded uncertainties, for the whole sensor at once
    # Share of the squared change that each kind explains alone: ``scale``, ``principal point``, ``lens``.
    shares: Mapping[str, float]

    @property
    def worst(self) -> RegionCheck:
        """The region with the largest E_n."""
        return max(self.regions, key=lambda region: region.normalised)

    @property
    def right(self) -> bool:
        """Whether the stated camera is right within its expanded uncertainty everywhere on the sensor."""
        return self.worst.normalised <= 1.0

    @property
    def cause(self) -> str:
        """The one kind of change that explains the difference; empty if it is right, or if no kind does alone."""
        if self.right:
            return ""
        name, share = max(self.shares.items(), key=lambda item: item[1])
        return name if share >= _EXPLAINS else ""

    def to_dict(self) -> dict[str, Any]:
        """Return the content as JSON holds it."""
        regions = [{**asdict(region), "normalised": region.normalised} for region in self.regions]
        return {"right": self.right, "cause": self.cause or None, **asdict(self), "regions": regions}
