"""Control charts of one parameter: individuals with moving ranges (Shewhart), and EWMA. Numbers in, limits out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

D2 = 2.0 / math.sqrt(math.pi)
"""Mean of the range of two normal values, in standard deviations: 1.128 in the published tables."""
_D3 = math.sqrt(2.0 - 4.0 / math.pi)
"""Standard deviation of this range: 0.853."""
E2 = 3.0 / D2
"""Distance of the limits of individuals from the centre, in mean moving ranges: 2.660."""
D4 = 1.0 + 3.0 * _D3 / D2
"""Upper limit of moving ranges, in mean moving ranges: 3.267. The lower limit is 0."""
EWMA_WEIGHT = 0.2
EWMA_LIMIT = 2.86
"""With `EWMA_WEIGHT`, one false alarm in 370 runs on average, as with three sigma (Crowder, J. Quality Technology 21
(1989) 155)."""
SHEWHART_CHANCE = 0.0027
"""Chance of a run in control to lie beyond three sigma."""


@dataclass(frozen=True)
class Individuals:
    """Chart of individuals and of moving ranges."""

    # centre, sigma: Mean of the baseline, and its short-term standard deviation: mean moving range over `D2`.
    centre: float
    sigma: float
    lower: float
    upper: float
    beyond: tuple[int, ...]  # Places of the values beyond the limits
    ranges: Array  # |x_i - x_(i-1)|, (N - 1,) float64
    range_mean: float
    range_upper: float
    # Places of the values whose distance from the value before is beyond the limit.
    ranges_beyond: tuple[int, ...]
    baseline: int


@dataclass(frozen=True)
class Ewma:
    """Chart of the exponentially weighted moving average."""

    # weight, limit: Weight of the newest value (lambda), and distance of the limits in standard deviations of
    # the average (L).
    weight: float
    limit: float
    # averages, lower, upper: The average and its control limits at each value, (N,) float64.
    averages: Array
    lower: Array
    upper: Array
    beyond: tuple[int, ...]  # Places at which the average is beyond its limits


def individuals(values: Sequence[float], baseline: int | None = None) -> Individuals:
    """Compute the chart of individuals and moving ranges.

    Montgomery, Introduction to Statistical Quality Control, section 6.4; ISO 7870-2. The standard deviation comes from
    the moving ranges of two, so a shift or a slow drift of the mean hardly widens the limits.

    values: Values in the order of time, at least two, finite.
    baseline: Number of first values from which the limits come; all where None.

    Examples
    --------
    >>> chart = individuals([10.0, 12.0, 11.0, 13.0])
    >>> chart.centre, round(chart.range_mean, 4), round(chart.upper, 3), round(chart.range_upper, 3)
    (11.5, 1.6667, 15.931, 5.444)
    """
    x = np.asarray(values, float)
    first = len(x) if baseline is None else max(2, min(baseline, len(x)))
    ranges = np.abs(np.diff(x))
    centre, range_mean = float(x[:first].mean()), float(ranges[: first - 1].mean())
    lower, upper = centre - E2 * range_mean, centre + E2 * range_mean
    slack = 1e-12 * max(abs(centre), range_mean)
    return Individuals(
        centre,
        range_mean / D2,
        lower,
        upper,
        _places((x < lower - slack) | (x > upper + slack)),
        ranges,
        range_mean,
        D4 * range_mean,
        tuple(place + 1 for place in _places(ranges > D4 * range_mean + slack)),
        first,
    )


def ewma(
    values: Sequence[float],
    centre: float,
    sigma: float,
    *,
    weight: float = EWMA_WEIGHT,
    limit: float = EWMA_LIMIT,
) -> Ewma:
    """Compute the chart of the exponentially weighted moving average. It shows small lasting shifts.

    Roberts, Technometrics 1 (1959) 239; Montgomery, section 9.2; ISO 7870-6. The average begins at the centre. The
    limits widen from the first values on, as its variance does.

    values: Values in the order of time.
    centre, sigma: Centre and short-term standard deviation, from `individuals`.
    weight, limit: See `Ewma`.

    Examples
    --------
    >>> chart = ewma([10.0, 11.0], 10.0, 1.0, weight=0.1, limit=2.7)
    >>> chart.averages.round(3).tolist(), chart.upper.round(3).tolist()
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
    return Ewma(weight, limit, averages, centre - half, centre + half, beyond)


def ewma_sigma(number: Array, sigma: float, weight: float) -> Array:
    """Return the standard deviation of the average after some values.

    Montgomery, section 9.2.

    number: (N,) float64, number of values so far.
    sigma: Standard deviation of a value.
    Returns: (N,) float64, in the unit of ``sigma``.
    """
    shares = weight / (2.0 - weight) * (1.0 - (1.0 - weight) ** (2.0 * np.asarray(number, float)))
    return np.asarray(sigma * np.sqrt(shares))


def _places(condition: NDArray[np.bool_]) -> tuple[int, ...]:
    return tuple(int(place) for place in np.flatnonzero(condition))
