"""The modes of the posterior by the equations of one optimum: of the amplitudes, and of doubted statements."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from calib.arrays import Array
from calib.joint import amplitudes as amp
from calib.joint.curvature import ROUGH, best_amplitudes, expected_curvature
from calib.joint.doubts import LARGEST_LOG, doubted, usual_amplitudes
from calib.joint.knowledge import FOCAL
from calib.joint.marginal import Solution
from calib.joint.prior import Faults
from calib.joint.samples import Node, log_odds
from calib.joint.solve import Optimum

#: A search of another mode starts with logarithms that are so much smaller, and larger, where the mode may differ.
_LOWER, _HIGHER = 2.5, 1.0
#: A mode is another one if it is so far away: a square, in sigmas. A search that comes nearer ends where the first did.
_APART = 2.0


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
    def log_odds(self) -> float:
        """Logarithm of the odds of all modes together against the first without doubts."""
        return math.log(sum(mode.weight for mode in self.nodes)) + self.scale

    def fault_probabilities(self, modes: Sequence[Node]) -> dict[str, float]:
        """Return by name of the statement how probable its fault is, by some of the modes or others."""
        whole, probabilities = sum(mode.weight for mode in modes), dict[str, float]()
        for mode in modes:
            weights = {mode.faults: mode.weight}
            if mode is self.likeliest:
                weights = {mode.faults: mode.weight - sum(self.alike.values()), **self.alike}
            for faults, weight in weights.items():
                for name in (name for name, doubt in faults if doubt != FOCAL):
                    probabilities[name] = probabilities.get(name, 0.0) + weight / whole
        return probabilities


def modes_of(optimum: Optimum) -> Modes:
    """Return the modes of the posterior by the equations of an optimum."""
    curvature = 0.5 * expected_curvature(optimum.solution)
    others = _others(optimum, curvature)
    doubts = doubted(optimum, curvature, others)
    nodes = [Node(optimum.solution, math.exp(-doubts.scale))]
    nodes += [replace(other, weight=other.weight * math.exp(-doubts.scale)) for other in others]
    nodes += doubts.nodes
    at = next((k for k, node in enumerate(nodes) if node.faults == doubts.likeliest), 0)
    nodes[at] = replace(nodes[at], weight=nodes[at].weight + sum(doubts.alike.values()))
    return Modes(optimum, curvature, nodes, nodes[at], doubts.alike, doubts.scale)


def _others(optimum: Optimum, curvature: Array) -> list[Node]:
    """Return the other modes that there are."""
    known = [optimum.solution]

    def near(solution: Solution) -> bool:
        steps = np.array([solution.eta - other.eta for other in known])
        return bool((((steps @ curvature) * steps).sum(axis=1) < _APART).any())

    for start in _starts_of_others(optimum):
        with suppress(np.linalg.LinAlgError):
            ended = best_amplitudes(optimum.marginal.solve(start), enough=ROUGH, until=near)
            known += [] if near(ended) else [ended]
    return [Node(mode, _odds_of_mode(mode, optimum.solution, curvature)) for mode in known[1:]]


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


def _odds_of_mode(solution: Solution, other: Solution, curvature: Array) -> float:
    """Return the odds of a mode against another one, which has the (A, A) curvature, by values and widths (Laplace)."""
    wider = float(np.linalg.slogdet(curvature)[1] - np.linalg.slogdet(0.5 * expected_curvature(solution))[1])
    return float(np.exp(min(log_odds(solution, other, 0.5 * wider), LARGEST_LOG)))
