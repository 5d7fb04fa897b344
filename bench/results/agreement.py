"""Agreement of several runs of one camera: each parameter's values against their weighted mean.

Uncertainties of different runs are treated as independent. Errors that all runs have in common (from the collimator,
from the target's pitch) do not appear in their differences.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from bench.base.errors import UsageError
from bench.records.run_index import IndexedRun


@dataclass(frozen=True)
class Agreement:
    """One parameter in several runs."""

    name: str
    # mean, sigma: Mean weighted by 1 / sigma^2, and its standard uncertainty, in the parameter's unit.
    mean: float
    sigma: float
    # Birge ratio sqrt(chi^2 / (n - 1)). It is about 1 if the runs scatter as their uncertainties predict, and
    # larger if the camera or the bench changed between runs.
    birge: float
    # For each run, its difference from the mean divided by the standard uncertainty of this difference,
    # sqrt(sigma_i^2 - sigma^2).
    deviations: Sequence[float]

    def to_dict(self) -> dict[str, Any]:
        """Return the content as JSON holds it.

        Returns: ``name mean sigma birge deviations``.
        """
        return {
            "name": self.name,
            "mean": self.mean,
            "sigma": self.sigma,
            "birge": self.birge,
            "deviations": list(self.deviations),
        }


def compare_runs(runs: Sequence[IndexedRun]) -> list[Agreement]:
    """Compare every parameter that all runs have estimated.

    runs: At least two runs with a calibration, of one camera and one model; all of them measured, simulated
      or rehearsed.
    Returns: One for each parameter, in the order of the first run.
    Raises UsageError: When there are fewer than two runs, or the runs cannot be compared.
    """
    if len(runs) < 2:
        raise UsageError(
            f"Cannot compare {len(runs)} runs with a result: at least two are needed.",
            remedy="Select more runs by FOLDER, --serial or --since.",
        )
    differing = (
        ("cameras", {r.camera for r in runs}),
        ("models", {str(r.model) for r in runs}),
        ("kinds", {_kind(r) for r in runs}),
    )
    for what, kinds in differing:
        if len(kinds) > 1:
            raise UsageError(
                f"Cannot compare runs of different {what}: {', '.join(sorted(kinds))}.",
                remedy="Select runs of one of them by FOLDER, --serial or --since.",
            )
    shared = [
        name for name in runs[0].parameters if all(run.parameters.get(name, (0, 0))[1] > 0 for run in runs)
    ]
    return [agreement(name, [run.parameters[name] for run in runs]) for name in shared]


def _kind(run: IndexedRun) -> str:
    return "rehearsed" if run.rehearsal else "simulated" if run.simulated else "measured"


def agreement(name: str, values: Sequence[tuple[float, float]]) -> Agreement:
    """Compute the weighted mean and the Birge ratio of several values of one parameter.

    Weighted mean of independent values and its uncertainty by least squares; Birge ratio: Birge, Phys. Rev. 40 (1932)
    207. The deviations are normalised as the degrees of equivalence of a key comparison: Cox, Metrologia 39 (2002) 589,
    procedure A.

    values: At least two values, each with its standard uncertainty greater than 0.
    Returns: Mean, its uncertainty, Birge ratio and normalised deviations.

    Examples
    --------
    >>> found = agreement("fx", [(10.0, 1.0), (12.0, 1.0)])
    >>> found.mean, round(found.sigma, 4), round(found.birge, 4)
    (11.0, 0.7071, 1.4142)
    >>> [round(d, 4) for d in found.deviations]
    [-1.4142, 1.4142]
    """
    weights = [1.0 / sigma**2 for _, sigma in values]
    total = math.fsum(weights)
    mean = math.fsum(w * value for w, (value, _) in zip(weights, values, strict=True)) / total
    chi2 = math.fsum(w * (value - mean) ** 2 for w, (value, _) in zip(weights, values, strict=True))
    deviations = [(value - mean) / math.sqrt(sigma**2 - 1.0 / total) for value, sigma in values]
    return Agreement(name, mean, math.sqrt(1.0 / total), math.sqrt(chi2 / (len(values) - 1)), deviations)
