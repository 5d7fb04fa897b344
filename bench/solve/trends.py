"""Trends of a parameter over the runs of a batch: its mean, its scatter, its change with time and with temperature.

A slope's uncertainty grows if the points scatter more than theirs predict. Runs are treated as independent: what they
share (collimator, pitch of the target) does not appear in their differences.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

from bench.record.coverage import Estimate
from bench.record.run_facts import IndexedRun
from bench.record.summaries import SlopeData, TrendData
from bench.solve.agreement import Agreement, agreement, repeats

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
