"""The estimates of a calibration with their expanded uncertainties, each with its own coverage factor."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, NamedTuple, TypedDict

from bench.record.events import Solved

if TYPE_CHECKING:
    from bench.record.results import CameraData

USUAL_COVERAGE_FACTOR = 2.0
"""The k of results of earlier versions, which do not state one."""
_MOST_FACTORS = 3
"""So many different k are listed; of more, the least and the most."""

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


class EstimateData(TypedDict):
    """A parameter of one run as JSON carries it."""

    value: float
    sigma: float
    coverage_factor: float
    expanded: float


def coverage_factor(stated: CameraData | Solved, name: str = "") -> float:
    """Return k (2 if none is stated): U = k u has a coverage probability of about 95 % (JCGM 100, 6.2, annex G).

    ``name`` is a value that may have a k of its own, empty for the common one.
    """
    if own := (stated.get("coverage_factors") or {}).get(name):
        return float(own)
    return float(stated.get("coverage_factor") or USUAL_COVERAGE_FACTOR)


def factors_text(factors: Iterable[float]) -> str:
    """Return the coverage factors of several values as text.

    >>> factors_text([2.2215, 2.2215]), factors_text([2.2215, 2.0]), factors_text([2.02, 2.0, 2.21, 2.05])
    ('k = 2.22', 'k = 2.22, 2', 'k = 2 to 2.21')
    """
    texts = list(dict.fromkeys(f"{k:.3g}" for k in factors))
    if len(texts) > _MOST_FACTORS:
        texts = [f"{min(texts, key=float)} to {max(texts, key=float)}"]
    return "k = " + ", ".join(texts)


def estimates(solved: Solved) -> dict[str, Estimate]:
    """Return each parameter of the journal's line ``solved`` by name; a number that it does not have is NaN."""
    sigma, shared = solved.get("sigma", {}), solved.get("shared", {})
    return {
        name: Estimate(
            _number(value), _number(sigma[name]), coverage_factor(solved, name), float(shared.get(name, 0.0))
        )
        for name, value in solved.get("values", {}).items()
        if name in sigma
    }


def parameters_data(parameters: Mapping[str, Estimate]) -> dict[str, EstimateData]:
    """Return parameters as JSON carries them, by name."""
    return {
        name: {
            "value": parameter.value,
            "sigma": parameter.sigma,
            "coverage_factor": parameter.k,
            "expanded": parameter.expanded,
        }
        for name, parameter in parameters.items()
    }


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else math.nan
