"""Drift of a parameter, the test whether it is more than chance, and a gauge study: numbers in, numbers out.

Drift: a random-effects meta-regression, a line in time and temperature, an effect of each run (standard deviation tau),
and the error that the run states.

Gauge study, how much of the scatter is the bench's: all factors are random; components follow from the expected mean
squares of sequential sums (Henderson's method 3; Searle, Casella and McCulloch, Variance Components, 1992, 5.5). For
equal repeats see AIAG, Measurement Systems Analysis, 4th edition (2010), and NIST/SEMATECH e-Handbook, 3.2.3.2.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

from bench.base.errors import UsageError
from bench.record.summaries import EwmaData, LimitsData, TestedSlope

Array = NDArray[np.float64]

D2 = 2.0 / math.sqrt(math.pi)
"""Mean of the range of two normal values, in standard deviations: 1.128 in the published tables."""
E2 = 3.0 / D2
"""Distance of the limits of individuals from the centre, in mean moving ranges: 2.660."""
EWMA_WEIGHT = 0.2
EWMA_LIMIT = 2.86
"""With `EWMA_WEIGHT`, one false alarm in 370 runs on average, as with three sigma (Crowder, J. Quality Technology 21
(1989) 155)."""
SHEWHART_CHANCE = 0.0027
"""Chance of a run in control to lie beyond three sigma."""
LEVEL = 0.05
"""Chance of one false drift or more on a whole page."""
LEAST_RUNS = 5
"""Fewest runs for the test of one slope."""
LEAST_RUNS_JOINT = 8
"""Fewest runs for the test of both slopes together."""
LEAST_RANGE_C = 0.2
"""Smallest range of temperatures for which a slope is tested, degrees Celsius."""
INSEPARABLE = 0.9
"""From this correlation of time and temperature on, their slopes are tested one at a time."""

PART, REPEATABILITY = "camera", "repeatability"
POOLED_ABOVE = 0.05
"""An interaction with a larger p is counted as repeatability (AIAG, appendix A)."""
_CATEGORIES = 1.41  # Square root of 2: distinct categories by AIAG's manual (MSA, 4th edition)
# Per cent of the variation or of the tolerance, by AIAG's manual (MSA, 4th edition).
_GOOD, _CONDITIONAL = 10.0, 30.0


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

    # per_day, per_c: Slopes; None if they cannot be tested.
    per_day: TestedSlope | None
    per_c: TestedSlope | None
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


@dataclass(frozen=True)
class Term:
    """A row of the table of the analysis of variance; F and p are against the repeatability, None for itself."""

    name: str
    sum_of_squares: float
    degrees_of_freedom: int
    f: float | None = None
    p: float | None = None

    @property
    def mean_square(self) -> float:
        """Sum of squares over degrees of freedom."""
        return self.sum_of_squares / self.degrees_of_freedom


@dataclass(frozen=True)
class GaugeStudy:
    """The components of the scatter of one parameter, as standard deviations."""

    terms: tuple[Term, ...]  # Cameras, factors, interactions with the cameras, repeatability
    pooled: tuple[str, ...]  # Interactions that were counted as repeatability
    components: Mapping[str, float]  # Standard deviation by term; 0 where its variance came out negative

    @property
    def repeatability(self) -> float:
        """EV: one camera, measured again under the same conditions."""
        return self.components[REPEATABILITY]

    @property
    def reproducibility(self) -> float:
        """AV: all factors, with their interactions."""
        others = (value for name, value in self.components.items() if name not in (PART, REPEATABILITY))
        return math.hypot(*others)

    @property
    def gauge(self) -> float:
        """GRR: all but the cameras."""
        return math.hypot(self.repeatability, self.reproducibility)

    @property
    def total(self) -> float:
        """TV: all."""
        return math.hypot(self.gauge, self.components[PART])

    @property
    def gauge_percent(self) -> float:
        """%GRR: the part of the gauge in the total scatter, as standard deviations."""
        return 100.0 * self.gauge / self.total if self.total > 0 else 0.0

    @property
    def categories(self) -> int | None:
        """Number of distinct categories, 1.41 PV / GRR rounded down; None if the gauge has no scatter."""
        return int(_CATEGORIES * self.components[PART] / self.gauge) if self.gauge > 0 else None

    @property
    def verdict(self) -> str:
        """The verdict of AIAG on %GRR: ``good`` below 10 %, ``conditional`` to 30 %, else ``not good``."""
        percent = self.gauge_percent
        return "good" if percent < _GOOD else "conditional" if percent <= _CONDITIONAL else "not good"


def study(
    values: Sequence[float], cameras: Sequence[str], factors: Mapping[str, Sequence[str]]
) -> GaugeStudy:
    """Analyse the scatter of a parameter; ``factors`` holds the level of each run, such as of ``operator``."""
    _require_levels(PART, cameras)
    for name, levels in factors.items():
        _require_levels(name, levels)
    y = np.asarray(values, float)
    columns = {PART: _indicators(cameras)}
    columns |= {name: _indicators(levels) for name, levels in factors.items()}
    interactions = [f"{PART} x {name}" for name in factors]
    for name, levels in factors.items():
        both = [f"{camera}\0{level}" for camera, level in zip(cameras, levels, strict=True)]
        columns[f"{PART} x {name}"] = _indicators(both)
    terms, components = _analysis(y, columns)
    by_name = {term.name: term for term in terms}
    if missing := [name for name in factors if name not in by_name]:
        raise UsageError(
            f"These runs do not show the effect of the {missing[0]}: it changes only together with the rest.",
            remedy="Measure each camera under each condition, or leave this factor out.",
        )
    pooled = tuple(
        name for name in interactions if name in by_name and (by_name[name].p or 0.0) > POOLED_ABOVE
    )
    if pooled:
        kept = {name: column for name, column in columns.items() if name not in pooled}
        _, components = _analysis(y, kept)
    return GaugeStudy(terms, pooled, components)


def _require_levels(name: str, levels: Sequence[str]) -> None:
    distinct = sorted(set(levels))
    if len(distinct) < 2:
        only = f"; these runs have 1: {distinct[0]}" if distinct else ""
        raise UsageError(
            f"A gauge study needs at least 2 {plural(name)}{only}.",
            remedy=f"Measure with another {name}, or name runs of several: see docs/gauge-study.md.",
        )


def plural(name: str) -> str:
    """Return the plural of a camera or a factor."""
    return f"{name}es" if name.endswith("ch") else f"{name}s"


def _indicators(levels: Sequence[str]) -> Array:
    """Return (N, L) float64: 1 where the run has the level."""
    names = sorted(set(levels))
    return np.array([[float(level == name) for name in names] for level in levels])


def _analysis(y: Array, columns: Mapping[str, Array]) -> tuple[tuple[Term, ...], dict[str, float]]:
    """Return the table, and the standard deviation of each term from the expected mean squares."""
    spaces = _spaces(columns, len(y))
    free = len(y) - 1 - sum(space.shape[1] for space in spaces.values())
    if free < 1:
        raise UsageError(
            "Each camera was measured only once under each condition, so the runs show no repeatability.",
            remedy="Repeat at least one of the measurements.",
        )
    squares = {name: float(((space.T @ y) ** 2).sum()) for name, space in spaces.items()}
    left = max(0.0, float(((y - y.mean()) ** 2).sum()) - sum(squares.values()))
    error = left / free
    terms = [_term(name, squares[name], spaces[name].shape[1], error, free) for name in spaces]
    variances = {REPEATABILITY: error}
    for name in reversed(list(spaces)):  # the expected mean squares are triangular: the last term first
        space = spaces[name]
        degrees = space.shape[1]
        known = error + sum(
            variances[other] * float(((space.T @ columns[other]) ** 2).sum()) / degrees
            for other in variances
            if other != REPEATABILITY
        )
        own = float(((space.T @ columns[name]) ** 2).sum()) / degrees
        variances[name] = (squares[name] / degrees - known) / own
    components = {name: math.sqrt(max(0.0, variances[name])) for name in [*spaces, REPEATABILITY]}
    return (*terms, Term(REPEATABILITY, left, free)), components


def _spaces(columns: Mapping[str, Array], count: int) -> dict[str, Array]:
    """Return an orthonormal basis (N, df) of what each term adds to the mean and to the terms before it."""
    held = np.full((count, 1), 1.0 / math.sqrt(count))
    spaces = {}
    for name, column in columns.items():
        left = column - held @ (held.T @ column)
        left -= held @ (held.T @ left)  # twice: rounding
        basis, sizes, _ = np.linalg.svd(left, full_matrices=False)
        basis = basis[:, sizes > 1e-9 * math.sqrt(count)]
        if basis.shape[1]:
            spaces[name] = basis
            held = np.hstack([held, basis])
    return spaces


def _term(name: str, squares: float, degrees: int, error: float, free: int) -> Term:
    if error == 0.0:
        return Term(name, squares, degrees)
    ratio = squares / degrees / error
    return Term(name, squares, degrees, ratio, float(stats.f.sf(ratio, degrees, free)))


@dataclass(frozen=True)
class Capability:
    """How a parameter's scatter fits into its limits (NIST/SEMATECH e-Handbook, 6.1.6); None without a second limit."""

    cp: float | None
    cpk: float
    tolerance_percent: float | None  # 6 GRR over the tolerance


def capability(
    lower: float | None, upper: float | None, mean: float, sigma: float, gauge: float = 0.0
) -> Capability | None:
    """Return Cp, Cpk and the share of the gauge in the tolerance; None without a limit or without scatter.

    >>> capability(8.0, 20.0, 16.0, 2.0)
    Capability(cp=1.0, cpk=0.6666666666666666, tolerance_percent=0.0)
    """
    if sigma <= 0 or (lower is None and upper is None):
        return None
    distances = [*([] if lower is None else [mean - lower]), *([] if upper is None else [upper - mean])]
    cpk = min(distances) / (3.0 * sigma)
    if lower is None or upper is None:
        return Capability(None, cpk, None)
    return Capability((upper - lower) / (6.0 * sigma), cpk, 100.0 * 6.0 * gauge / (upper - lower))
