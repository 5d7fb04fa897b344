"""The posterior over the ways in which the camera's pupil may have been moved through the beam.

On a gimbal the pupil follows the turn; a hand moves it anywhere. Each way is an adjustment of its own. The visible
discs and the stars say how probable each is. The result is the mixture of both, unless the discs alone
leave one less than 2 %.

A bound of the parallax says that a gimbal holds the pupil near its pivot. It is a statement, and can be wrong. If
something contradicts it, the ways without it are looked at too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from calib.arrays import Array
from calib.calibration import CalibrationOptions
from calib.errors import CalibrationError
from calib.joint.adjust import adjust, adjust_again
from calib.joint.amplitudes import ASIDE as ASIDE_AMPLITUDE
from calib.joint.amplitudes import Pupil
from calib.joint.doubts import Innovation, prior_odds
from calib.joint.effects.by_turn import ASIDE
from calib.joint.effects.collimator import CENTRE, RADIAL
from calib.joint.effects.effect import Places
from calib.joint.effects.gimbal import GimbalErrors
from calib.joint.knowledge import ASPECT, Statement
from calib.joint.places import narrowed
from calib.joint.posterior import Modes, OtherWay, Posterior, modes_of, posterior
from calib.joint.prior import block_diagonal
from calib.joint.solve import Optimum, value_as_weighed
from calib.joint.wrong_views import ShiftedIds, find_shifted_ids
from calib.model.cause import PARALLAX
from calib.view import View

#: From this 2 log of the odds by the discs on, one way has a probability of less than 2 %, and is left out. The stars
#: count at most as much: neither way has all errors that there are, and a search can end at the wrong place.
_DECIDED = 8.0
#: A bound is doubted if some statement is wrong with this probability: a hand contradicts several by many sigma. It
#: makes no pixel oblong.
_CONTRADICTED = 0.5
#: Probability that a hand moves the camera of a station that bounds the parallax of a gimbal.
_BY_HAND = 0.02
#: A way with a smaller share adds nothing to the result.
_LEAST = 1e-3
#: Readings with this standard uncertainty say nothing beside the stars.
_NO_READING_DEG = 1.0


def posterior_of(views: Sequence[View], options: CalibrationOptions) -> Posterior:
    """Return the posterior of views, over both ways of the pupil if neither a bound nor the discs decide."""
    rounds = options.max_iterations
    first = adjust(views, options)
    problem = first.marginal.problem
    by_hand = problem.pupils is not None
    if abs(problem.wander) > _DECIDED or problem.bench.n_poses < 2:
        return posterior(first, rounds)
    try:
        second = adjust_again(first, views, options, Pupil.WALKS if by_hand else Pupil.BY_HAND)
        own, others = modes_of(first), modes_of(second)
        share = _share(own, others)
        if share > 0.5 or not first.converged:
            first, second, share, own, others = second, first, 1.0 - share, others, own
        if share < _LEAST or not second.converged:
            return posterior(first, rounds, found=own)
        other = posterior(second, rounds, follow=False, found=others)
    except (CalibrationError, np.linalg.LinAlgError):  # these views cannot be explained so
        return posterior(first, rounds)
    return _mixed(posterior(first, rounds, found=own), other, share)


def _share(own: Modes, others: Modes) -> float:
    """Return the probability of the way of the second optimum: one to one beforehand, by discs, stars and doubts.

    The places of a hand's pupil are free, so they explain something on a gimbal, too. They are integrated out.
    """
    first, second = own.optimum, others.optimum
    sign, by_hand = (-1.0, first) if first.marginal.problem.pupils is not None else (1.0, second)
    by_stars = first.solution.value - value_as_weighed(second, first)
    by_stars = sign * (by_stars + 2.0 * (others.log_odds - own.log_odds))
    by_stars -= narrowed(by_hand.solution)
    log = first.marginal.problem.wander + min(max(by_stars, -_DECIDED), _DECIDED)
    return _logistic(0.5 * sign * log)


def _logistic(log_odds: float) -> float:
    """Return the probability of odds."""
    return 0.5 + 0.5 * math.tanh(0.5 * log_odds)


def _mixed(found: Posterior, other: Posterior, share: float) -> Posterior:
    """Return a posterior as the mixture with that of the other way, which has a share.

    Unknowns that are not results are those of the first way, and follow the results as in it.
    """
    layout, there = (one.optimum.marginal.problem.bench.layout for one in (found, other))
    names = (*layout.pose.camera, *CENTRE, *RADIAL, *layout.names_of(GimbalErrors))
    at, other_at = layout.places(names), there.places(names)
    solution = found.largest.solution
    follow = _follow(solution.covariance, at)
    rest = solution.covariance - follow @ solution.covariance[at]
    middle = found.optimum.state.shared + solution.step
    means = middle + (other.means[:, other_at] - middle[at]) @ follow.T
    covariances = [follow @ one[np.ix_(other_at, other_at)] @ follow.T + rest for one in other.covariances]
    faults = {
        name: (1.0 - share) * found.faults.get(name, 0.0) + share * other.faults.get(name, 0.0)
        for name in {**found.faults, **other.faults}
    }
    return replace(found, faults=faults, other=OtherWay(other, share, means, covariances))


def _follow(covariance: Array, at: Places) -> Array:
    """Return (S, C) how all unknowns follow the C at some places, for an (S, S) covariance."""
    scale = np.sqrt(np.diag(covariance))
    alike = covariance / np.outer(scale, scale)
    follow = np.linalg.solve(alike[np.ix_(at, at)], alike[at]).T
    follow[at] = np.eye(len(at))
    return np.asarray(scale[:, None] * follow / scale[at])


def with_doubted_bound(
    held: Posterior, views: Sequence[View], options: CalibrationOptions, shifted: ShiftedIds
) -> Posterior:
    """Return the posterior that allows for a wrong bound of the parallax, if something contradicts it; else ``held``.

    Ids of a view that are shifted imitate a hand. If they explain more, the bound holds.
    """
    bounded = options.gimbal is not None and options.gimbal.parallax is not None
    faults = (probability for name, probability in held.faults.items() if name != ASPECT)
    contradicted = max(faults, default=0.0) >= _CONTRADICTED
    if not (bounded and contradicted and held.optimum.marginal.problem.bench.discs):
        return held
    try:
        log = _log_odds(views, options)
        if shifted.worth > max(2.0 * log, 0.0) or _logistic(log) < _LEAST:
            return held
        return _with_bound(held, posterior_of(views, _unbounded(options)), log)
    except (CalibrationError, np.linalg.LinAlgError):  # without the bound nothing determines the camera
        return held


def shifted_ids(optimum: Optimum, views: Sequence[View], options: CalibrationOptions) -> ShiftedIds:
    """Return the views whose ids are shifted, if the pupil is moved as in an optimum."""
    pupil = optimum.marginal.problem.bench.layout.bench.pupil
    same = options if pupil is Pupil.HELD else _unbounded(options)
    return find_shifted_ids(
        optimum, views, options.max_iterations, partial(adjust, options=same, pupil=pupil)
    )


def _unbounded(options: CalibrationOptions) -> CalibrationOptions:
    """Return options in which nothing bounds the parallax."""
    gimbal = options.gimbal
    return options if gimbal is None else replace(options, gimbal=replace(gimbal, parallax=None))


def _log_odds(views: Sequence[View], options: CalibrationOptions) -> float:
    """Return the logarithm of the odds that a bound of the parallax is wrong, by discs and stars.

    Readings do not count: the own errors of a hand's poses could explain those that are wrong themselves.
    """
    assert options.gimbal is not None
    options = replace(options, gimbal=replace(options.gimbal, reading_sigma_deg=_NO_READING_DEG))
    held, free = (posterior_of(views, one) for one in (options, _unbounded(options)))
    bound = _bound(held)
    log = _log_evidence(free, held.optimum) - _log_evidence(held, held.optimum)
    # A density of unknowns: that of what is stated, times the determinant of how it follows the unknowns.
    log -= 0.5 * float(np.linalg.slogdet(bound.rows @ bound.rows.T)[1])
    return log + _beside_as_stated(bound, held.optimum) + math.log(_BY_HAND)


def _beside_as_stated(bound: Statement, optimum: Optimum) -> float:
    """Return how probable it is beforehand that a pupil lies beside the axes as a bound states: a logarithm.

    With the bound, this statement is one more datum. Without the bound there is none, so its probability is taken out.
    """
    problem = optimum.marginal.problem
    expected = math.exp(2.0 * problem.hyper.mean[problem.hyper.at(ASIDE_AMPLITUDE)])
    beside = bound.rows[:, problem.bench.layout.places(ASIDE)].any(axis=1)
    return float(-0.5 * np.log(np.diag(bound.covariance)[beside] + expected).sum())


def _with_bound(held: Posterior, free: Posterior, log: float) -> Posterior:
    """Return the mixture of the posteriors with a bound of the parallax and without it, by the odds of the latter."""
    share = _logistic(log)
    free = replace(free, faults={**free.faults, PARALLAX: 1.0})
    first, second, less = (held, free, share) if share < 0.5 else (free, held, 1.0 - share)
    if less > _LEAST and second.optimum.converged:
        first = _mixed(first, replace(second, other=None), less)
    if share < 0.5:
        return first
    bound = _bound(held)
    sigma = np.sqrt(np.diag(bound.covariance))
    return replace(first, denied=Innovation(PARALLAX, bound, bound.values, sigma, math.sqrt(2.0 * log)))


def _log_evidence(found: Posterior, than: Optimum) -> float:
    """Return the logarithm of the probability of the views, with the weights that the stars have at an optimum."""
    optimum, largest = found.optimum, found.largest
    value = largest.solution.value
    if optimum is not than:
        value = value_as_weighed(optimum, than, largest.solution)
    if optimum.marginal.problem.pupils is not None:
        value += narrowed(optimum.solution)
    return -0.5 * value + math.log(prior_odds(optimum.marginal.problem.knowledge.witnesses, largest.faults))


def _bound(held: Posterior) -> Statement:
    """Return all that a bound states of the parallax as one statement."""
    statements = held.optimum.marginal.problem.knowledge.statements
    parts = [one for one in statements if one.name == PARALLAX]
    rows, values = (np.concatenate([getattr(one, name) for one in parts]) for name in ("rows", "values"))
    return replace(
        parts[0], rows=rows, values=values, covariance=block_diagonal([one.covariance for one in parts])
    )
