"""The mixture: amplitudes by cubature, hypotheses by their evidence; value, u and U of anything linear."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from calib.arrays import Array

from . import amplitudes as amp
from .hypotheses import AS_IT_STANDS, FOCAL, WRONG, Hypothesis, hypotheses
from .problem import Problem
from .search import Optimum, best_amplitudes
from .solution import Solution, expected_curvature, otherwise, solve
from .uncertainty import expanded

#: Amplitudes that may have two optima: they move the principal point. Another is looked for from so many 1-sigma on the
#: other side of what is expected; two are so far apart at least, and their values no farther than the third number.
_TWOFOLD, _OTHER, _APART, _NEAR = (amp.PRISM, amp.TANGENTIAL), 1.5, 0.7, 8.0
#: Logarithms by which that of the curvature begins smaller there, and that of the parallax larger.
_LOWER, _HIGHER = 2.5, 1.0
#: The equations hold for steps of this share of focal length and radius.
_HOLDS = 0.02
#: A hypothesis below this logarithm of its odds is not searched for its best amplitudes; steps of that search.
_SEARCHED, _STEPS = -3.5, 8
#: It is searched, too, if all others are so many sigma from a wrong statement: with it, the amplitudes took it up.
_CONTRADICTED = 2.0
#: A hypothesis leads elsewhere if the equations hold less than this there; it may count from this logarithm of its odds
#: against the likeliest on.
_FAR, _PROMISING = 0.5, -3.0
#: A component of this share has its amplitudes sampled; one of less than the second adds nothing.
_SAMPLED, _LEAST = 0.05, 1e-5
#: They are sampled along so many directions: U of 60 samples along all of them scatters by 7 % as well.
_DIRECTIONS = 6
#: No sample counts more than e times the usual one.
_LARGEST_LOG = 1.0


@dataclass(frozen=True)
class Component:
    """A Gaussian of the mixture: the solution for some amplitudes, by one hypothesis."""

    weight: float
    solution: Solution
    hypothesis: Hypothesis


@dataclass(frozen=True)
class Posterior:
    """The mixture of all components; they share the unknowns of one problem."""

    components: tuple[Component, ...]
    odds: dict[Hypothesis, float]  # Probability of each hypothesis
    spread: Array  # (A,) 1-sigma of the logarithms of the amplitudes
    optimum: Optimum
    log_odds: float  # Logarithm of the evidence of all hypotheses, over that of the optimum
    elsewhere: Solution | None = (
        None  # A hypothesis that may count, and leads where these equations do not hold
    )

    @property
    def problem(self) -> Problem:
        """The problem."""
        return self.optimum.solution.problem

    @cached_property
    def largest(self) -> Component:
        """The component at the mode of the most probable hypothesis."""
        best = max(self.odds.items(), key=lambda pair: pair[1])[0]
        return next(one for one in self.components if one.hypothesis == best)

    @cached_property
    def weights(self) -> Array:
        """(K,) weights of the components."""
        weights = np.array([component.weight for component in self.components])
        return np.asarray(weights / weights.sum())

    @cached_property
    def means(self) -> Array:
        """(K, S) their means."""
        return np.array([component.solution.mean for component in self.components])

    @cached_property
    def mean(self) -> Array:
        """(S,) mean of the shared unknowns."""
        return np.asarray(self.weights @ self.means)

    @cached_property
    def covariance(self) -> Array:
        """(S, S) covariance of the shared unknowns."""
        away = self.means - self.mean
        within = sum(
            weight * component.solution.covariance
            for weight, component in zip(self.weights, self.components, strict=True)
        )
        return np.asarray(within + (self.weights[:, None] * away).T @ away)

    def expanded(self, row: Array) -> float:
        """Return the expanded uncertainty of the quantity with the (S,) gradient row."""
        variances = [row @ component.solution.covariance @ row for component in self.components]
        return expanded(self.weights, self.means @ row, np.sqrt(np.maximum(variances, 0.0)))


def trusted(there: Solution, other: Solution) -> float:
    """Return the weight, 0 to 1, that a solution keeps so far from another: the equations bend."""
    wide = there.problem.wide[[0, 5]]
    far = float(np.abs(wide @ (there.step - other.step)).max())
    return 1.0 / (1.0 + (far / _HOLDS) ** 4)


def modes(best: Solution) -> list[Solution]:
    """Return the best and other optima of the amplitudes at its equations that explain the stars nearly as well."""
    expected, found = best.problem.expected, [best]
    for eta in _starts_of_others(best):
        with suppress(np.linalg.LinAlgError):
            at = best_amplitudes(solve(best.equations, eta, best.wide))
            apart = min(float((np.abs(at.eta - other.eta) / expected.sigma).max()) for other in found)
            if apart > _APART and at.value < best.value + _NEAR:
                found.append(at)
    return found


def _starts_of_others(best: Solution) -> list[Array]:
    """Return the (A,) logarithms at which searches of other optima begin.

    What moves the principal point may be on the other side of what is expected. Where nothing bounds the parallax, it
    may take the place of field curvature.
    """
    expected, starts = best.problem.expected, list[Array]()
    for k in expected.places(_TWOFOLD).tolist():
        eta = best.eta.copy()
        side = np.sign(eta[k] - expected.mean[k])
        eta[k] = expected.mean[k] - side * _OTHER * expected.sigma[k]
        starts.append(eta)
    if amp.PARALLAX in expected.names:
        eta = best.eta.copy()
        eta[expected.at(amp.CURVATURE_TURN)] -= _LOWER
        eta[expected.at(amp.PARALLAX)] += _HIGHER
        starts.append(eta)
    return starts


@dataclass(frozen=True)
class _Mode:
    """An optimum of the amplitudes by one hypothesis."""

    log: float  # Evidence
    solution: Solution
    hypothesis: Hypothesis
    root: Array  # (A, A) root of the covariance of the standardised logarithms


def posterior(optimum: Optimum) -> Posterior:
    """Return the mixture about an optimum."""
    found, far = list[_Mode](), list[_Weighed]()
    for solution in modes(optimum.solution):
        weighed = _by_hypotheses(solution)
        root, log_volume = _curvature(max(weighed, key=lambda one: one.log).solution)
        found += [_Mode(one.log + log_volume, one.solution, one.hypothesis, root) for one in weighed]
        far += [one for one in weighed if one.holds < _FAR]
    whole = float(np.logaddexp.reduce([mode.log for mode in found]))
    components, odds = list[Component](), dict[Hypothesis, float]()
    for mode in found:
        share = float(np.exp(mode.log - whole))
        odds[mode.hypothesis] = odds.get(mode.hypothesis, 0.0) + share
        if share > _SAMPLED:
            components += _sampled(mode, share)
        elif share > _LEAST:
            components.append(Component(share, mode.solution, mode.hypothesis))
    likeliest = max(found, key=lambda mode: mode.log)
    sigma = likeliest.solution.problem.expected.sigma
    spread = sigma * np.sqrt((likeliest.root**2).sum(axis=1))
    log_odds = whole + 0.5 * optimum.solution.value
    promising = max(far, key=lambda one: one.promised, default=None)
    counts = promising is not None and promising.promised - likeliest.log > _PROMISING
    elsewhere = promising.solution if promising is not None and counts else None
    return Posterior(tuple(components), odds, np.asarray(spread), optimum, log_odds, elsewhere)


@dataclass(frozen=True)
class _Weighed:
    """A hypothesis at an optimum."""

    hypothesis: Hypothesis
    solution: Solution
    promised: float  # Logarithm of the evidence, if the equations held
    holds: float  # How far they do, 0 to 1

    @property
    def log(self) -> float:
        """Logarithm of the evidence as far as the equations hold."""
        return self.promised + float(np.log(max(self.holds, 1e-300)))


def _by_hypotheses(first: Solution) -> list[_Weighed]:
    """Return an optimum by each hypothesis; by others once more beside those that are more probable, the best first."""
    usual = solve(first.equations, _usual(first), first.wide)
    weighed = {AS_IT_STANDS: _weighed(first, usual, AS_IT_STANDS, -np.inf)}
    best, alone, open_ones = weighed[AS_IT_STANDS].log, hypotheses(first.problem.unknowns), [AS_IT_STANDS]
    while open_ones:
        beside = max(open_ones, key=lambda one: weighed[one].log)
        open_ones.remove(beside)
        if weighed[beside].log < best + _PROMISING:
            break
        for one in alone:
            both = beside.beside(one)
            if both is None or both in weighed:
                continue
            weighed[both] = _weighed(first, usual, both, best)
            best = max(best, weighed[both].log)
            if weighed[both].log > weighed[beside].log:
                open_ones.append(both)
    return list(weighed.values())


def _weighed(first: Solution, usual: Solution, hypothesis: Hypothesis, best: float) -> _Weighed:
    """Weigh a hypothesis at an optimum, or at usual amplitudes; with its best ones if it may count beside the best."""
    try:
        at = first
        if hypothesis.wide != first.wide:
            wrong = any(fault in (WRONG, FOCAL) for _, fault in hypothesis.faults)
            tried = [first, usual] if wrong else [first]
            solutions = [otherwise(solution, hypothesis.wide) for solution in tried]
            at = min(solutions, key=lambda solution: solution.value)
            if hypothesis.log_odds - 0.5 * at.value > best + _SEARCHED:
                at = best_amplitudes(at, _STEPS)
            elif len(hypothesis.faults) == 1 and wrong and _contradicts(at, hypothesis):
                at = min((best_amplitudes(one, _STEPS) for one in solutions), key=lambda one: one.value)
    except np.linalg.LinAlgError:  # without the statement nothing determines all unknowns
        return _Weighed(hypothesis, first, -np.inf, 0.0)
    return _Weighed(hypothesis, at, hypothesis.log_odds - 0.5 * at.value, trusted(at, first))


def _contradicts(there: Solution, hypothesis: Hypothesis) -> bool:
    """Return whether all others contradict a statement if it is wrong."""
    at = list(hypothesis.wide)
    away = there.mean[at] - there.problem.unknowns.mean[at]
    return bool((np.abs(away) > _CONTRADICTED * np.sqrt(np.diag(there.covariance)[at])).any())


def _usual(first: Solution) -> Array:
    """Return the amplitudes with those of the collimator as they are expected.

    A wrong statement has made them look large, and is then hardly contradicted.
    """
    expected = first.problem.expected
    kept = expected.places((amp.STAR, amp.READING, *amp.POSE))
    eta = expected.mean.copy()
    eta[kept] = first.eta[kept]
    return eta


def _curvature(solution: Solution) -> tuple[Array, float]:
    """Return the root of the covariance of the standardised logarithms, and the logarithm of its volume."""
    sigma = solution.problem.expected.sigma
    sizes, axes = np.linalg.eigh(0.5 * expected_curvature(solution) * np.outer(sigma, sigma))
    sizes = np.maximum(sizes, amp.REACH**-2)  # points without errors leave rounding in it
    return np.asarray(axes / np.sqrt(sizes)), -0.5 * float(np.log(sizes).sum())


@cache
def _turned(size: int) -> Array:
    """Return (D, D) orthonormal directions, none of them along an axis."""
    return np.asarray(np.linalg.qr(np.random.default_rng(0).standard_normal((size, size)))[0])


def _directions(solution: Solution, root: Array) -> Array:
    """Return (D, A) orthonormal directions in which fx, fy, cx, cy and their uncertainty change most.

    All others change them little, and stay as they are at the mode. ``root``: of the covariance of the logarithms.
    """
    camera = np.eye(4, len(solution.step))
    effects = np.concatenate(solution.by_amplitudes(camera)) @ root
    most = np.linalg.svd(effects, full_matrices=False)[2][:_DIRECTIONS]
    return np.asarray(_turned(len(most)) @ most)


def _sampled(mode: _Mode, share: float) -> list[Component]:
    """Return components about a mode: spherical cubature of third degree, weighed by their likelihood.

    Arasaratnam and Haykin (2009). All samples lie at the distance sqrt(D), as most of a Gaussian does.
    """
    solution, expected = mode.solution, mode.solution.problem.expected
    low, high = expected.bounds
    solutions, logs = [solution], [0.0]
    root = expected.sigma[:, None] * mode.root
    directions = _directions(solution, root)
    size = len(directions)
    for direction in (*directions, *-directions):
        eta = solution.eta + np.sqrt(size) * (root @ direction)
        with suppress(np.linalg.LinAlgError):
            at = solve(solution.equations, np.clip(eta, low, high), solution.wide)
            gain = 0.5 * (solution.value - at.value) + 0.5 * size
            solutions.append(at)
            logs.append(min(gain, _LARGEST_LOG) + float(np.log(trusted(at, solution))))
    logs[0] = float(np.median(logs[1:])) if len(logs) > 1 else 0.0
    weights = np.exp(np.array(logs) - max(logs))
    weights *= share / weights.sum()
    return [
        Component(weight, at, mode.hypothesis) for weight, at in zip(weights.tolist(), solutions, strict=True)
    ]
