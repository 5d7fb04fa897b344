"""The posterior: a mixture over the amplitudes and over faults of statements.

For given amplitudes the posterior is Gaussian (`calib.joint.marginal`). The amplitudes are known only so well, so the
result is the mixture over their posterior: importance sampling about each mode, with fixed normal deviates, so that the
result follows the data without steps. A statement may be doubted (`calib.joint.doubts`): each doubt has odds
beforehand, and counts by its likelihood. If two statements contradict each other and nothing decides, the mixture
covers both.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.arrays import Array
from calib.errors import NotConverged
from calib.joint import amplitudes as amp
from calib.joint.curvature import ROUGH, best_amplitudes, expected_curvature
from calib.joint.doubts import (
    LARGEST_LOG,
    Innovation,
    Unstated,
    doubted,
    prior_odds,
    share_of_stars,
    usual_amplitudes,
)
from calib.joint.knowledge import FOCAL
from calib.joint.marginal import Solution
from calib.joint.places import spread_of_places
from calib.joint.prior import Faults
from calib.joint.samples import Node, log_odds, nodes_about
from calib.joint.solve import Optimum, beside, relative_step, weighed_as
from calib.model.result_parts import COVERAGE

#: Halvings of an interval until its half width is known to 1e-9 of the widest.
_HALVINGS = 30
_PAIRS, _FAULT_PAIRS = 12, 4
#: A mode of a smaller share stands for all amplitudes about it.
_SMALL_SHARE, _SMALL_DOUBT = 0.01, 0.05
_FAULT_STEPS = 20
#: A search of another mode starts with logarithms that are so much smaller, and larger, where the mode may differ.
_LOWER, _HIGHER = 2.5, 1.0
#: A mode is another one if it is so far away: a square, in sigmas. A search that comes nearer ends where the first did.
_APART = 2.0
#: The equations hold for steps of this share of focal length and radius.
_NEAR = 0.01
#: What lies beside such a state still counts if it is so near that the equations show where it is.
_REACHED = 0.05
#: A fault that leads farther is looked at if its odds against none are more than this.
_COUNTS = 0.05
#: Odds are told up to this logarithm: its exponential is still a number.
_LARGEST_SCALE = 600.0


@dataclass(frozen=True)
class OtherWay:
    """The posterior of the same views if the pupil is moved in the other way, in the unknowns of the first one."""

    posterior: Posterior
    share: float
    means: Array  # (L, S) of its nodes
    covariances: list[Array]  # (S, S) of each


@dataclass(frozen=True)
class Posterior:
    """The mixture."""

    optimum: Optimum
    nodes: tuple[Node, ...]
    spread: Array  # (A,) 1-sigma of the logarithms of the amplitudes
    faults: dict[str, float]  # Probability of a fault by name of the statement
    largest: Node  # The mode with the largest share
    other: OtherWay | None = None
    denied: Innovation | None = None  # A statement that is not in the equations: it is probably wrong

    @cached_property
    def weights(self) -> Array:
        """(K,) weights of the nodes, those of the other way behind."""
        own = np.array([node.weight for node in self.nodes])
        if self.other is None:
            return own
        share = self.other.share
        return np.concatenate([(1.0 - share) * own, share * self.other.posterior.weights])

    @cached_property
    def means(self) -> Array:
        """(K, S) means of the shared unknowns."""
        own = self.optimum.state.shared + np.array([node.solution.step for node in self.nodes])
        return own if self.other is None else np.concatenate([own, self.other.means])

    @cached_property
    def covariances(self) -> list[Array]:
        """(S, S) of each node."""
        own = [node.solution.covariance for node in self.nodes]
        if self.pupils is not None:
            own = [one + self.pupils for one in own]
        return own if self.other is None else own + self.other.covariances

    @cached_property
    def pupils(self) -> Array | None:
        """(S, S) covariance that the places of the pupil add; None on a gimbal."""
        moved = self.optimum.marginal.problem.pupils is not None
        return spread_of_places(self.optimum.solution) if moved else None

    @cached_property
    def mean(self) -> Array:
        """(S,) mean of the shared unknowns."""
        return np.asarray(self.weights @ self.means)

    @cached_property
    def covariance(self) -> Array:
        """(S, S) covariance of the shared unknowns."""
        away = self.means - self.mean
        within = sum(weight * own for weight, own in zip(self.weights, self.covariances, strict=True))
        return np.asarray(within + (self.weights[:, None] * away).T @ away)

    def expanded(self, row: Array) -> float:
        """Return the half width of the interval that covers 95.45 % of the function with the (S,) gradient row."""
        at = np.flatnonzero(row)
        away = (self.means[:, at] - self.mean[at]) @ row[at]
        sigmas = np.sqrt([row[at] @ own[at[:, None], at] @ row[at] for own in self.covariances])
        low, high = 0.0, float((np.abs(away) + 6.0 * sigmas).max())
        for _ in range(_HALVINGS):
            half = 0.5 * (low + high)
            ends = np.array([half - away, half + away]) / (np.sqrt(2.0) * sigmas)
            inside = 0.5 * np.array([[math.erf(one) for one in side] for side in ends.tolist()]).sum(axis=0)
            low, high = (low, half) if float(self.weights @ inside) > COVERAGE else (half, high)
        return 0.5 * (low + high)

    def share_of(self, fault: tuple[str, str]) -> float:
        """Return the probability of a fault of a statement, or of its other meaning."""
        own = sum(node.weight for node in self.nodes if fault in node.faults)
        if self.other is None:
            return own
        return (1.0 - self.other.share) * own + self.other.share * self.other.posterior.share_of(fault)

    def innovations(self) -> list[Innovation]:
        """Return the innovation of every statement that could be wrong, at the largest mode."""
        largest = self.largest.solution
        found = Unstated(largest.marginal, largest.eta).innovations(largest.faults)
        found += [self.denied] if self.denied else []
        return [replace(one, probability=self.faults.get(one.name, 0.0)) for one in found]


@dataclass(frozen=True)
class Modes:
    """The modes of the posterior by the equations of an optimum."""

    optimum: Optimum
    curvature: Array  # (A, A) about the optimum
    nodes: list[Node]  # Their weights are relative; the first is the optimum
    likeliest: Node  # The likeliest doubts, or the first
    # Weights of doubts that show the same camera as the likeliest, whose weight includes them.
    alike: dict[Faults, float]
    scale: float  # Weights are odds against the first without doubts, divided by the exponential of this

    @property
    def none(self) -> float:
        """Weight of the first without doubts."""
        return math.exp(-min(self.scale, _LARGEST_SCALE))

    @property
    def log_odds(self) -> float:
        """Logarithm of the odds of all modes together against the first without doubts."""
        return math.log(sum(one.weight for one in self.nodes)) + self.scale

    def shares(self, modes: Sequence[Node]) -> dict[Faults, float]:
        """Return the weight of each combination of doubts, none included, among some of the modes or others."""
        found: dict[Faults, float] = {}
        for mode in modes:
            own = [(mode.faults, mode.weight)]
            if mode is self.likeliest:
                own = [(mode.faults, mode.weight - sum(self.alike.values())), *self.alike.items()]
            for doubts, weight in own:
                found[doubts] = found.get(doubts, 0.0) + weight
        return found


def posterior(optimum: Optimum, rounds: int, *, follow: bool = True, found: Modes | None = None) -> Posterior:
    """Return the posterior about an optimum, or about the most probable faults if these lead far away from it.

    The equations at the state that such faults lead to say how much they count; the search of that state takes at most
    ``rounds`` linearisations. They do not count if these equations lead far away again, or if ``follow`` is false.
    The modes may be ``found`` already.
    """
    found = found or modes_of(optimum)
    modes = found.nodes
    far = [bool(one.faults) and not _holds(optimum, one) for one in modes]
    near = [one for one, away in zip(modes, far, strict=True) if not away]
    likeliest = max((one for one, away in zip(modes, far, strict=True) if away), key=_by_weight, default=None)
    if likeliest is None or likeliest.weight < _COUNTS * found.none:
        return _mixture(found, modes)
    if not follow:
        return _mixture(found, near)
    try:
        there = beside(optimum, likeliest.faults, rounds)
        odds = odds_of(there, likeliest.faults, optimum)
    except (NotConverged, np.linalg.LinAlgError):  # without the statement nothing determines the camera
        return _mixture(found, near)
    if odds > 1.0 and likeliest.weight > max(one.weight for one in near):
        found_there = modes_of(there)
        near_there = [one for one in found_there.nodes if _holds(there, one)]
        if near_there:
            others = _also(there, found_there.nodes, near, likeliest.faults, odds * found.none)
            return _mixture(found_there, [*near_there, *others])
        odds = 0.0
    share = min(odds * found.none / likeliest.weight, 1.0)
    kept = [
        replace(one, weight=share * one.weight) if away else one for one, away in zip(modes, far, strict=True)
    ]
    return _mixture(found, kept)


def _also(
    there: Optimum, modes: Sequence[Node], near: Sequence[Node], faults: Faults, odds: float
) -> list[Node]:
    """Return the modes near the first optimum, as the equations ``there`` show them: where a fault leads.

    They count by their weights against the ``odds`` of this fault. If these are alike, the result covers both.
    """
    found = {one.faults: one for one in modes if relative_step(there.marginal, one.solution.step) < _REACHED}
    if faults not in found:
        return []
    whole = found[faults].weight / odds
    return [
        replace(found[one.faults], weight=whole * one.weight)
        for one in near
        if one.faults in found and not _holds(there, found[one.faults])
    ]


def odds_of(there: Optimum, faults: Faults, than: Optimum) -> float:
    """Return the odds of faults, seen at the state that they lead to, against no fault at another optimum."""
    assert there.fault_eta is not None
    found = best_amplitudes(weighed_as(there, than).solve(there.fault_eta, faults), _FAULT_STEPS)
    log = 0.5 * (than.solution.value - found.value) * share_of_stars(found)
    return math.exp(min(log, LARGEST_LOG)) * prior_odds(there.marginal.problem.knowledge.witnesses, faults)


def _holds(optimum: Optimum, mode: Node) -> bool:
    """Return whether the step to a mode is so short that the equations hold there."""
    return relative_step(optimum.marginal, mode.solution.step) < _NEAR


def _by_weight(mode: Node) -> float:
    return mode.weight


def modes_of(optimum: Optimum) -> Modes:
    """Return the modes of the posterior by the equations of an optimum."""
    curvature = 0.5 * expected_curvature(optimum.solution)
    others = _others(optimum, curvature)
    found = doubted(optimum, curvature, others)
    nodes = [Node(optimum.solution, math.exp(-found.scale))]
    nodes += [replace(one, weight=one.weight * math.exp(-found.scale)) for one in others]
    nodes += found.nodes
    at = next((k for k, one in enumerate(nodes) if one.faults == found.likeliest), 0)
    nodes[at] = replace(nodes[at], weight=nodes[at].weight + sum(found.alike.values()))
    return Modes(optimum, curvature, nodes, nodes[at], found.alike, found.scale)


def probable_faults(optimum: Optimum) -> dict[str, float]:
    """Return the probability of a fault of each statement at an optimum, and under the empty name that of none."""
    modes = modes_of(optimum)
    whole = sum(mode.weight for mode in modes.nodes)
    shares = modes.shares(modes.nodes)
    found = {"": shares.get((), 0.0) / whole}
    for faults, weight in shares.items():
        for name in (name for name, doubt in faults if doubt != FOCAL):
            found[name] = found.get(name, 0.0) + weight / whole
    return found


def _mixture(found: Modes, modes: Sequence[Node]) -> Posterior:
    """Return the mixture of some of the modes, or of others."""
    lower: Array = np.asarray(np.linalg.cholesky(found.curvature), np.float64)
    whole = sum(mode.weight for mode in modes)
    nodes: list[Node] = []
    probabilities: dict[str, float] = {}
    for faults, weight in found.shares(modes).items():
        for name in (name for name, doubt in faults if doubt != FOCAL):
            probabilities[name] = probabilities.get(name, 0.0) + weight / whole
    for mode in modes:
        share = mode.weight / whole
        if share < (_SMALL_DOUBT if mode.faults else _SMALL_SHARE):
            nodes.append(replace(mode, weight=share))
        else:
            nodes += nodes_about(mode, lower, _FAULT_PAIRS if mode.faults else _PAIRS, share)
    spread = np.sqrt(np.diag(np.linalg.inv(found.curvature)))
    return Posterior(found.optimum, tuple(nodes), spread, probabilities, max(modes, key=_by_weight))


def _others(optimum: Optimum, curvature: Array) -> list[Node]:
    """Return the other modes that there are."""
    known = [optimum.solution]

    def near(one: Solution) -> bool:
        away = np.array([one.eta - other.eta for other in known])
        return bool((((away @ curvature) * away).sum(axis=1) < _APART).any())

    for start in _starts_of_others(optimum):
        with suppress(np.linalg.LinAlgError):
            ended = best_amplitudes(optimum.marginal.solve(start), _FAULT_STEPS, enough=ROUGH, until=near)
            known += [] if near(ended) else [ended]
    return [Node(one, _odds_of_mode(one, optimum.solution, curvature)) for one in known[1:]]


def _starts_of_others(optimum: Optimum) -> list[Array]:
    """Return the (A,) logarithms at which searches of other modes start.

    In one, what differs between poses follows their turn. In the other, parallax takes the place of field curvature.
    """
    problem = optimum.marginal.problem
    hyper, own = problem.hyper, problem.hyper.places(amp.POSE)
    follows = usual_amplitudes(optimum)
    follows[own] = hyper.mean[own] - _LOWER
    follows[hyper.at(amp.CURVATURE_TURN)] += _HIGHER
    if problem.bench.layout.bench.parallax_known:
        return [follows]
    parallax = optimum.eta.copy()
    parallax[hyper.at(amp.CURVATURE_TURN)] -= _LOWER
    parallax[hyper.at(amp.PARALLAX)] += _HIGHER
    return [follows, parallax]


def _odds_of_mode(one: Solution, other: Solution, curvature: Array) -> float:
    """Return the odds of a mode against another one, which has the (A, A) curvature, by values and widths (Laplace)."""
    wider = float(np.linalg.slogdet(curvature)[1] - np.linalg.slogdet(0.5 * expected_curvature(one))[1])
    return float(np.exp(min(log_odds(one, other, 0.5 * wider), LARGEST_LOG)))
