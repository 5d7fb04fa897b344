"""Whether runs of one camera agree: each parameter's values against their weighted mean, in their own uncertainties.

Plain numbers in, plain numbers out. Uncertainties of different runs are taken as independent; what they share (the
collimator, the target's pitch) does not show in their differences.
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
    """One parameter over several runs.

    Attributes
    ----------
    name
        The parameter.
    mean, sigma
        Mean weighted by 1 / sigma^2, and its 1 sigma.
    birge
        Birge ratio sqrt(chi^2 / (n - 1)): 1 where the runs scatter as their uncertainties say, more where the
        camera or the bench changed in between.
    deviations
        For each run its distance from the mean in units of that distance's own sigma, sqrt(sigma_i^2 - sigma^2).
    """

    name: str
    mean: float
    sigma: float
    birge: float
    deviations: Sequence[float]

    def to_dict(self) -> dict[str, Any]:
        """Give it as JSON carries it."""
        return {
            "name": self.name,
            "mean": self.mean,
            "sigma": self.sigma,
            "birge": self.birge,
            "deviations": list(self.deviations),
        }


def compare_runs(runs: Sequence[IndexedRun]) -> list[Agreement]:
    """Compare every parameter that all runs have estimated.

    Parameters
    ----------
    runs
        Two or more with a calibration, of one camera and one model, all measured, all simulated or all rehearsed.

    Raises
    ------
    UsageError
        When they cannot be compared.
    """
    if len(runs) < 2:
        raise UsageError(
            f"{len(runs)} runs with a result were chosen; two or more can be compared.",
            remedy="Choose others, by FOLDER, --serial or --since.",
        )
    differing = (
        ("cameras", {r.camera for r in runs}),
        ("models", {str(r.model) for r in runs}),
        ("kinds", {_kind(r) for r in runs}),
    )
    for what, kinds in differing:
        if len(kinds) > 1:
            raise UsageError(
                f"These are runs of different {what}: {', '.join(sorted(kinds))}.",
                remedy="Choose those of one, by FOLDER, --serial or --since.",
            )
    shared = [
        name for name in runs[0].parameters if all(run.parameters.get(name, (0, 0))[1] > 0 for run in runs)
    ]
    return [agreement(name, [run.parameters[name] for run in runs]) for name in shared]


def _kind(run: IndexedRun) -> str:
    return "rehearsed" if run.rehearsal else "simulated" if run.simulated else "measured"


def agreement(name: str, values: Sequence[tuple[float, float]]) -> Agreement:
    """Compare values of one parameter, each with its 1 sigma, greater than 0.

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
