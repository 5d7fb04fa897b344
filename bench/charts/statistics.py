"""Drift of a parameter, and the test whether it is more than chance: numbers in, numbers out.

Drift: a random-effects meta-regression, a line in time and temperature, an effect of each run (standard deviation tau),
and the error that the run states.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

from bench.record.summaries import EwmaData, LimitsData, TestedSlope
from calib.arrays import Array

D2 = 2.0 / math.sqrt(math.pi)
"""Mean of the range of two normal values, in standard deviations: 1.128 in the published tables."""
E2 = 3.0 / D2
"""Distance of the limits of individuals from the centre, in mean moving ranges: 2.660."""
EWMA_WEIGHT = 0.2
"""Weight of the newest value: 0.05 to 0.25 work well; a smaller one finds smaller shifts, later (Montgomery, section
9.2)."""
EWMA_LIMIT = 2.86
"""With `EWMA_WEIGHT`, one false alarm in 370 runs on average, as with three sigma (Crowder, J. Quality Technology 21
(1989) 155)."""
SHEWHART_CHANCE = 0.0027
"""Chance of a run in control to lie beyond three sigma."""
LEVEL = 0.05
"""Chance of one false drift or more on a whole page, as is usual for tests."""
LEAST_RUNS = 5
"""Fewest runs for the test of one slope: its two unknowns leave three degrees of freedom."""
LEAST_RUNS_JOINT = 8
"""Fewest runs for the test of both slopes together: their three unknowns leave five degrees of freedom."""
LEAST_RANGE_C = 0.2
"""Smallest range of temperatures for which a slope is tested, degrees Celsius: within it, a thermometer itself may
err."""
INSEPARABLE = 0.9
"""From this correlation of time and temperature on, their slopes are tested one at a time: together, their
uncertainties would be 2.3 times as large."""


def individuals(values: Sequence[float], baseline: int | None = None) -> LimitsData:
    """Compute the chart of individuals of at least two finite values in the order of time.

    Montgomery, Introduction to Statistical Quality Control, section 6.4; ISO 7870-2. The standard deviation comes from
    the moving ranges of two, so a shift or a slow drift of the mean hardly widens the limits. They come from the first
    ``baseline`` values; all where None.

    >>> chart = individuals([10.0, 12.0, 11.0, 13.0])
    >>> [round(chart[name], 4) for name in ("centre", "sigma", "upper")]
    [11.5, 1.477, 15.9311]
    """
    x = np.asarray(values, float)
    first = len(x) if baseline is None else max(2, min(baseline, len(x)))
    ranges = np.abs(np.diff(x))
    centre, range_mean = float(x[:first].mean()), float(ranges[: first - 1].mean())
    lower, upper = centre - E2 * range_mean, centre + E2 * range_mean
    slack = 1e-12 * max(abs(centre), range_mean)
    return {
        "lower": lower,
        "upper": upper,
        "centre": centre,
        "sigma": range_mean / D2,
        "beyond": _places((x < lower - slack) | (x > upper + slack)),
        "baseline": first,
    }


def ewma(
    values: Sequence[float],
    centre: float,
    sigma: float,
    *,
    weight: float = EWMA_WEIGHT,
    limit: float = EWMA_LIMIT,
) -> EwmaData:
    """Compute the chart of the exponentially weighted moving average. It shows small lasting shifts.

    Roberts, Technometrics 1 (1959) 239; Montgomery, section 9.2; ISO 7870-6. The average begins at the centre. The
    limits widen from the first values on, as its variance does. Centre and short-term standard deviation come from
    `individuals`; weight and limit: see `EwmaData`.

    >>> chart = ewma([10.0, 11.0], 10.0, 1.0, weight=0.1, limit=2.7)
    >>> chart["values"], np.round(chart["upper"], 3).tolist()
    ([10.0, 10.1], [10.27, 10.363])
    """
    x = np.asarray(values, float)
    averages, now = np.empty(len(x)), centre
    for place, value in enumerate(x):
        now = weight * value + (1.0 - weight) * now
        averages[place] = now
    half = limit * ewma_sigma(np.arange(1.0, len(x) + 1.0), sigma, weight)
    slack = 1e-12 * max(abs(centre), sigma)
    beyond = _places(np.abs(averages - centre) > half + slack)
    return {
        "lambda": weight,
        "limit": limit,
        "values": averages.tolist(),
        "lower": (centre - half).tolist(),
        "upper": (centre + half).tolist(),
        "beyond": beyond,
    }


def ewma_sigma(number: Array, sigma: float, weight: float) -> Array:
    """Return the standard deviation of the average, (N,), after numbers of values, (N,) (Montgomery, section 9.2)."""
    shares = weight / (2.0 - weight) * (1.0 - (1.0 - weight) ** (2.0 * np.asarray(number, float)))
    return np.asarray(sigma * np.sqrt(shares))


def _places(condition: NDArray[np.bool_]) -> tuple[int, ...]:
    return tuple(int(place) for place in np.flatnonzero(condition))


@dataclass(frozen=True)
class Drift:
    """The drift of one parameter."""

    per_day: TestedSlope | None  # Slope over the time; None if it cannot be tested
    per_c: TestedSlope | None  # Slope over the temperature; None if it cannot be tested
    # Whether both slopes were fitted together, so that each holds with the other quantity unchanged.
    joint: bool
    # False if time and temperature changed together, so that the slopes cannot be told apart.
    separable: bool
    # tau, the standard deviation between runs that their stated uncertainties do not explain; None with fewer
    # than `LEAST_RUNS` runs.
    between_runs: float | None
    scatter: float | None


def find_drift(
    days: Sequence[float],
    degrees_c: Sequence[float | None],
    values: Sequence[float],
    sigmas: Sequence[float],
) -> Drift:
    """Fit the drift of a parameter; return the slopes with their tests. Unknown temperatures are None."""
    t, y, u = (np.asarray(column, float) for column in (days, values, sigmas))
    warm = np.array([math.nan if c is None else c for c in degrees_c], float)
    known = np.isfinite(warm)
    has_time = len(t) >= LEAST_RUNS and float(np.ptp(t)) > 0.0
    has_warm = int(known.sum()) >= LEAST_RUNS and float(np.ptp(warm[known])) >= LEAST_RANGE_C
    separable = True
    if has_time and has_warm:
        separable = abs(float(np.corrcoef(t[known], warm[known])[0, 1])) < INSEPARABLE
        if separable and known.all() and len(t) >= LEAST_RUNS_JOINT:
            (per_day, per_c), tau, scatter = _fit(np.column_stack([t, warm]), y, u)
            return Drift(per_day, per_c, True, True, tau, scatter)
    # Without a line in time, the fit gives the scatter alone.
    of_time, tau, scatter = _fit(t[:, None] if has_time else np.empty((len(y), 0)), y, u)
    of_warm = _fit(warm[known, None], y[known], u[known])[0] if has_warm else []
    day, warmth = (next(iter(slopes), None) for slopes in (of_time, of_warm))
    return Drift(day, warmth, False, separable, tau, scatter)


def _fit(x: Array, y: Array, u: Array) -> tuple[list[TestedSlope], float | None, float | None]:
    """Fit a line in some quantities by weighted least squares with an effect of each run.

    The effect's variance tau^2 solves sum w r^2 = n - p, w = 1 / (u^2 + tau^2) (Paule and Mandel, J. Res. NBS 87 (1982)
    377; with covariates: DerSimonian and Kacker, Contemp. Clin. Trials 28 (2007) 105). The covariance is multiplied by
    sum w r^2 / (n - p), with Student's t of n - p (Knapp and Hartung, Statist. Med. 22 (2003) 2693); below 1 if an
    error is common to all.
    """
    n, p = len(y), x.shape[1] + 1
    if n < max(LEAST_RUNS, p + 1):
        return [], None, None
    middle, scale = x.mean(axis=0), np.ptp(x, axis=0)
    design = np.column_stack([np.ones(n), (x - middle) / scale])
    size = float(np.median(u))
    y, u = (y - y.mean()) / size, u / size

    def solve(tau2: float) -> tuple[Array, Array, float]:
        w = 1.0 / (u**2 + tau2)
        normal = design.T @ (w[:, None] * design)
        estimates = np.linalg.solve(normal, design.T @ (w * y))
        return estimates, normal, float(np.sum(w * (y - design @ estimates) ** 2))

    chi2 = solve(0.0)[2]
    tau2 = 0.0
    if chi2 > n - p:
        high = float(np.sum((y - y.mean()) ** 2)) + 1.0
        tau2 = float(optimize.brentq(lambda v: solve(v)[2] - (n - p), 0.0, high, xtol=1e-12 * high))
    estimates, normal, rest = solve(tau2)
    covariance = rest / (n - p) * np.linalg.inv(normal)
    slopes = []
    for place in range(1, p):
        value, sigma = float(estimates[place]), math.sqrt(float(covariance[place, place]))
        chance = float(2.0 * stats.t.sf(abs(value) / sigma, n - p)) if sigma > 0 else float(value == 0)
        unit = size / float(scale[place - 1])
        slope: TestedSlope = {
            "value": value * unit,
            "sigma": sigma * unit,
            "p": chance,
            "degrees_of_freedom": n - p,
            "runs": n,
            "expanded": float(stats.t.ppf(0.975, n - p)) * (sigma * unit),
        }
        slopes.append(slope)
    return slopes, math.sqrt(tau2) * size, math.sqrt(chi2 / (n - p))


def holm(chances: Sequence[float]) -> list[float]:
    """Adjust the chances of several tests, so that one false alarm or more has at most the level of one test.

    Holm, Scand. J. Statist. 6 (1979) 65. The order stays.

    >>> [round(p, 3) for p in holm([0.01, 0.04, 0.03])]
    [0.03, 0.06, 0.06]
    """
    order = sorted(range(len(chances)), key=lambda place: chances[place])
    adjusted, least = [0.0] * len(chances), 0.0
    for rank, place in enumerate(order):
        least = max(least, min(1.0, (len(chances) - rank) * chances[place]))
        adjusted[place] = least
    return adjusted
