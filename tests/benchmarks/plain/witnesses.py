"""Statements against what all others say: in closed form, by the posterior with them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from calib.arrays import Array
from calib.model.cause import LARGEST_EVIDENCE, PARALLAX
from calib.model.result_parts import Witness

from . import amplitudes as amp
from .effects import BOUNDED
from .hypotheses import FOCAL, WRONG
from .knowledge import CHANGED_FIELD, READINGS
from .posterior import Posterior
from .solution import Solution
from .table import Statement


@dataclass(frozen=True)
class Innovation:
    """What a statement says against what all others say."""

    statement: Statement
    own: Array  # (k,) its 1-sigma
    expected: Array  # (k,) expected less stated, in the unknowns
    sigma: Array  # (k,) of that
    normalised: float  # Stated less expected over its sigma; root mean square for a joint statement


def innovation(solution: Solution, statement: Statement) -> Innovation:
    """Return the innovation of a statement at a solution, as if nobody had stated it (docs/adjustment.md).

    The information that it adds beyond that is taken out of the posterior.
    """
    at, size = statement.at, solution.problem.unknowns.size
    own = size[at] if statement.focal is None or at[0] not in solution.wide else np.array([statement.focal])
    free = np.maximum(statement.free, own)
    covariance, away = (
        solution.covariance[np.ix_(at, at)],
        (solution.mean - solution.problem.unknowns.mean)[at],
    )
    more = np.diag(solution.prior.shared[at] - free**-2)
    held = np.eye(len(at)) - covariance @ more
    spread, off = (np.asarray(np.linalg.solve(held, known), np.float64) for known in (covariance, away))
    squares = float(off @ np.linalg.solve(np.diag(own**2) + spread, off)) / len(off)
    z = float(np.sqrt(max(squares, 0.0)))
    sign = -float(np.sign(off[0])) if len(off) == 1 else 1.0
    return Innovation(statement, own, off, np.sqrt(np.maximum(np.diag(spread), 0.0)), sign * z)


def fault_probabilities(posterior: Posterior) -> dict[str, float]:
    """Return the probability that each statement is at fault; its other meaning is none."""
    faults: dict[str, float] = {}
    for hypothesis, probability in posterior.odds.items():
        for name, fault in hypothesis.faults:
            if fault != FOCAL:
                faults[name] = faults.get(name, 0.0) + probability
    return faults


def two_log_odds(against: float) -> float:
    """Return 2 log of the odds for what has a probability against it."""
    return min(2.0 * (math.log1p(-min(against, 0.999)) - math.log(max(against, 1e-30))), LARGEST_EVIDENCE)


def witnesses(posterior: Posterior, faults: dict[str, float]) -> tuple[Witness, ...]:
    """Return the statements against what all others say, with the probabilities of their faults."""
    problem, solution, found = posterior.problem, posterior.largest.solution, list[Witness]()
    # As if nobody had stated it, with the sizes of the errors that the views show then: with it, they take it up.
    alone = {
        component.hypothesis.faults[0][0]: component.solution
        for component in reversed(posterior.components)  # the mode comes before its samples
        if len(component.hypothesis.faults) == 1 and component.hypothesis.faults[0][1] == WRONG
    }
    for statement in problem.unknowns.statements:
        if not (statement.free > 0.0).all():
            continue
        one = innovation(alone.get(statement.name, solution), statement)
        numbers: tuple[float | None, ...] = (None, None, None, None)
        if len(statement.at) == 1:
            scale, value = statement.per_unknown, statement.stated
            numbers = (value, scale * one.own[0], value + scale * one.expected[0], scale * one.sigma[0])
        stated, sigma, expected, spread = (None if n is None else float(n) for n in numbers)
        source = statement.row.source
        probability = faults.get(statement.name, 0.0)
        found.append(
            Witness(
                statement.name,
                source,
                statement.unit,
                stated,
                sigma,
                expected,
                spread,
                one.normalised,
                probability,
            )
        )
    if PARALLAX in faults and all(witness.name != PARALLAX for witness in found):
        found.append(_denied(faults[PARALLAX]))
    if problem.readings is not None:
        found.append(_size(posterior, READINGS, "station: reading_sigma_deg", amp.READING))
    if amp.CHANGE in problem.expected.names:
        found.append(_size(posterior, CHANGED_FIELD, "expected of another pupil", amp.CHANGE))
    return tuple(found)


def _denied(probability: float) -> Witness:
    """Return the witness of a bound of the parallax that the first explanation does without."""
    odds = probability / max(1.0 - probability, 1e-30)
    z = float(np.sqrt(max(2.0 * np.log(odds), 0.0)))
    return Witness(PARALLAX, BOUNDED.source, "1", None, None, None, None, z, probability)


def _size(posterior: Posterior, name: str, source: str, amplitude: str) -> Witness:
    """Return the witness of errors whose size is expected: how many times as large they are."""
    expected = posterior.problem.expected
    at = expected.at(amplitude)
    log_times = float(posterior.optimum.solution.eta[at] - expected.mean[at])
    width, times = float(expected.sigma[at]), float(np.exp(log_times))
    spread = times * float(posterior.spread[at])
    return Witness(name, source, "times stated", 1.0, width, times, spread, -log_times / width, 0.0)
