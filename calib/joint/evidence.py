"""The one evidence: how probable the views are by an explanation, with the weights that the stars have by another.

Only with the same weights can two explanations be compared: where stars fit badly, they would not count.
"""

from __future__ import annotations

import math

from calib.joint.curvature import best_amplitudes
from calib.joint.doubts import LARGEST_LOG, prior_odds, share_of_stars
from calib.joint.marginal import Marginal
from calib.joint.modes import Modes
from calib.joint.places import narrowed
from calib.joint.prior import Faults
from calib.joint.solve import Optimum


def weighed_as(there: Optimum, than: Optimum) -> Marginal:
    """Return the equations of an optimum with the weights that the stars have at another."""
    problem = there.marginal.problem
    same = problem.bench.linearised(there.state, before=than.marginal.equations)
    return Marginal(problem, same, there.state)


def two_log(probability: float) -> float:
    """Return 2 log of a probability, a number even for 0."""
    return 2.0 * math.log(max(probability, 1e-30))


def value_as_weighed(there: Optimum, than: Optimum) -> float:
    """Return -2 log of the likelihood of an optimum with the star weights of another, at the best amplitudes then."""
    if there is than:
        return there.solution.value
    begin = weighed_as(there, than).solve(there.eta)
    return best_amplitudes(begin).value


def odds_of(there: Optimum, faults: Faults, than: Optimum) -> float:
    """Return the odds of faults, seen at the state that they lead to, against no fault at another optimum."""
    assert there.fault_eta is not None
    best = best_amplitudes(weighed_as(there, than).solve(there.fault_eta, faults))
    log = 0.5 * (than.solution.value - best.value) * share_of_stars(best)
    return math.exp(min(log, LARGEST_LOG)) * prior_odds(there.marginal.problem.knowledge.witnesses, faults)


def log_evidence(modes: Modes, than: Optimum) -> float:
    """Return the logarithm of the probability of the views, over all doubts of statements.

    The places of a hand's pupil are free, so they explain something on a gimbal, too. They are integrated out.
    """
    value = value_as_weighed(modes.optimum, than)
    if modes.optimum.marginal.problem.pupils is not None:
        value += narrowed(modes.optimum.solution)
    return modes.log_odds - 0.5 * value
