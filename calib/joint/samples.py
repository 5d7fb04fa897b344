"""Samples of the amplitudes about a mode of their posterior, for the mixture over them.

In standardised logarithms the posterior about a mode is nearly a normal distribution of many dimensions. The camera's
posterior changes along few of them. Along these, the samples lie at the quantiles of a normal distribution (a Latin
hypercube; McKay, Beckman and Conover, 1979); along all others together at their root mean square distance. Nothing is
drawn at random, so that the result follows the data without steps.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from statistics import NormalDist

import numpy as np

from calib.arrays import Array
from calib.joint import amplitudes as amp
from calib.joint.marginal import Solution
from calib.joint.prior import Faults
from calib.joint.solve import TRUSTED, relative_step

#: Quantities whose variances say which directions of the logarithms matter.
_QUANTITIES = ("fx", "cx", "cy")
_DIRECTIONS = len(_QUANTITIES)
#: Along these directions, the samples are stretched by this, so that they reach the tails.
_STRETCH = 1.2
#: No sample counts more than this many times the median one.
LARGEST_WEIGHT = 10.0


@dataclass(frozen=True)
class Node:
    """The Gaussian posterior for given amplitudes: at a mode of their posterior, or at a sample about it."""

    solution: Solution
    weight: float  # Of a mode, its odds against the first one

    @property
    def faults(self) -> Faults:
        """The faults of statements."""
        return self.solution.faults

    @property
    def eta(self) -> Array:
        """(A,) logarithms of the amplitudes."""
        return self.solution.eta


def nodes_about(mode: Node, lower: Array, pairs: int, share: float) -> list[Node]:
    """Return the nodes about a mode, twice ``pairs``, weights summing to ``share``; lower: L, L L^T the curvature."""
    eta, solution = mode.eta, mode.solution
    solutions, logs = [solution], [0.0]
    bounds = np.array(solution.marginal.problem.hyper.bounds).T
    main = _main_directions(solution, lower)
    for along, direction in _design(len(eta), pairs):
        across = direction - main @ (main.T @ direction)
        across *= np.sqrt(len(eta) - _DIRECTIONS) / np.linalg.norm(across)
        at = np.clip(eta + np.linalg.solve(lower.T, _STRETCH * main @ along + across), *bounds)
        try:
            sample = solution.marginal.solve(at, mode.faults)
        except np.linalg.LinAlgError:
            continue
        solutions.append(sample)
        distance_squared = float(along @ along) + float(across @ across)
        logs.append(log_odds(sample, solution, 0.5 * distance_squared))
    weights = np.exp(np.array(logs) - max(logs))
    weights = np.minimum(weights, LARGEST_WEIGHT * max(float(np.median(weights)), 1.0 / len(weights) ** 2))
    weights *= share / weights.sum()
    return [Node(sample, float(w)) for w, sample in zip(weights, solutions, strict=True)]


def log_odds(solution: Solution, other: Solution, more: float = 0.0) -> float:
    """Return the logarithm of the odds of a solution against another, and ``more``, as far as the equations hold.

    Where they do not, other amplitudes may promise any gain, so that it counts the less the farther the solution is.
    """
    share = trusted(solution, other)
    log = 0.5 * (other.value - solution.value) + more
    return log * (share if log > 0.0 else 1.0) + float(np.log(share))


def trusted(solution: Solution, other: Solution) -> float:
    """Return the weight, 0 to 1, that a solution keeps so far from another: half at twice what is trusted."""
    return float(
        1.0 / (1.0 + (relative_step(solution.marginal, solution.step - other.step) / (2.0 * TRUSTED)) ** 4)
    )


def _main_directions(solution: Solution, lower: Array) -> Array:
    """Return (A, D) orthonormal standardised directions along which the variances of the camera change."""
    problem, random, squares = solution.marginal.problem, solution.marginal.problem.random, solution.squares
    pulled = random.pulled(squares, solution.inside)
    scale = np.sqrt(problem.own_information(squares))
    columns = []
    for at in problem.bench.layout.places(_QUANTITIES):
        row = solution.covariance[at] / np.sqrt(solution.covariance[at, at])
        change = np.bincount(random.amplitudes, (row[random.places] @ pulled) ** 2, len(squares))
        own = ((scale * (solution.follow @ row)) ** 2).sum(axis=0)
        change += np.bincount(problem.pose_amplitudes, own, len(squares))
        change[problem.hyper.at(amp.READING)] += _by_readings(solution, row)
        columns.append(change)
    q, upper = np.linalg.qr(np.linalg.solve(lower, np.column_stack(columns)))
    return np.asarray(q * np.where(np.diag(upper) < 0.0, -1.0, 1.0))


def _by_readings(solution: Solution, row: Array) -> float:
    """Return the share of a variance that the readings make; row: (S,) covariance with the quantity, over its sigma."""
    marginal = solution.marginal
    if not marginal.uses_readings:
        return 0.0
    seen = marginal.reading_weights(solution.squares) * (solution.predicted @ row)
    return float((marginal.reading_variance(solution.squares) * seen**2).sum())


@cache
def _design(size: int, pairs: int) -> list[tuple[Array, Array]]:
    """Return for each sample its coordinates along the main directions, and another direction; in pairs."""
    rng = np.random.default_rng(0)
    normal = NormalDist()
    heights = np.array([normal.inv_cdf(0.5 + (k + 0.5) / (2 * pairs)) for k in range(pairs)])
    heights *= np.sqrt(pairs / (heights**2).sum())
    along = np.column_stack(
        [rng.permutation(heights) * rng.choice((-1.0, 1.0), pairs) for _ in range(_DIRECTIONS)]
    )
    others = np.linalg.qr(rng.standard_normal((size, size)))[0][:pairs]
    return [(sign * a, sign * b) for sign in (1.0, -1.0) for a, b in zip(along, others, strict=True)]
