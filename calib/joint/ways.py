"""Gimbal or hand: the posterior if it is not known how the camera's pupil was moved through the beam.

On a gimbal the pupil follows the turn; a hand moves it anywhere. Each way is an adjustment of its own. The visible
discs and the stars say how probable each is. The result is the mixture of both, unless the discs alone
leave one less than 2 %.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.arrays import Array
from calib.calibration import CalibrationOptions
from calib.errors import CalibrationError
from calib.joint.adjust import adjust, adjust_again
from calib.joint.amplitudes import Pupil
from calib.joint.layout import CENTRE, RADIAL, Places
from calib.joint.places import narrowed
from calib.joint.posterior import OtherWay, Posterior, posterior
from calib.joint.solve import Optimum, value_as_weighed
from calib.view import View

#: From this 2 log of the odds by the discs on, one way has a probability of less than 2 %, and is left out. The stars
#: count at most as much: neither way has all errors that there are, and a search can end at the wrong place.
_DECIDED = 8.0
#: A way with a smaller share adds nothing to the result.
_LEAST = 1e-3


def posterior_of(views: Sequence[View], options: CalibrationOptions) -> Posterior:
    """Return the posterior of views, over both ways of the pupil if the discs do not decide."""
    rounds = options.max_iterations
    first = adjust(views, options)
    problem = first.marginal.problem
    by_hand = problem.pupils is not None
    if abs(problem.wander) > _DECIDED or problem.bench.n_poses < 2:
        return posterior(first, rounds)
    try:
        second = adjust_again(first, views, options, Pupil.WALKS if by_hand else Pupil.BY_HAND)
        share = _share(first, second)
        if share > 0.5 or not first.converged:
            first, second, share = second, first, 1.0 - share
        if share < _LEAST or not second.converged:
            return posterior(first, rounds)
        other = posterior(second, rounds, follow=False)
    except (CalibrationError, np.linalg.LinAlgError):  # these views cannot be explained so
        return posterior(first, rounds)
    return _mixed(posterior(first, rounds), other, share)


def _share(first: Optimum, second: Optimum) -> float:
    """Return the probability of the way of the second optimum: one to one beforehand, by discs and stars.

    The places of a hand's pupil are free, so they explain something on a gimbal, too. They are integrated out.
    """
    sign, by_hand = (-1.0, first) if first.marginal.problem.pupils is not None else (1.0, second)
    by_stars = sign * (first.solution.value - value_as_weighed(second, first))
    by_stars -= narrowed(by_hand.marginal, by_hand.eta, by_hand.solution)
    log = first.marginal.problem.wander + min(max(by_stars, -_DECIDED), _DECIDED)
    return 0.5 + 0.5 * math.tanh(0.25 * sign * log)


def _mixed(found: Posterior, other: Posterior, share: float) -> Posterior:
    """Return a posterior as the mixture with that of the other way, which has a share.

    Unknowns that are not results are those of the first way, and follow the results as in it.
    """
    layout, there = (one.optimum.marginal.problem.bench.layout for one in (found, other))
    names = (*layout.camera, *CENTRE, *RADIAL, *layout.gimbal)
    at, other_at = layout.places(names), there.places(names)
    solution = found.largest.solution
    follow = _follow(solution.covariance, at)
    rest = solution.covariance - follow @ solution.covariance[at]
    middle = found.optimum.state.shared + solution.step
    means = middle + (other.means[:, other_at] - middle[at]) @ follow.T
    covariances = [follow @ one @ follow.T + rest for one in other.covariances_at(other_at)]
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
