"""Agreement of several runs: whether they differ by more than their own uncertainty.

What all runs share (certificate, glass, print) does not appear in their differences, and no number of runs lowers it:
the mean carries it in full.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from bench.base.errors import UsageError
from bench.record.coverage import Estimate
from bench.record.run_facts import IndexedRun
from bench.record.summaries import AgreedData

_LEAST_OWN = 1e-6
"""A run has at least this share of its variance for itself, so that a difference can be judged."""
_LOWEST_PERCENT = -2.326
"""The 1 % quantile of the normal distribution."""


def compare_runs(runs: Sequence[IndexedRun]) -> list[AgreedData]:
    """Compare every parameter that all runs estimated: two or more runs, of one camera and one model."""
    if len(runs) < 2:
        raise UsageError(
            f"Cannot compare {len(runs)} runs with a result: at least two are needed.",
            remedy="Select more runs by FOLDER, --serial or --since.",
        )
    differing = (
        ("cameras", {r.camera for r in runs}),
        ("models", {str(r.model) for r in runs}),
        ("kinds", {r.kind for r in runs}),
    )
    for what, kinds in differing:
        if len(kinds) > 1:
            raise UsageError(
                f"Cannot compare runs of different {what}: {', '.join(sorted(kinds))}.",
                remedy="Select runs of one of them by FOLDER, --serial or --since.",
            )
    return agreements(runs)


def agreements(runs: Sequence[IndexedRun]) -> list[AgreedData]:
    """Return the agreement of every parameter that all runs estimated; none with fewer than two runs."""
    if len(runs) < 2:
        return []
    shared = [
        name
        for name in runs[0].parameters
        if all(name in r.parameters and r.parameters[name].sigma > 0 for r in runs)
    ]
    return [agreement(name, [run.parameters[name] for run in runs]) for name in shared]


def agreement(name: str, runs: Sequence[Estimate]) -> AgreedData:
    """Compute the weighted mean and the Birge ratio of several values of one parameter.

    Birge ratio: Birge, Phys. Rev. 40 (1932) 207, with the part of each uncertainty that the runs do not share. Below 1,
    the rest of this part repeated itself in every run, and the mean carries it like the shared part. The deviations are
    normalised as the degrees of equivalence of a key comparison: Cox, Metrologia 39 (2002) 589, procedure A.

    runs: At least two values, each with its standard uncertainty greater than 0.

    >>> alone = [Estimate(9.0, 1.0), Estimate(11.0, 1.0), Estimate(10.0, 1.0)]
    >>> agreed = agreement("fx", alone)
    >>> agreed["mean"], round(agreed["sigma"], 4), round(agreed["birge"], 4)
    (10.0, 0.5774, 1.0)
    >>> [round(d, 4) for d in agreed["deviations"]]
    [-1.2247, 1.2247, 0.0]
    >>> shared = [run._replace(sigma=1.25, shared=0.75) for run in alone]
    >>> round(agreement("fx", shared)["sigma"] ** 2, 4) == round(1.0 / 3.0 + 0.75**2, 4)
    True
    """
    weights = [1.0 / run.sigma**2 for run in runs]
    total = math.fsum(weights)
    weights = [weight / total for weight in weights]
    mean = math.fsum(w * run.value for w, run in zip(weights, runs, strict=True))
    own = [max(run.sigma**2 - run.shared**2, _LEAST_OWN * run.sigma**2) for run in runs]
    chi2 = math.fsum((run.value - mean) ** 2 / variance for run, variance in zip(runs, own, strict=True))
    birge = math.sqrt(chi2 / (len(runs) - 1))
    repeated = max(0.0, 1.0 - birge**2)
    averaged = math.fsum(w**2 * variance for w, variance in zip(weights, own, strict=True))
    carried = math.fsum(
        w * math.sqrt(run.shared**2 + repeated * variance)
        for w, run, variance in zip(weights, runs, own, strict=True)
    )
    deviations = [
        (run.value - mean) / math.sqrt(averaged + (1.0 - 2.0 * w) * variance)
        for w, run, variance in zip(weights, runs, own, strict=True)
    ]
    sigma = math.sqrt((1.0 - repeated) * averaged + carried**2)
    k = max(run.k for run in runs)
    return {
        "name": name,
        "mean": mean,
        "sigma": sigma,
        "coverage_factor": k,
        "expanded": k * sigma,
        "birge": birge,
        "repeats": _repeats(birge, len(runs) - 1),
        "deviations": deviations,
    }


def _repeats(birge: float, freedom: int) -> bool:
    """Return whether runs agree far better than their uncertainties say: their errors are then the same in each.

    1 % of independent runs do: chi^2 quantile by Wilson and Hilferty, PNAS 17 (1931) 684.
    """
    step = 2.0 / (9.0 * freedom)
    return birge**2 < max(0.0, 1.0 - step + _LOWEST_PERCENT * math.sqrt(step)) ** 3


def by_camera(runs: Iterable[IndexedRun]) -> dict[tuple[str, str], list[IndexedRun]]:
    """Group the runs that have a calibration by serial number and model, oldest first."""
    runs_of_camera: dict[tuple[str, str], list[IndexedRun]] = {}
    for run in sorted(runs, key=lambda run: (run.begun_utc, run.folder)):
        if run.parameters:
            runs_of_camera.setdefault((run.camera, str(run.model)), []).append(run)
    return dict(sorted(runs_of_camera.items()))
