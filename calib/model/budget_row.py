"""A row of an uncertainty budget, as data for results and reports."""

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
