"""A focal length that changes while the poses are recorded: a step, a drift, or another one at each pose.

No single focal length holds then. The views are brought to the middle of those that were there, and U spans them all.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.arrays import Array
from calib.joint.added_columns import PROMISED, AddedColumns, displaced
from calib.joint.effects.camera import DRIFT
from calib.joint.evidence import log_evidence, two_log
from calib.joint.hypotheses import FOCUS_CHANGE
from calib.joint.knowledge import DOUBTED, STEADY
from calib.joint.modes import modes_of
from calib.joint.posterior import Posterior
from calib.joint.solve import Optimum
from calib.model import cause as kinds
from calib.model.cause import MOST_BESIDE, Cause
from calib.model.likelihood_ratio import ALONE
from calib.view import View

#: Prior 1 sigma of a change of the focal length between poses, as a share: 2 degrees of an ordinary ring. Smaller ones
#: than the second number may come from 3 K of aluminium.
_CHANGE, _LEAST_CHANGE = 1e-3, 1e-4
#: So many of the most promising steps are adjusted, each change with so many improvements of its sizes.
_TRIED, _IMPROVED = 2, 3
#: 2 log of the odds from which on a change is told, as the doubt of a statement is.
_POSSIBLE = 2.0 * math.log(DOUBTED / (1.0 - DOUBTED))


@dataclass(frozen=True)
class UnsteadyFocus:
    """Focal lengths of m views that differ."""

    kind: str
    log_f: Array  # (m,) logarithms of their shares
    sigma: float  # Of their span
    worth: float  # 2 log of its odds
    first: int = 0  # The first view after a step
    evidence: float = 0.0  # The worth less that of a steady focal length
    beside: tuple[str, ...] = ()  # Kinds that are not much less probable

    @property
    def is_sure(self) -> bool:
        """Whether a steady focal length is out of the question."""
        return kinds.UNCHANGED not in self.beside

    @property
    def _middle(self) -> float:
        return 0.5 * float(self.log_f.max() + self.log_f.min())

    def beyond(self, posterior: Posterior) -> Array:
        """Return (S,) how far the shared unknowns of a pose may be from the stated ones.

        These are those of the middle focal length if the change is sure. All other unknowns follow what is not known of
        it: a focal length that grows with the tilt displaces the principal point.
        """
        optimum, off = posterior.optimum.at_best, self.log_f - self.log_f.mean()
        not_known = off
        if self.is_sure:
            off = self.log_f - self._middle
            not_known = self.sigma / np.ptp(off) * off
        there = displaced(optimum, np.outer(not_known, _focal(optimum)), optimum.eta)
        beyond = there.solution.step - optimum.solution.step
        at = optimum.marginal.problem.bench.layout.places(("fx", "fy"))
        beyond[at] = (np.abs(off).max() + self.sigma) * posterior.mean[at]
        return beyond

    def at_middle(self, views: Sequence[View], centre: Array) -> list[View]:
        """Return the views as the middle focal length shows them; ``centre`` is the principal point, px."""
        return [
            replace(view, points_px=centre + math.exp(self._middle - own) * (view.points_px - centre))
            for view, own in zip(views, self.log_f.tolist(), strict=True)
        ]

    def as_cause(self, views: Sequence[View]) -> Cause:
        """Return the cause: the size of a step or drift has a sign; poses that differ span theirs."""
        signed = self.kind != kinds.FOCUS_PLAYS
        value = float(self.log_f[-1] - self.log_f[0] if signed else np.ptp(self.log_f))
        before, pose = (views[self.first - 1].name, views[self.first].name) if self.first else ("", "")
        cause = Cause(self.kind, self.evidence, 100.0 * value, 200.0 * self.sigma, "%")
        return replace(cause, before=before, pose=pose, beside=self.beside, explains=(STEADY,))


def unsteady_focus(posterior: Posterior) -> UnsteadyFocus | None:
    """Return how the focal length changes, or may change; None if it is steady.

    A drift is an effect of the adjustment; another change displaces the focal lengths in the bases of the views.
    """
    if posterior.optimum.marginal.problem.bench.n_poses < 3:
        return None
    drifts = posterior.faults.get(STEADY, 0.0)
    changes = [_drift(posterior, drifts), *_others(posterior.optimum)]
    changes.sort(key=lambda change: change.worth)
    best, steady = changes[-1], two_log(1.0 - drifts)
    if best.worth - steady < _POSSIBLE or np.ptp(best.log_f) < _LEAST_CHANGE:
        return None
    worths = {kinds.UNCHANGED: steady} | {change.kind: change.worth for change in changes}
    beside = [kind for kind, worth in worths.items() if worth > best.worth - ALONE and kind != best.kind]
    return replace(best, evidence=best.worth - steady, beside=tuple(beside[:MOST_BESIDE]))


def _drift(posterior: Posterior, probability: float) -> UnsteadyFocus:
    """Return the drift of a posterior, over the poses in their order."""
    bench = posterior.optimum.marginal.problem.bench
    at = bench.layout.index[DRIFT]
    shares = bench.poses / (bench.n_poses - 1)
    sigma = math.sqrt(posterior.covariance[at, at])
    return UnsteadyFocus(kinds.FOCUS_CREEPS, posterior.mean[at] * shares, sigma, two_log(probability))


@dataclass(frozen=True)
class _Change:
    """How the logarithms of the focal lengths of m views follow K sizes."""

    kind: str
    shares: Array  # (m, K)
    odds: float  # Beforehand
    first: int = 0

    def promised(self, views: AddedColumns) -> float:
        """Return by how much 2 log of the evidence grows, all linear; that of a single size without its width."""
        own, unit = views.along(self.shares), np.eye(self.shares.shape[1])
        gain = float(own.gradient @ np.linalg.solve(own.information + unit / _CHANGE**2, own.gradient))
        return gain - (np.linalg.slogdet(unit + _CHANGE**2 * own.information)[1] if len(unit) > 1 else 0.0)

    def adjusted(self, optimum: Optimum) -> tuple[UnsteadyFocus, Optimum]:
        """Return the change at its best sizes, its worth by the likelihood alone, and the optimum with it."""
        sizes, there, focal = np.zeros(self.shares.shape[1]), optimum, _focal(optimum)
        for _ in range(_IMPROVED):
            own = AddedColumns.of_views(there, focal[:, None]).along(self.shares)
            pull = own.gradient + own.information @ sizes
            sizes = np.asarray(np.linalg.solve(own.information + _expected(sizes), pull), np.float64)
            there = displaced(optimum, np.outer(self.shares @ sizes, focal), there.eta)
        far, log_f = (sizes / _CHANGE) ** 2, self.shares @ sizes
        width = np.linalg.slogdet(np.eye(len(far)) + _CHANGE**2 * own.information)[1]
        cost = float(width + (far / (1.0 + far)).sum()) - 2.0 * math.log(self.odds)
        worth = optimum.at_best.solution.value - there.solution.value - cost
        span = self.shares[log_f.argmax()] - self.shares[log_f.argmin()]
        sigma = math.sqrt(span @ np.linalg.solve(own.information + _expected(sizes), span))
        return UnsteadyFocus(self.kind, log_f, sigma, worth, self.first), there


def _expected(sizes: Array) -> Array:
    """Return the (K, K) information of the prior on (K,) sizes: those far out are expected to be so."""
    return np.diag((_CHANGE * (1.0 + (sizes / _CHANGE) ** 2)) ** -2.0)


def _focal(optimum: Optimum) -> Array:
    """Return (B,) how a basis follows the logarithm of the focal lengths."""
    layout = optimum.marginal.problem.bench.layout
    at, basis = layout.places(("fx", "fy")), np.zeros(layout.pose.size)
    basis[at] = optimum.state.shared[at]
    return basis


def _others(optimum: Optimum) -> list[UnsteadyFocus]:
    """Return the likeliest steps between two views, a drift, and own focal lengths of poses, if they promise enough."""
    bench = optimum.marginal.problem.bench
    m, odds = len(bench.poses), FOCUS_CHANGE.odds
    gains = AddedColumns.of_views(optimum, _focal(optimum)[:, None])
    steps = [
        _Change(kinds.FOCUSED, np.where(np.arange(m) >= k, 1.0, 0.0)[:, None], odds / (m - 1), k)
        for k in range(1, m)
    ]
    steps.sort(key=lambda change: -change.promised(gains))
    # The drift of the adjustment is a field on the target, which a large one leaves; this one is exact.
    creeps = _Change(kinds.FOCUS_CREEPS, bench.times[:, None], odds)
    plays = _Change(kinds.FOCUS_PLAYS, np.eye(bench.n_poses)[bench.poses], odds)
    changes = (*steps[:_TRIED], creeps, plays)
    adjusted = [change.adjusted(optimum) for change in changes if change.promised(gains) > PROMISED]
    likely = [(change, there) for change, there in adjusted if change.worth > _POSSIBLE]
    before = _by_doubts(optimum.at_best) if likely else 0.0
    return [replace(change, worth=change.worth + _by_doubts(there) - before) for change, there in likely]


def _by_doubts(optimum: Optimum) -> float:
    """Return by how much 2 log of the evidence is larger with all doubts of statements: each takes a while."""
    return 2.0 * log_evidence(modes_of(optimum), optimum) + optimum.solution.value
