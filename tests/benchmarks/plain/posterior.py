"""The mixture: amplitudes by cubature, hypotheses by their evidence; value, u and U of anything linear."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from calib.arrays import Array

from . import amplitudes as amp
from .hypotheses import AS_IT_STANDS, WRONG, Hypothesis, hypotheses
from .problem import Problem
from .search import Optimum, best_amplitudes
from .solution import Solution, expected_curvature, solve
from .uncertainty import expanded

#: Amplitudes that may have two optima: they move the principal point. Another is looked for from so many 1-sigma on the
#: other side of what is expected; two are so far apart at least, and their values no farther than the third number.
_TWOFOLD, _OTHER, _APART, _NEAR = (amp.PRISM, amp.TANGENTIAL), 1.5, 0.7, 8.0
#: The equations hold for steps of this share of focal length and radius.
_HOLDS = 0.02
#: A hypothesis below this logarithm of its odds is not searched for its best amplitudes; steps of that search.
_SEARCHED, _STEPS = -3.5, 8
#: A hypothesis leads elsewhere if the equations hold less than this there; it may count from this logarithm of its odds
#: against the likeliest on.
_FAR, _PROMISING = 0.5, -3.0
#: A component of this share has its amplitudes sampled along few directions; one of the second along all; one of less
#: than the last adds nothing.
_SAMPLED, _MAIN, _LEAST = 0.05, 0.4, 1e-5
_FEW = 5
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
    for k in expected.places(_TWOFOLD).tolist():
        eta = best.eta.copy()
        side = np.sign(eta[k] - expected.mean[k])
        eta[k] = expected.mean[k] - side * _OTHER * expected.sigma[k]
        with suppress(np.linalg.LinAlgError):
            at = best_amplitudes(solve(best.equations, eta, best.wide))
            apart = min(float((np.abs(at.eta - other.eta) / expected.sigma).max()) for other in found)
            if apart > _APART and at.value < best.value + _NEAR:
                found.append(at)
    return found


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
            components += _sampled(mode, share, len(mode.solution.eta) if share > _MAIN else _FEW)
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
    """Return an optimum by each hypothesis; by others once more beside those more probable than all as stated."""
    stands = _weighed(first, AS_IT_STANDS)
    weighed, alone, open_ones = {AS_IT_STANDS: stands}, hypotheses(first.problem.unknowns), [AS_IT_STANDS]
    while open_ones:
        beside = open_ones.pop()
        for one in alone:
            both = beside.beside(one)
            if both is None or both in weighed:
                continue
            weighed[both] = _weighed(first, both)
            if weighed[both].log > stands.log:
                open_ones.append(both)
    return list(weighed.values())


def _weighed(first: Solution, hypothesis: Hypothesis) -> _Weighed:
    """Weigh a hypothesis at an optimum, with its best amplitudes if it may count."""
    try:
        at = first
        if hypothesis.wide != first.wide:
            tried = (
                [first.eta, _usual(first)] if any(f == WRONG for _, f in hypothesis.faults) else [first.eta]
            )
            solutions = [solve(first.equations, eta, hypothesis.wide) for eta in tried]
            at = min(solutions, key=lambda solution: solution.value)
            if 0.5 * (first.value - at.value) + hypothesis.log_odds > _SEARCHED:
                at = best_amplitudes(at, _STEPS)
    except np.linalg.LinAlgError:  # without the statement nothing determines all unknowns
        return _Weighed(hypothesis, first, -np.inf, 0.0)
    return _Weighed(hypothesis, at, hypothesis.log_odds - 0.5 * at.value, trusted(at, first))


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
    return np.asarray(axes / np.sqrt(sizes)), -0.5 * float(np.log(sizes).sum())


@cache
def _directions(size: int) -> Array:
    """Return (A, A) orthonormal directions."""
    return np.asarray(np.linalg.qr(np.random.default_rng(0).standard_normal((size, size)))[0])


def _sampled(mode: _Mode, share: float, pairs: int) -> list[Component]:
    """Return components about a mode: spherical cubature of third degree, weighed by their likelihood.

    Arasaratnam and Haykin (2009). All samples lie at the distance sqrt(A), as most of a Gaussian does.
    """
    solution, expected, size = mode.solution, mode.solution.problem.expected, len(mode.solution.eta)
    low, high = expected.bounds
    solutions, logs = [solution], [0.0]
    turn = _directions(size)[:pairs]
    for direction in (*turn, *-turn):
        eta = solution.eta + np.sqrt(size) * expected.sigma * (mode.root @ direction)
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
