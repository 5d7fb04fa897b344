"""Parts of a result as data for reports: budget rows, statements and their witnesses, amplitudes, the gimbal."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

#: The quantities of a row: the pinhole parameters, and the point of the sensor with the largest projection uncertainty.
WORST_CORNER = "worst_corner"
ROW_QUANTITIES = ("fx", "fy", "cx", "cy", WORST_CORNER)

#: Names of the rows that an adjustment itself gives.
STARS, READINGS = "stars", "readings of the gimbal"
POSE_FIELDS, COMMON_FIELD = "disagreement of the views", "errors that all views share"
TURN_FIELDS, AMPLITUDES = "errors that follow the turn", "sizes of the errors"
PUPILS = "places of the pupil"
PASSPORT, PRIORS, LENS = "passport of the collimator", "known beforehand", "expected lens"
PARALLAX, UNBOUNDED_PARALLAX = "parallax", "parallax, not bounded"
GIMBAL_SCALE, GIMBAL_AXES = "scale and eccentricity of the gimbal", "mounting and axes of the gimbal"


@dataclass(frozen=True)
class BudgetRow:
    """A source of uncertainty and its contribution (JCGM 100:2008, section 7.2.7)."""

    name: str
    # ``A``: evaluated from the views of this calibration. ``B``: evaluated by other means.
    type: Literal["A", "B"]
    source: str  # Where the value comes from
    # Distribution of the value; ``normal``, ``rectangular``, ``triangular`` or ``u-shaped``.
    distribution: str = "normal"
    # value, unit, divisor: Stated value, its unit, and the value over its standard uncertainty; None, an
    # empty text and None if the row is not about one value.
    value: float | None = None
    unit: str = ""
    divisor: float | None = None
    degrees_of_freedom: float | None = None  # Degrees of freedom; None if they are infinite
    # For each quantity the change, px, by one unit of the value; empty if the row is not about one value.
    # That of the worst corner, and all of a wavefront, have no sign.
    sensitivity: Mapping[str, float] = field(default_factory=dict)
    # For each quantity the standard uncertainty that the source contributes, px.
    contribution: Mapping[str, float] = field(default_factory=dict)
    # For each quantity the share of the source in the combined variance.
    share: Mapping[str, float] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Return the row as plain numbers and names, ready for JSON."""
        return {**asdict(self)}


@dataclass(frozen=True)
class Witness:
    """A statement, and what the views and all other statements say of the same quantity."""

    name: str  # What is stated, in words
    source: str  # Who states it
    unit: str  # Unit of the numbers; empty for shares and for a joint statement
    # stated, sigma: Stated value and its standard uncertainty; None for a joint statement of several values.
    stated: float | None
    sigma: float | None
    # expected, expected_sigma: The same by all others; None for a joint statement.
    expected: float | None
    expected_sigma: float | None
    # Stated minus expected over the sigma of that difference: 2 is unusual, 3 a contradiction. For a joint
    # statement the root mean square, without a sign.
    innovation: float
    # Probability that the statement is at fault: wrong, or its sigma several times too small.
    fault_probability: float

    def to_dict(self) -> dict[str, Any]:
        """Return the witness as plain numbers and names, ready for JSON."""
        return asdict(self)


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

    def to_dict(self) -> dict[str, Any]:
        """Return the amplitude as plain numbers and names, ready for JSON."""
        return asdict(self)


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
