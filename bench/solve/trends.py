"""Trends of a parameter over the runs of a batch: its mean, its scatter, its change with time and with temperature.

A slope's uncertainty grows if the points scatter more than theirs predict. Runs are treated as independent: what they
share (collimator, pitch of the target) does not appear in their differences.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from bench.base.errors import UsageError
from bench.record.run_facts import Estimate, IndexedRun
from bench.record.summaries import SlopeData, TrendData

# What all runs share (certificate, glass, print) does not appear in their differences, and no number of
# runs lowers it: the mean carries it in full.

_LEAST_OWN = 1e-6
"""A run has at least this share of its variance for itself, so that a difference can be judged."""
_LOWEST_PERCENT = -2.326
"""The 1 % quantile of the normal distribution."""


@dataclass(frozen=True)
class Agreement:
    """One parameter in several runs."""

    name: str
    # mean, sigma: Mean weighted by 1 / sigma^2, and its standard uncertainty, in the parameter's unit.
    mean: float
    sigma: float
    k: float  # Coverage factor: the largest of the runs
    # Birge ratio sqrt(chi^2 / (n - 1)) with what is not shared. It is about 1 if the runs scatter as their
    # uncertainties predict, larger if the camera or the bench changed between runs, and smaller if what limits a run
    # repeats in the next.
    birge: float
    # For each run, its difference from the mean divided by the standard uncertainty of this difference.
    deviations: Sequence[float]

    @property
    def expanded(self) -> float:
        """Expanded uncertainty of the mean."""
        return self.k * self.sigma

    def to_dict(self) -> dict[str, Any]:
        """Return ``name mean sigma coverage_factor expanded birge deviations`` as JSON holds them."""
        return {
            "name": self.name,
            "mean": self.mean,
            "sigma": self.sigma,
            "coverage_factor": self.k,
            "expanded": self.expanded,
            "birge": self.birge,
            "deviations": list(self.deviations),
        }


def compare_runs(runs: Sequence[IndexedRun]) -> list[Agreement]:
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
    shared = [
        name
        for name in runs[0].parameters
        if all(name in r.parameters and r.parameters[name].sigma > 0 for r in runs)
    ]
    return [agreement(name, [run.parameters[name] for run in runs]) for name in shared]


def agreement(name: str, runs: Sequence[Estimate]) -> Agreement:
    """Compute the weighted mean and the Birge ratio of several values of one parameter.

    Birge ratio: Birge, Phys. Rev. 40 (1932) 207, with the part of each uncertainty that the runs do not share. Below 1,
    the rest of this part repeated itself in every run, and the mean carries it like the shared part. The deviations are
    normalised as the degrees of equivalence of a key comparison: Cox, Metrologia 39 (2002) 589, procedure A.

    runs: At least two values, each with its standard uncertainty greater than 0.

    >>> alone = [Estimate(9.0, 1.0), Estimate(11.0, 1.0), Estimate(10.0, 1.0)]
    >>> found = agreement("fx", alone)
    >>> found.mean, round(found.sigma, 4), round(found.birge, 4)
    (10.0, 0.5774, 1.0)
    >>> [round(d, 4) for d in found.deviations]
    [-1.2247, 1.2247, 0.0]
    >>> shared = [one._replace(sigma=1.25, shared=0.75) for one in alone]
    >>> round(agreement("fx", shared).sigma ** 2, 4) == round(1.0 / 3.0 + 0.75**2, 4)
    True
    """
    weights = [1.0 / one.sigma**2 for one in runs]
    total = math.fsum(weights)
    weights = [weight / total for weight in weights]
    mean = math.fsum(w * one.value for w, one in zip(weights, runs, strict=True))
    own = [max(one.sigma**2 - one.shared**2, _LEAST_OWN * one.sigma**2) for one in runs]
    chi2 = math.fsum((one.value - mean) ** 2 / variance for one, variance in zip(runs, own, strict=True))
    birge = math.sqrt(chi2 / (len(runs) - 1))
    repeated = max(0.0, 1.0 - birge**2)
    averaged = math.fsum(w**2 * variance for w, variance in zip(weights, own, strict=True))
    carried = math.fsum(
        w * math.sqrt(one.shared**2 + repeated * variance)
        for w, one, variance in zip(weights, runs, own, strict=True)
    )
    deviations = [
        (one.value - mean) / math.sqrt(averaged + (1.0 - 2.0 * w) * variance)
        for w, one, variance in zip(weights, runs, own, strict=True)
    ]
    sigma = math.sqrt((1.0 - repeated) * averaged + carried**2)
    return Agreement(name, mean, sigma, max(one.k for one in runs), birge, deviations)


def repeats(birge: float, runs: int) -> bool:
    """Return whether the runs agree far better than their uncertainties say: their errors are then the same in each.

    1 % of independent runs do: chi^2 quantile by Wilson and Hilferty, PNAS 17 (1931) 684.
    """
    freedom = runs - 1
    step = 2.0 / (9.0 * freedom)
    return birge**2 < max(0.0, 1.0 - step + _LOWEST_PERCENT * math.sqrt(step)) ** 3


SIGNIFICANT_SIGMAS = 3.5
"""A slope is significant if it exceeds this number of standard uncertainties. By chance, one slope in 2000 does so; a
page shows about twenty."""

LEAST_SPAN_H = 0.5
"""Shortest time span of the runs for which a change per hour is computed, h."""


@dataclass(frozen=True)
class Slope:
    """Change of a parameter, with its standard uncertainty."""

    # value, sigma: Change per hour or per degree Celsius in the parameter's unit, and its standard
    # uncertainty.
    value: float
    sigma: float

    @property
    def significant(self) -> bool:
        """Whether the slope is larger than `SIGNIFICANT_SIGMAS` standard uncertainties."""
        return abs(self.value) > SIGNIFICANT_SIGMAS * self.sigma

    def to_dict(self) -> SlopeData:
        """Return the slope as JSON holds it."""
        return {"value": self.value, "sigma": self.sigma, "seen": self.significant}


@dataclass(frozen=True)
class Trend:
    """One parameter of one camera in several runs."""

    name: str
    agreed: Agreement
    repeats: bool  # As `agreement.repeats` finds
    # per_hour, per_c: Slope against time and against the camera's temperature; None if time or temperature
    # varies too little.
    per_hour: Slope | None
    per_c: Slope | None

    def to_dict(self) -> TrendData:
        """Return the trend as JSON holds it."""
        return {
            "name": self.name,
            "mean": self.agreed.mean,
            "sigma": self.agreed.sigma,
            "coverage_factor": self.agreed.k,
            "expanded": self.agreed.expanded,
            "birge": self.agreed.birge,
            "repeats": self.repeats,
            "per_hour": self.per_hour.to_dict() if self.per_hour else None,
            "per_c": self.per_c.to_dict() if self.per_c else None,
        }


def fit_slope(x: Sequence[float], y: Sequence[float], sigma: Sequence[float]) -> Slope | None:
    """Fit a straight line by least squares, weighted by 1 / sigma^2; None below three points, or if x does not vary.

    Weighted linear regression (Bevington and Robinson, 2003, chapter 6). If the points scatter around the line more
    than their standard uncertainties predict, the slope's uncertainty is multiplied by the Birge ratio of the residuals
    with n - 2 degrees of freedom (Birge, Phys. Rev. 40 (1932) 207).

    >>> found = fit_slope([0, 1, 2, 3], [1.0, 3.0, 5.0, 7.0], [0.1] * 4)
    >>> round(found.value, 6), round(found.sigma, 4), found.significant
    (2.0, 0.0447, True)
    >>> fit_slope([1, 1, 1], [1, 2, 3], [1, 1, 1]) is None
    True
    """
    if len(x) < 3:
        return None
    weights = [1.0 / s**2 for s in sigma]
    total = math.fsum(weights)
    middle_x = math.fsum(w * a for w, a in zip(weights, x, strict=True)) / total
    middle_y = math.fsum(w * b for w, b in zip(weights, y, strict=True)) / total
    spread = math.fsum(w * (a - middle_x) ** 2 for w, a in zip(weights, x, strict=True))
    if spread <= 1e-12 * total * max(1.0, middle_x**2):
        return None
    value = (
        math.fsum(w * (a - middle_x) * (b - middle_y) for w, a, b in zip(weights, x, y, strict=True)) / spread
    )
    chi2 = math.fsum(
        w * (b - middle_y - value * (a - middle_x)) ** 2 for w, a, b in zip(weights, x, y, strict=True)
    )
    return Slope(value, math.sqrt(1.0 / spread) * max(1.0, math.sqrt(chi2 / (len(x) - 2))))


def trends_of(runs: Sequence[IndexedRun]) -> list[Trend]:
    """Compute the trend of every parameter that all runs, oldest first, have; empty with fewer than two."""
    if len(runs) < 2:
        return []
    hours = [hours_after(run.begun_utc, runs[0].begun_utc) for run in runs]
    warm = [run.temperature_c for run in runs]
    known_c = [t for t in warm if t is not None]
    found = []
    for name in runs[0].parameters:
        values = [run.parameters.get(name, Estimate(0.0, 0.0)) for run in runs]
        if not all(one.sigma > 0 for one in values):
            continue
        agreed = agreement(name, values)
        y, sigma = [one.value for one in values], [one.sigma for one in values]
        per_hour = fit_slope(hours, y, sigma) if hours[-1] - hours[0] >= LEAST_SPAN_H else None
        per_c = fit_slope(known_c, y, sigma) if len(known_c) == len(runs) else None
        found.append(Trend(name, agreed, repeats(agreed.birge, len(runs)), per_hour, per_c))
    return found


def hours_after(utc: str, begin_utc: str) -> float:
    """Return the time between two ISO 8601 moments, h."""
    return (datetime.fromisoformat(utc) - datetime.fromisoformat(begin_utc)).total_seconds() / 3600.0


def by_camera(runs: Sequence[IndexedRun]) -> dict[tuple[str, str], list[IndexedRun]]:
    """Group the runs that have a calibration by serial number and model, oldest first."""
    found: dict[tuple[str, str], list[IndexedRun]] = {}
    for run in sorted(runs, key=lambda run: (run.begun_utc, run.folder)):
        if run.parameters:
            found.setdefault((run.camera, str(run.model)), []).append(run)
    return dict(sorted(found.items()))
