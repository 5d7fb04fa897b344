"""A gauge study: how much of the scatter of many runs is the bench's, by analysis of variance. Numbers in, numbers out.

All factors are random; components follow from the expected mean squares of sequential sums (Henderson's method 3;
Searle, Casella and McCulloch, Variance Components, 1992, 5.5). For equal repeats see AIAG, Measurement Systems
Analysis, 4th edition (2010), and NIST/SEMATECH e-Handbook, 3.2.3.2.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from bench.base.errors import UsageError

Array = NDArray[np.float64]

PART, REPEATABILITY = "camera", "repeatability"
POOLED_ABOVE = 0.05
"""An interaction with a larger p is counted as repeatability (AIAG, appendix A)."""
_CATEGORIES = 1.41
_GOOD, _CONDITIONAL = 10.0, 30.0


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
    found = sorted(set(levels))
    if len(found) < 2:
        only = f"; these runs have 1: {found[0]}" if found else ""
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
    """Return the table, no row for what earlier terms hold, and each term's standard deviation by mean squares."""
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
    found = {}
    for name, column in columns.items():
        left = column - held @ (held.T @ column)
        left -= held @ (held.T @ left)  # twice: rounding
        basis, sizes, _ = np.linalg.svd(left, full_matrices=False)
        basis = basis[:, sizes > 1e-9 * math.sqrt(count)]
        if basis.shape[1]:
            found[name] = basis
            held = np.hstack([held, basis])
    return found


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
