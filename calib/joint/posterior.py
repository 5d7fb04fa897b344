"""The posterior: a mixture over the amplitudes and over faults of statements.

For given amplitudes the posterior is Gaussian (`calib.joint.marginal`). The amplitudes are known only so well, so the
result is the mixture over their posterior: importance sampling about each mode, with fixed normal deviates, so that the
result follows the data without steps. A statement may be at fault: each fault has a small probability beforehand, and
counts by what the views add to it. If two statements contradict each other and nothing decides, the mixture covers
both.
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
from calib.joint.knowledge import FAULTS, FOCAL, ODDS, WRONG, Statement
from calib.joint.marginal import Solution
from calib.joint.places import spread_by_fields, spread_of_places
from calib.joint.prior import Faults, block_diagonal
from calib.joint.samples import Node, log_odds, nodes_about, trusted
from calib.joint.solve import Optimum, beside, relative_step, weighed_as
from calib.model.result_parts import COVERAGE, GIMBAL_SCALE, PASSPORT

#: Halvings of an interval until its half width is known to 1e-9 of the widest.
_HALVINGS = 30
_PAIRS, _FAULT_PAIRS = 12, 4
#: A mode of a smaller share stands for all amplitudes about it.
_SMALL_SHARE = 0.01
#: A fault is followed if its evidence may reach that of no fault within this logarithm.
_FOLLOWED = 2.0
#: The other meaning of a certificate is followed down to odds of 1 to 400.
_FOLLOWED_MEANING = 6.0
_FAULT_STEPS = 20
#: No evidence is larger than this logarithm, so that the odds of several faults stay numbers.
_LARGEST_LOG = 100.0
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
#: Nodes whose fx is known only to this many U count half in the variances.
_FAR = 2.0
#: What one source states can be wrong together, with this share of the probability of a single fault.
_TOGETHER = {GIMBAL_SCALE: 1.0, PASSPORT: 0.1}
#: Within this number of sigma of the others, a fault is at most 1.25 times more probable than it was: 0.5 %.
_AGREES = 1.5


@dataclass(frozen=True)
class Innovation:
    """What a statement says against what all others say."""

    name: str
    statement: Statement
    expected: Array  # (k,) by all others
    sigma: Array  # (k,) of that
    normalised: float  # Stated minus expected over its sigma; root mean square for a joint statement
    probability: float = 0.0  # That the statement is at fault


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
    def counted(self) -> Array:
        """(K,) weights for means and variances: nodes that lie far beyond U of fx lose theirs.

        An improbable fault of a statement can be so wide that it makes nearly all of the variance, but little of U.
        """
        row = np.eye(1, self.means.shape[1])[0]
        away = (self.means - self.weights @ self.means) @ row
        within = np.array([own[0, 0] for own in self.covariances])
        share = np.sqrt(within + away**2) / (_FAR * self._half_width(row, self.weights @ self.means))
        weights = self.weights / (1.0 + share**4)
        return np.asarray(weights / weights.sum())

    @cached_property
    def mean(self) -> Array:
        """(S,) mean of the shared unknowns."""
        return np.asarray(self.counted @ self.means)

    @cached_property
    def covariance(self) -> Array:
        """(S, S) covariance of the shared unknowns."""
        away = self.means - self.mean
        within = sum(weight * own for weight, own in zip(self.counted, self.covariances, strict=True))
        return np.asarray(within + (self.counted[:, None] * away).T @ away)

    def expanded(self, row: Array) -> float:
        """Return the half width of the interval that covers 95.45 % of the function with the (S,) gradient row."""
        return self._half_width(row, self.mean)

    def _half_width(self, row: Array, mean: Array) -> float:
        at = np.flatnonzero(row)
        away = (self.means[:, at] - mean[at]) @ row[at]
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
        found = _innovations(self.largest.solution)
        found += [self.denied] if self.denied else []
        return [replace(one, probability=self.faults.get(one.name, 0.0)) for one in found]


def _innovations(base: Solution) -> list[Innovation]:
    """Compare each statement with the posterior in which it counts as wrong.

    That is what all others say, and what would be known if nobody had stated it. The posterior in which all count as
    wrong is solved; what the others say is then added, which needs no difference of nearly equal numbers.
    """
    marginal, at_fault = base.marginal, dict(base.faults)
    witnesses = marginal.problem.knowledge.witnesses
    found = marginal.solve(base.eta, tuple((name, WRONG) for name in witnesses))
    statements = [one.as_meant(at_fault.get(name, "")) for name, one in witnesses.items()]
    rows = np.concatenate([one.rows for one in statements])
    values = np.concatenate([one.values for one in statements])
    root = found.root @ rows.T
    covariance, away = root.T @ root, values - rows @ (marginal.state.shared + found.step)
    more = [
        one.information(at_fault.get(one.name, "")) - one.information(WRONG) for one in witnesses.values()
    ]
    answer, end = [], 0
    for k, one in enumerate(statements):
        own = slice(end, end := end + len(one.values))
        others = block_diagonal([*more[:k], np.zeros_like(more[k]), *more[k + 1 :]])
        follow = np.linalg.solve(np.eye(len(rows)) + covariance @ others, np.column_stack([covariance, away]))
        spread, off = follow[own, own], follow[own, -1]
        z = float(np.sqrt(off @ np.linalg.solve(one.covariance + spread, off) / len(off)))
        z *= float(np.sign(off[0])) if len(off) == 1 else 1.0
        answer.append(Innovation(one.name, one, one.values - off, np.sqrt(np.diag(spread)), z))
    return answer


def posterior(optimum: Optimum, rounds: int, *, follow: bool = True) -> Posterior:
    """Return the posterior about an optimum, or about the most probable faults if these lead far away from it.

    The equations at the state that such faults lead to say how much they count; the search of that state takes at most
    ``rounds`` linearisations. They do not count if these equations lead far away again, or if ``follow`` is false.
    """
    curvature, modes = _modes(optimum)
    far = [bool(one.faults) and not _holds(optimum, one) for one in modes]
    near = [one for one, away in zip(modes, far, strict=True) if not away]
    likeliest = max((one for one, away in zip(modes, far, strict=True) if away), key=_by_weight, default=None)
    if likeliest is None or likeliest.weight < _COUNTS:
        return _mixture(optimum, curvature, modes)
    if not follow:
        return _mixture(optimum, curvature, near)
    try:
        there = beside(optimum, likeliest.faults, rounds)
        odds = odds_of(there, likeliest.faults, optimum)
    except (NotConverged, np.linalg.LinAlgError):  # without the statement nothing determines the camera
        return _mixture(optimum, curvature, near)
    if odds > 1.0 and likeliest.weight > max(one.weight for one in near):
        curvature_there, modes_there = _modes(there)
        near_there = [one for one in modes_there if _holds(there, one)]
        if near_there:
            others = _also(there, modes_there, near, likeliest.faults, odds)
            return _mixture(there, curvature_there, [*near_there, *others])
        odds = 0.0
    share = min(odds / likeliest.weight, 1.0)
    kept = [
        replace(one, weight=share * one.weight) if away else one for one, away in zip(modes, far, strict=True)
    ]
    return _mixture(optimum, curvature, kept)


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
    log = 0.5 * (than.solution.value - found.value) * _share_of_stars(found)
    return math.exp(min(log, _LARGEST_LOG)) * math.prod(ODDS[fault] for _, fault in faults)


def _holds(optimum: Optimum, mode: Node) -> bool:
    """Return whether the step to a mode is so short that the equations hold there."""
    return relative_step(optimum.marginal, mode.solution.step) < _NEAR


def _by_weight(mode: Node) -> float:
    return mode.weight


def _modes(optimum: Optimum) -> tuple[Array, list[Node]]:
    """Return (A, A) the curvature at an optimum, and the modes of the posterior by its equations."""
    curvature = 0.5 * expected_curvature(optimum.solution)
    first = Node(optimum.solution, 1.0)
    return curvature, [first, *_others(optimum, curvature), *_faults(optimum, curvature, first)]


def probable_faults(optimum: Optimum, *, relative: bool = False) -> dict[str, float]:
    """Return the probability of a fault of each statement at an optimum, and under the empty name that of none.

    ``relative``: weights against none instead, and under the empty name their sum with that of none.
    """
    modes = _modes(optimum)[1]
    whole = sum(mode.weight for mode in modes)
    found = {"": whole} if relative else {"": sum(mode.weight for mode in modes if not mode.faults) / whole}
    for mode in modes:
        for name, fault in mode.faults:
            if fault != FOCAL:
                found[name] = found.get(name, 0.0) + mode.weight / (1.0 if relative else whole)
    return found


def _mixture(optimum: Optimum, curvature: Array, modes: Sequence[Node]) -> Posterior:
    lower: Array = np.asarray(np.linalg.cholesky(curvature), np.float64)
    whole = sum(mode.weight for mode in modes)
    nodes: list[Node] = []
    probabilities: dict[str, float] = {}
    for mode in modes:
        share = mode.weight / whole
        if share < _SMALL_SHARE:
            nodes.append(replace(mode, weight=share))
        else:
            nodes += nodes_about(mode, lower, _FAULT_PAIRS if mode.faults else _PAIRS, share)
        for name in (name for name, fault in mode.faults if fault != FOCAL):
            probabilities[name] = probabilities.get(name, 0.0) + share
    spread = np.sqrt(np.diag(np.linalg.inv(curvature)))
    return Posterior(optimum, tuple(nodes), spread, probabilities, max(modes, key=_by_weight))


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
    follows = _usual(optimum)
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
    return float(np.exp(min(log_odds(one, other, 0.5 * wider), _LARGEST_LOG)))


def _faults(optimum: Optimum, curvature: Array, base: Node) -> list[Node]:
    """Return the faults beside those of a mode that the views make more probable than they were.

    If one is more probable than none, it may not be the only one: others are looked for beside it.
    """
    marginal, found = optimum.marginal, []
    starts = _starts(optimum, base)
    possible = _possible(starts)
    # Without a fault, and where the search of the state did not let the amplitudes go as far as they would.
    behind, known = base.solution, 2.0 * curvature
    if possible:
        at_optimum = base.eta is optimum.eta
        behind = best_amplitudes(behind, _FAULT_STEPS, curvature=known if at_optimum else None)
    none = max(0.0, log_odds(behind, base.solution))
    for more, probability in possible:
        faults: Faults = (*base.faults, *more)
        is_meaning = more[0][1] == FOCAL
        start = min((marginal.solve(one.eta, faults) for one in starts), key=lambda one: one.value)
        gain = 0.25 * float(start.gradient @ np.linalg.solve(curvature, start.gradient))
        loss = 0.5 * (start.value - base.solution.value) + none - gain
        if loss > (_FOLLOWED_MEANING if is_meaning else _FOLLOWED):
            continue
        at_optimum = start.eta is optimum.eta
        ended = best_amplitudes(start, _FAULT_STEPS, enough=ROUGH, curvature=known if at_optimum else None)
        log = 0.5 * (base.solution.value - ended.value) - none
        log *= _share_of_stars(ended)
        log += math.log(trusted(ended, base.solution))
        raised = math.exp(min(log, _LARGEST_LOG)) - (not is_meaning)
        if raised > 0.0:
            found.append(Node(ended, base.weight * probability * raised))
    likeliest = max(found, key=_by_weight, default=base)
    beside = _faults(optimum, curvature, likeliest) if likeliest.weight > base.weight else []
    return [*found, *beside]


def _share_of_stars(found: Solution) -> float:
    """Return the share of evidence against statements that counts: places of pupils may be the cause of the rest."""
    problem = found.marginal.problem
    if problem.pupils is None:
        return 1.0
    places, witnesses = spread_by_fields(found), problem.knowledge.witnesses
    rows = np.concatenate([witnesses[name].rows for name, _ in found.faults])
    stars, discs = (float(((rows @ one) * rows).sum()) for one in (found.covariance, places))
    return stars / (stars + discs)


def _starts(optimum: Optimum, base: Node) -> list[Solution]:
    """Return the solutions at which faults are looked for.

    They are those for the best amplitudes, for usual ones, and for those of the fault whose state the optimum has.
    Amplitudes that do not determine all unknowns are left out.
    """
    found = [base.solution]
    for eta in (_usual(optimum), optimum.fault_eta):
        with suppress(np.linalg.LinAlgError):
            found += [] if eta is None else [optimum.marginal.solve(eta, base.faults)]
    return found


def _usual(optimum: Optimum) -> Array:
    """Return the amplitudes with those of the collimator as they are expected.

    A wrong statement makes the errors of the collimator look large, and then hardly contradicts the others.
    """
    hyper = optimum.marginal.problem.hyper
    kept = hyper.places((amp.STAR, amp.READING, *amp.POSE))
    eta = hyper.mean.copy()
    eta[kept] = optimum.eta[kept]
    return eta


def _possible(starts: Sequence[Solution]) -> list[tuple[Faults, float]]:
    """Return the faults of statements that contradict all others, at one of the given solutions at least.

    Each has its probability beforehand. What a certificate means is always open.
    One source states the scales of all axes, so they can be wrong together. So can all that a passport says of a glass:
    if it is another one, its radius is as unknown as what shows this. A reticle moves more often.
    """
    at_fault = dict(starts[0].faults)
    away = {one.name for start in starts for one in _innovations(start) if abs(one.normalised) > _AGREES}
    witnesses = starts[0].marginal.problem.knowledge.witnesses
    undoubted = [one for name, one in witnesses.items() if name not in at_fault]
    doubted = [one.name for one in undoubted if one.name in away]
    sources = {group: tuple(one.name for one in undoubted if one.group == group) for group in _TOGETHER}
    together = [(names, _TOGETHER[group]) for group, names in sources.items() if len(names) > 1 and doubted]
    meant = [one.name for one in undoubted if one.focal is not None]
    return [
        *((((name, FOCAL),), ODDS[FOCAL]) for name in meant),
        *(
            (tuple((name, fault) for name in names), usual * probability)
            for names, usual in [*(((name,), 1.0) for name in doubted), *together]
            for fault, probability in FAULTS.items()
        ),
    ]
