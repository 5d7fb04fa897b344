"""What a run says of one parameter: its value, its uncertainty with the k of this value, and what other runs share.

The same numbers for terminal, pages, mail and tables: U of a value is its own coverage factor times its sigma.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

USUAL_COVERAGE_FACTOR = 2.0
"""The k of results of earlier versions, which do not state one."""

REPEATS_TEXT = (
    "the runs differ much less than their uncertainties (Birge ratio far below 1). "
    "What limits a run repeats in the next: the mean of many runs is not better than one run."
)


class Estimate(NamedTuple):
    """A parameter of one run. ``sigma`` and ``shared`` are standard uncertainties."""

    value: float
    sigma: float
    k: float = USUAL_COVERAGE_FACTOR
    # The part of sigma that is the same in all runs on this bench: certificate, glass, print. Other runs do not lower
    # it. 0 in journals of an earlier version.
    shared: float = 0.0

    @property
    def expanded(self) -> float:
        """Expanded uncertainty U = k u (JCGM 100, 6.2.1)."""
        return self.k * self.sigma


def coverage_factor(stated: Mapping[str, Any], name: str = "") -> float:
    """Return the coverage factor k: U = k u has a coverage probability of about 95 % (JCGM 100, 6.2 and annex G).

    stated: ``calibration`` or ``planar`` of results.json, or the journal's line ``solved``.
    name: A value that may have a k of its own; empty for the common one.
    Returns: 2 if none is stated.
    """
    if own := (stated.get("coverage_factors") or {}).get(name):
        return float(own)
    return float(stated.get("coverage_factor") or USUAL_COVERAGE_FACTOR)


def factors_text(factors: Iterable[float]) -> str:
    """Return the coverage factors of several values as text.

    Examples
    --------
    >>> factors_text([2.2215, 2.2215]), factors_text([2.2215, 2.0])
    ('k = 2.22', 'k = 2.22, 2')
    """
    return "k = " + ", ".join(dict.fromkeys(f"{k:.3g}" for k in factors))


def estimates(solved: Mapping[str, Any]) -> dict[str, Estimate]:
    """Return each parameter that a run has estimated.

    solved: The journal's line ``solved``; empty without a calibration.
    Returns: By name; a number that the journal does not have is NaN.
    """
    sigma, shared = solved.get("sigma", {}), solved.get("shared", {})
    return {
        name: Estimate(
            _number(value), _number(sigma[name]), coverage_factor(solved, name), float(shared.get(name, 0.0))
        )
        for name, value in solved.get("values", {}).items()
        if name in sigma
    }


def parameters_data(parameters: Mapping[str, Estimate]) -> dict[str, dict[str, float]]:
    """Return parameters as JSON carries them: ``value sigma coverage_factor expanded`` by name."""
    return {
        name: {"value": one.value, "sigma": one.sigma, "coverage_factor": one.k, "expanded": one.expanded}
        for name, one in parameters.items()
    }


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else math.nan
