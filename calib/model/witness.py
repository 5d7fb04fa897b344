"""What statements say against what all other knowledge says: data for results and reports."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


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
