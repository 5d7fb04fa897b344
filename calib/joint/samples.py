"""Samples of the amplitudes about a mode of their posterior, for the mixture over them.

In standardised logarithms the posterior about a mode is nearly a normal distribution. The samples are the points of a
spherical cubature of third degree (Arasaratnam and Haykin, 2009): all at the root mean square distance, so that mean
and covariance are exact. They change with the data without steps. Half as many, on one side each, leave twice the error
of U.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from calib.arrays import Array
from calib.joint.marginal import Solution
from calib.joint.prior import Faults
from calib.joint.solve import TRUSTED, relative_step

#: No sample counts more than this many times the median one.
_LARGEST_WEIGHT = 10.0


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


def nodes_about(
    mode: Node, lower: Array, share: float, odds: Callable[[Solution, Solution, float], float] = log_odds
) -> list[Node]:
    """Return the nodes about a mode, weights summing to ``share``; lower: (A, A) L, L L^T the curvature.

    Each counts by its ``odds`` against the mode, over those of the normal distribution.
    """
    eta, middle = mode.eta, mode.solution
    solutions, logs = [middle], [0.0]
    bounds = np.array(middle.marginal.problem.hyper.bounds).T
    for direction in np.linalg.solve(lower.T, _directions(len(eta)).T).T:
        try:
            sample = middle.marginal.solve(np.clip(eta + direction, *bounds), mode.faults)
        except np.linalg.LinAlgError:
            continue
        solutions.append(sample)
        logs.append(odds(sample, middle, 0.5 * len(eta)))
    weights = np.exp(np.array(logs) - max(logs))
    weights = np.minimum(weights, _LARGEST_WEIGHT * max(float(np.median(weights)), 1.0 / len(weights) ** 2))
    weights *= share / weights.sum()
    return [Node(sample, float(w)) for w, sample in zip(weights, solutions, strict=True)]


@cache
def _directions(size: int) -> Array:
    """Return (2 A, A) points of the cubature for a standard normal distribution.

    Their axes are turned at random: along those of the amplitudes, one would change far, and all others not.
    """
    turned = np.sqrt(size) * np.linalg.qr(np.random.default_rng(0).standard_normal((size, size)))[0]
    return np.concatenate([turned, -turned])
