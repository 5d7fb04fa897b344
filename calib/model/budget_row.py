"""A row of an uncertainty budget, as data for results and reports."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

#: The quantities of a row: the pinhole parameters, and the point of the sensor with the largest projection uncertainty.
WORST_CORNER = "worst_corner"
ROW_QUANTITIES = ("fx", "fy", "cx", "cy", WORST_CORNER)


@dataclass(frozen=True)
class BudgetRow:
    """A source of uncertainty and its contribution (JCGM 100:2008, section 7.2.7).

    Attributes
    ----------
    name
        Name of the source of uncertainty.
    type
        ``A``: evaluated from the views of this calibration. ``B``: evaluated by other means.
    source
        Where the value comes from.
    distribution
        Distribution of the value; ``normal``, ``rectangular``, ``triangular`` or ``u-shaped``.
    value, unit, divisor
        Stated value, its unit, and the value over its standard uncertainty; None, an empty text and None if the row is
        not about one value.
    degrees_of_freedom
        Degrees of freedom; None if they are infinite.
    sensitivity
        For each quantity the change, px, by one unit of the value; empty if the row is not about one value. That of the
        worst corner, and all of a wavefront, have no sign.
    contribution
        For each quantity the standard uncertainty that the source contributes, px.
    share
        For each quantity the share of the source in the combined variance.
    """

    name: str
    type: Literal["A", "B"]
    source: str
    distribution: str = "normal"
    value: float | None = None
    unit: str = ""
    divisor: float | None = None
    degrees_of_freedom: float | None = None
    sensitivity: Mapping[str, float] = field(default_factory=dict)
    contribution: Mapping[str, float] = field(default_factory=dict)
    share: Mapping[str, float] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Return the row as plain numbers and names, ready for JSON.

        Returns
        -------
        dict of str to Any
            All attributes by name.
        """
        return {**asdict(self)}
