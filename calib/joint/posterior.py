"""The posterior: a mixture over the amplitudes and over faults of statements.

For given amplitudes the posterior is Gaussian (`calib.joint.marginal`). The amplitudes are known only so well, so the
result is the mixture over their posterior: importance sampling about each mode, with fixed normal deviates, so that the
result follows the data without steps. A statement may be at fault: each fault has a small probability beforehand, and
counts by what the views add to it. If two statements contradict each other and nothing decides, the mixture covers
both.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib.joint.knowledge import FAULTS, Statement
from calib.joint.marginal import NO_FAULT, Faults, Marginal, Solution
from calib.joint.solve import Optimum, best_amplitudes

Array = NDArray[np.float64]

#: Share of the posterior that an expanded uncertainty covers (JCGM 100:2008, 6.2.1, for k = 2).
COVERAGE = 0.9545
_PAIRS = 12
#: Normal deviates are stretched by this, so that the samples reach the tails.
_STRETCH = 1.2
#: No sample counts more than this many times the median one.
_LARGEST_WEIGHT = 10.0
_DIFFERENCE = 0.05
#: Smallest curvature of an amplitude: beyond it the quadratic approximation says nothing.
_LEAST_CURVATURE = 0.1
#: A fault is followed if its evidence may reach that of no fault within this logarithm.
_FOLLOWED = 2.0
_FAULT_STEPS = 40


@dataclass(frozen=True)
class Node:
    """The Gaussian posterior at one sample of the amplitudes."""

    weight: float
    eta: Array
    faults: Faults
    solution: Solution


@dataclass(frozen=True)
class Innovation:
    """What a statement says against what all others say."""

    name: str
    statement: Statement
    expected: Array  # (k,) by all others
    sigma: Array  # (k,) of that
    normalised: float  # Stated minus expected over its sigma; root mean square for a joint statement
    probability: float  # That the statement is at fault


@dataclass(frozen=True)
class Posterior:
    """The mixture."""

    optimum: Optimum
    nodes: tuple[Node, ...]
    spread: Array  # (A,) 1-sigma of the logarithms of the amplitudes
    faults: dict[str, float]  # Probability of a fault by name of the statement

    @cached_property
    def weights(self) -> Array:
        """(K,) weights of the nodes."""
        return np.array([node.weight for node in self.nodes])

    @cached_property
    def means(self) -> Array:
        """(K, S) means of the shared unknowns."""
        return self.optimum.state.shared + np.array([node.solution.step for node in self.nodes])

    @cached_property
    def mean(self) -> Array:
        """(S,) mean of the shared unknowns."""
        return np.asarray(self.weights @ self.means)

    @cached_property
    def covariance(self) -> Array:
        """(S, S) covariance of the shared unknowns."""
        away = self.means - self.mean
        within = sum(node.weight * node.solution.covariance for node in self.nodes)
        return np.asarray(within + (self.weights[:, None] * away).T @ away)

    def expanded(self, row: Array) -> float:
        """Return the half width of the interval about the mean that covers 95.45 % of a linear function.

        row: (S,) gradient of the function.
        """
        from scipy.optimize import brentq
        from scipy.special import ndtr

        away = (self.means - self.mean) @ row
        sigmas = np.sqrt([row @ node.solution.covariance @ row for node in self.nodes])

        def missing(half: float) -> float:
            inside = ndtr((half - away) / sigmas) - ndtr((-half - away) / sigmas)
            return float(self.weights @ inside) - COVERAGE

        widest = float((np.abs(away) + 6.0 * sigmas).max())
        return float(brentq(missing, 0.0, widest, xtol=1e-6 * widest))

    def innovations(self) -> list[Innovation]:
        """Return the innovation of every statement that could be wrong, at the mode, in closed form."""
        solution, marginal = self.optimum.solution, self.optimum.marginal
        b = self.optimum.state.shared + solution.step
        found = []
        for name, one in marginal.problem.knowledge.witnesses.items():
            own = one.rows @ solution.covariance @ one.rows.T
            left = one.covariance - own  # covariance of stated minus estimated
            off = one.values - one.rows @ b
            values, vectors = np.linalg.eigh(left)
            floor = 1e-9 * float(np.trace(one.covariance))
            inverse = (vectors / np.maximum(values, floor)) @ vectors.T
            gain = one.covariance @ inverse
            others = one.values - gain @ off
            sigma = np.sqrt(np.maximum(np.diag(gain @ one.covariance - one.covariance), 0.0))
            z = float(np.sqrt(max(off @ inverse @ off, 0.0) / len(off)))
            z *= float(np.sign(off[0])) if len(off) == 1 else 1.0
            found.append(Innovation(name, one, others, sigma, z, self.faults.get(name, 0.0)))
        return found


def posterior(optimum: Optimum) -> Posterior:
    """Return the posterior about an optimum."""
    marginal = optimum.marginal
    curvature = _curvature(marginal, optimum.eta, optimum.solution.gradient)
    lower: Array = np.asarray(np.linalg.cholesky(curvature), np.float64)
    modes = [(NO_FAULT, optimum.eta, optimum.solution, 1.0), *_faults(optimum, curvature)]
    whole = sum(weight for *_, weight in modes)
    nodes: list[Node] = []
    probabilities: dict[str, float] = {}
    for faults, eta, solution, weight in modes:
        share = weight / whole
        nodes += _samples(marginal, eta, solution, lower, faults, share)
        for name, _ in faults:
            probabilities[name] = probabilities.get(name, 0.0) + share
    spread = np.sqrt(np.diag(np.linalg.inv(curvature)))
    return Posterior(optimum, tuple(nodes), spread, probabilities)


def _curvature(marginal: Marginal, eta: Array, gradient: Array) -> Array:
    """Return the (A, A) curvature of minus the logarithm of the density, from differences of its gradient.

    Directions along which it is too small get a least curvature.
    """
    ahead = np.array([marginal.solve(eta + step).gradient for step in _DIFFERENCE * np.eye(len(eta))])
    rows = (ahead - gradient) / (2.0 * _DIFFERENCE)
    whole = 0.5 * (rows + rows.T)
    values, vectors = np.linalg.eigh(whole)
    return np.asarray((vectors * np.maximum(values, _LEAST_CURVATURE)) @ vectors.T)


def _samples(
    marginal: Marginal, eta: Array, solution: Solution, lower: Array, faults: Faults, share: float
) -> list[Node]:
    """Return the nodes about one mode; their weights add up to its share."""
    deviates = _STRETCH * np.random.default_rng(0).standard_normal((_PAIRS, len(eta)))
    found, logs = [(eta, solution)], [0.0]
    for z in np.concatenate([deviates, -deviates]):
        at = eta + np.linalg.solve(lower.T, z)
        try:
            one = marginal.solve(at, faults, slope=False)
        except np.linalg.LinAlgError:
            continue
        found.append((at, one))
        logs.append(0.5 * (solution.value - one.value) + 0.5 * float(z @ z) / _STRETCH**2)
    weights = np.exp(np.array(logs) - max(logs))
    weights = np.minimum(weights, _LARGEST_WEIGHT * np.median(weights))
    weights *= share / weights.sum()
    return [Node(float(w), at, faults, one) for w, (at, one) in zip(weights, found, strict=True)]


def _faults(optimum: Optimum, curvature: Array) -> list[tuple[Faults, Array, Solution, float]]:
    """Return the faults that the views make more probable than they were: amplitudes, solution, odds against none."""
    marginal, found = optimum.marginal, []
    for name in marginal.problem.knowledge.witnesses:
        for fault, probability in FAULTS.items():
            faults: Faults = ((name, fault),)
            try:
                start = marginal.solve(optimum.eta, faults)
            except np.linalg.LinAlgError:
                continue
            gain = 0.25 * float(start.gradient @ np.linalg.solve(curvature, start.gradient))
            if 0.5 * (start.value - optimum.solution.value) - gain > _FOLLOWED:
                continue
            eta = best_amplitudes(marginal, optimum.eta, _FAULT_STEPS, faults)
            ended = marginal.solve(eta, faults, slope=False)
            evidence = float(np.exp(min(0.5 * (optimum.solution.value - ended.value), 500.0)))
            if evidence > 1.0:
                found.append((faults, eta, ended, probability * (evidence - 1.0)))
    return found


def amplitude_table(posterior: Posterior) -> dict[str, tuple[float, float]]:
    """Return by name each amplitude at the mode, and the 1-sigma of its logarithm."""
    names = posterior.optimum.marginal.problem.hyper.names
    pairs = zip(np.exp(posterior.optimum.eta).tolist(), posterior.spread.tolist(), strict=True)
    return dict(zip(names, pairs, strict=True))
