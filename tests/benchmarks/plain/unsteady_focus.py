"""A focal length that changes while the poses are recorded: a step, a drift, or another one at each pose.

No single focal length holds then. So the uncertainties span what was seen.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib.arrays import Array
from calib.model import cause as kinds
from calib.model.cause import LARGEST_EVIDENCE, Cause
from calib.model.likelihood_ratio import ALONE, DECISIVE, needed
from calib.view import View

from .added_columns import AddedColumns, displaced
from .knowledge import STEADY
from .posterior import Posterior, posterior
from .search import Optimum, best_amplitudes
from .solution import solve
from .witnesses import fault_probabilities, two_log_odds
from .words import DOUBTED

#: Prior 1 sigma of a change of the focal length between poses, as a share: 2 degrees of an ordinary ring. Smaller ones
#: than the second number may come from 3 K of aluminium.
_CHANGE, _LEAST_CHANGE = 1e-3, 1e-4
#: Odds beforehand that the focus ring was touched, or that a lens has play: once in a hundred calibrations.
_UNSTEADY = 1e-2
#: A change is adjusted if it promises so much of 2 log of the likelihood at the amplitudes found, though these have
#: grown to take it up: without one, 5 % of places do.
#: Steps of .02 to .2 % on drawn benches that were told promised 5 or more.
_PROMISED = 4.0
#: Values of the poses of which a straight line leaves so much of the variance may be a drift.
_STRAIGHT = 0.1
#: So many of the most promising changes are adjusted, each with so many improvements of its sizes.
_TRIED, _IMPROVED = 2, 3
_AMPLITUDE_STEPS = 20


@dataclass(frozen=True)
class _Change:
    """How the focal length of the views changes: its logarithm by (m, K) sizes."""

    kind: str
    shares: Array
    cost: float  # -2 log of its odds
    first: int = 0  # The first view after a step

    def promised(self, views: AddedColumns) -> float:
        """Return by how much 2 log of the evidence grows, all linear; that of a single size without its width."""
        unit = np.eye(self.shares.shape[1])
        gradient = self.shares.T @ views.gradient
        information = self.shares.T @ views.information @ self.shares
        gain = float(gradient @ np.linalg.solve(information + unit / _CHANGE**2, gradient))
        return gain - (np.linalg.slogdet(unit + _CHANGE**2 * information)[1] if len(unit) > 1 else 0.0)


@dataclass(frozen=True)
class _Changed:
    """An optimum with a change of the focal length."""

    change: _Change
    sizes: Array  # (K,)
    information: Array  # (K, K)
    optimum: Optimum

    @property
    def taken(self) -> float:
        """By how much the prior of the sizes lowers 2 log of the evidence: its width, and how far out they lie."""
        far = (self.sizes / _CHANGE) ** 2
        width = np.linalg.slogdet(np.eye(len(far)) + _CHANGE**2 * self.information)[1]
        return float(width + (far / (1.0 + far)).sum())

    @property
    def is_straight(self) -> bool:
        """Whether the focal lengths nearly drift."""
        log_f = self.change.shares @ self.sizes
        line = np.polynomial.Polynomial.fit(np.arange(len(log_f)), log_f, 1)
        return bool(np.var(log_f - line(np.arange(len(log_f)))) < _STRAIGHT * np.var(log_f))

    def as_cause(self, evidence: float, views: Sequence[View], **also: tuple[str, ...]) -> Cause:
        """Return the cause: the size of a step with its sign, or what all poses span."""
        first, log_f = self.change.first, self.change.shares @ self.sizes
        span = self.change.shares[log_f.argmax()] - self.change.shares[log_f.argmin()]
        covariance = np.linalg.inv(self.information + np.eye(len(span)) / _CHANGE**2)
        value = float(log_f[-1] - log_f[0]) if first else float(np.ptp(log_f))
        between = {"before": views[first - 1].name, "pose": views[first].name} if first else {}
        return _cause(
            self.change.kind, evidence, value, math.sqrt(span @ covariance @ span), **between, **also
        )


def _cause(kind: str, evidence: float, value: float, sigma: float, **also: Any) -> Cause:
    return Cause(kind, min(evidence, LARGEST_EVIDENCE), 100.0 * value, 200.0 * sigma, "%", **also)


def unsteady_focus(first: Posterior, views: Sequence[View]) -> Cause | None:
    """Return how the focal length changes, if that explains the views better than anything else; its value is a span.

    A change displaces log f in the bases of the views; the equations at the optimum say what that gains. A drift is an
    effect of the adjustment.
    """
    m = len(views)
    if m < 3 or first.problem.n < 3:
        return None
    faults = fault_probabilities(first)
    drifts = faults.get(STEADY, 0.0)
    tried = [(_worth(first, there), there) for there in _promising(first.optimum, m)]
    worth, there = max(tried, key=lambda pair: pair[0], default=(-math.inf, None))
    drift, steady = (2.0 * math.log(max(p, 1e-30)) for p in (drifts, 1.0 - drifts))
    worths = {kinds.FOCUS_CREEPS: drift} | {
        one.change.kind: own for own, one in sorted(tried, key=lambda pair: pair[0])
    }
    beside = [kind for kind, own in worths.items() if own > max(worth, drift) - ALONE]
    if there is not None and worth > max(drift, steady):
        accused = fault_probabilities(posterior(there.optimum))
        explains = tuple(name for name, p in faults.items() if p >= DOUBTED > accused.get(name, 0.0))
        beside.remove(there.change.kind)
        if there.is_straight and kinds.FOCUS_CREEPS not in beside:
            beside.append(kinds.FOCUS_CREEPS)
        return there.as_cause(worth - steady + DECISIVE, views, beside=tuple(beside), explains=explains)
    if two_log_odds(1.0 - drifts) < DECISIVE:
        return None
    at = first.problem.unknowns.places("drift")[0]
    value, sigma = float(first.mean[at]), float(np.sqrt(first.covariance[at, at]))
    beside.remove(kinds.FOCUS_CREEPS)
    return _cause(
        kinds.FOCUS_CREEPS, two_log_odds(1.0 - drifts), value, sigma, beside=tuple(beside), explains=(STEADY,)
    )


def spread_of(cause: Cause | None) -> float:
    """Return the 1-sigma of a focal length that lies anywhere in the span of a cause, as a share."""
    return 0.0 if cause is None or cause.value is None else abs(cause.value) / 100.0 / math.sqrt(12.0)


def _promising(optimum: Optimum, m: int) -> list[_Changed]:
    """Return the optima with the changes of m views that promise most, a step and another focal length at each pose."""
    columns = np.zeros((m, optimum.solution.problem.size, m))
    columns[:, 0] = np.eye(m)
    gains, odds = AddedColumns.of(optimum.solution, columns), 2.0 * math.log(_UNSTEADY)
    steps = [
        _Change(kinds.FOCUSED, np.where(np.arange(m) >= k, 1.0, 0.0)[:, None], needed(m - 1) - odds, k)
        for k in range(1, m)
    ]
    steps.sort(key=lambda change: -change.promised(gains))
    tried = [*steps[:_TRIED], _Change(kinds.FOCUS_PLAYS, np.eye(m), needed(1) - odds)]
    changed = [_changed(optimum, change, columns) for change in tried if change.promised(gains) > _PROMISED]
    value = best_amplitudes(optimum.solution, _AMPLITUDE_STEPS).value if changed else 0.0
    return [
        there
        for there in changed
        if np.ptp(there.change.shares @ there.sizes) >= _LEAST_CHANGE
        and value - there.optimum.solution.value > there.taken + there.change.cost
    ]


def _worth(first: Posterior, there: _Changed) -> float:
    """Return 2 log of the evidence with a change, and its odds, over that of the first posterior."""
    other = posterior(there.optimum)
    gained = (
        other.log_odds - first.log_odds - 0.5 * (other.optimum.solution.value - first.optimum.solution.value)
    )
    return 2.0 * gained - there.taken - there.change.cost


def _changed(optimum: Optimum, change: _Change, columns: Array) -> _Changed:
    """Return the best sizes of a change, by (m, B, m) displacements of each view."""
    along = columns @ change.shares
    sizes, there = np.zeros(change.shares.shape[1]), optimum
    for _ in range(_IMPROVED):
        added = AddedColumns.of(there.solution, along)
        sizes = sizes + np.linalg.solve(added.information + np.eye(len(sizes)) / _CHANGE**2, added.gradient)
        moved = displaced(optimum.solution.equations, along @ sizes)
        there = replace(optimum, solution=best_amplitudes(solve(moved, there.solution.eta), _AMPLITUDE_STEPS))
    return _Changed(change, sizes, added.information, there)
