"""What explains the views beside the first adjustment: other lenses, other ways of the pupil, as one mixture.

On a gimbal the pupil follows the turn; a hand moves it anywhere. The visible discs and the stars say how probable each
is. A bound of the parallax says that a gimbal holds the pupil near its pivot. It is a statement, and can be wrong: if
something contradicts it, the ways without it are looked at too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from calib.calibration import CalibrationOptions
from calib.errors import CalibrationError
from calib.joint.adjust import adjust, optima
from calib.joint.amplitudes import ASIDE as ASIDE_AMPLITUDE
from calib.joint.amplitudes import Pupil
from calib.joint.doubts import Innovation
from calib.joint.effects.by_turn import ASIDE
from calib.joint.effects.collimator import CENTRE
from calib.joint.evidence import log_evidence, odds_of
from calib.joint.hypotheses import NO_BOUND, OTHER_LENGTH, OTHER_LENS, OTHER_OPTIMUM, OTHER_WAY, Hypothesis
from calib.joint.knowledge import ASPECT, CERTIFICATE, FOCAL, Statement
from calib.joint.modes import Modes, modes_of
from calib.joint.posed import lens_names
from calib.joint.posterior import Posterior, mixed, posterior
from calib.joint.prior import block_diagonal
from calib.joint.solve import Optimum, optimum_with_faults
from calib.joint.wrong_views import find_shifted_ids
from calib.model.camera import DISTORTION_SETS, PINHOLE
from calib.model.cause import PARALLAX, Cause
from calib.model.lens import is_fisheye
from calib.model.likelihood_ratio import DECISIVE
from calib.progress import expect
from calib.view import View

#: The sets of coefficients that stand for the families of lenses.
_BROWN, _FISHEYE = "k1k2k3p1p2", "fisheye"
#: Tangent of the angle at the sensor's corner from which on the lens must be of the right family: at 45 degrees, three
#: radial terms of the tangent miss a fisheye lens by several U of fx.
_WIDE_FIELD = 0.8
#: From this 2 log of the odds by the discs on, one way has a probability of less than 2 %, and is left out. The stars
#: count at most as much: neither way has all errors that there are, and a search can end at the wrong place.
_DECIDED = 8.0
#: A bound is doubted if all that is stated is right with a smaller probability.
_CONTRADICTED = 0.5
#: An explanation with a smaller share adds nothing to the result.
_LEAST = 1e-3
#: Two searches ended at the same optimum if focal lengths, principal points and feet differ by less than so many sigma.
_SAME = 0.2
#: Readings with this standard uncertainty say nothing beside the stars.
_NO_READING_DEG = 1.0


class _Explanation(NamedTuple):
    """The views by one explanation."""

    modes: Modes
    log_odds: float  # Against the first one, with those beforehand
    hypothesis: Hypothesis | None = None  # None: the first

    @property
    def optimum(self) -> Optimum:
        """Its optimum."""
        return self.modes.optimum


def posterior_of(views: Sequence[View], options: CalibrationOptions) -> Posterior:
    """Return the posterior of views over lenses and ways of the pupil, as far as neither is decided.

    In a wide field both families of lenses are always tried: there the wrong one moves the focal length. A family that
    was asked for stays, and the result says that the other one explains the views better.
    """
    explanations = _at_all_optima(views, options)
    best = max(explanations, key=_rank)
    lenses = _with_other_lens(best, views, options)
    better = [other for other in lenses if not options.compares_lenses and other.log_odds > best.log_odds]
    explanations += lenses if options.compares_lenses else []
    explanations += _moved_otherwise(max(explanations, key=_rank), views, options)
    mixture = _mixture(_with_other_length(explanations))
    return replace(mixture, better_lens=_family(better[0].optimum)) if better else mixture


def _rank(explanation: _Explanation) -> tuple[bool, float]:
    """Return what orders explanations: first those whose search ended, then the more probable ones."""
    return explanation.optimum.converged, explanation.log_odds


def _mixture(explanations: Sequence[_Explanation]) -> Posterior:
    """Return the mixture of explanations by their odds, about the most probable one."""
    first = max(explanations, key=_rank)
    log_odds = np.array([explanation.log_odds for explanation in explanations])
    shares = np.exp(log_odds - np.logaddexp.reduce(log_odds)).tolist()
    others = [
        (posterior(other.modes, follow=False), share, hypothesis)
        for other, share in zip(explanations, shares, strict=True)
        if other is not first and other.optimum.converged and share > _LEAST
        if (hypothesis := other.hypothesis or first.hypothesis)  # the first differs as its rival does
    ]
    return mixed(posterior(first.modes), others)


def _at_all_optima(views: Sequence[View], options: CalibrationOptions) -> list[_Explanation]:
    """Return the views by each optimum that is another one: a search from another start may end at the same."""
    first, *others = optima(views, options)
    explanations = [_Explanation(modes_of(first), 0.0)]
    at = first.marginal.problem.bench.layout.places((*PINHOLE, *CENTRE))
    sigmas = np.sqrt(np.diag(first.solution.covariance)[at])
    for other in others:
        apart = np.abs(other.state.shared[at] - first.state.shared[at]) / sigmas
        if apart.max() > _SAME:
            with suppress(np.linalg.LinAlgError):
                there = modes_of(other.at_best)
                log_odds = _log_odds(there, explanations[0]) + math.log(OTHER_OPTIMUM.odds)
                explanations.append(_Explanation(there, log_odds, OTHER_OPTIMUM))
    return explanations


def _with_other_lens(
    first: _Explanation, views: Sequence[View], options: CalibrationOptions
) -> list[_Explanation]:
    """Return the views by the other family of lenses, if the data choose it or if the field is wide."""
    bench = first.optimum.marginal.problem.bench
    corner = 0.5 * float(np.hypot(*bench.image_size)) / float(first.optimum.state.shared[0])
    if not options.compares_lenses and corner <= _WIDE_FIELD:
        return []
    other = _BROWN if _family(first.optimum) == _FISHEYE else _FISHEYE
    with suppress(CalibrationError, np.linalg.LinAlgError):  # these views cannot be those of such a lens
        there = modes_of(adjust(views, options, lens=lens_names(DISTORTION_SETS[other])).at_best)
        log_odds = _log_odds(there, first) + math.log(OTHER_LENS.odds)
        return [_Explanation(there, first.log_odds + log_odds, OTHER_LENS)]
    return []


def _family(optimum: Optimum) -> str:
    """Return the set of coefficients that stands for an optimum's family of lenses."""
    return _FISHEYE if is_fisheye(dict.fromkeys(_lens(optimum), 0.0)) else _BROWN


def _lens(optimum: Optimum) -> tuple[str, ...]:
    """Return the coefficients of an optimum's lens."""
    return optimum.marginal.problem.bench.layout.pose.camera[len(PINHOLE) :]


def _log_odds(there: Modes, first: _Explanation) -> float:
    """Return the logarithm of the odds of an explanation against the first one, by the views alone."""
    return log_evidence(there, first.optimum) - log_evidence(first.modes, first.optimum)


def _moved_otherwise(
    first: _Explanation, views: Sequence[View], options: CalibrationOptions
) -> list[_Explanation]:
    """Return the views by the other way of the pupil, with the same lens, if neither a bound nor the discs decide."""
    problem = first.optimum.marginal.problem
    if abs(problem.wander) > _DECIDED or problem.bench.n_poses < 2:
        return []
    way, by_discs = (
        (Pupil.BY_HAND, problem.wander) if problem.pupils is None else (Pupil.WALKS, -problem.wander)
    )
    with suppress(CalibrationError, np.linalg.LinAlgError):  # these views cannot be explained so
        there = modes_of(adjust(views, options, way, _lens(first.optimum)).at_best)
        by_stars = min(max(2.0 * _log_odds(there, first), -_DECIDED), _DECIDED)
        log_odds = 0.5 * (by_discs + by_stars) + math.log(OTHER_WAY.odds)
        return [_Explanation(there, first.log_odds + log_odds, OTHER_WAY)]
    return []


def _with_other_length(explanations: Sequence[_Explanation]) -> list[_Explanation]:
    """Return the most probable explanation, and beside it the one by the other length of a certificate.

    A hand's pupils are found with the one length, and hide how far off it is. So the other one has pupils of its own.
    """
    first = max(explanations, key=_rank)
    problem, focal = first.optimum.marginal.problem, (CERTIFICATE, FOCAL)
    certificate = problem.knowledge.witnesses.get(CERTIFICATE)
    if problem.pupils is None or certificate is None or FOCAL not in certificate.doubts:
        return list(explanations)
    try:
        there = optimum_with_faults(first.optimum, (focal,))
        log_odds = first.log_odds + math.log(odds_of(there, (focal,), first.optimum))
        other = _Explanation(modes_of(there), log_odds, OTHER_LENGTH)
    except (CalibrationError, np.linalg.LinAlgError):  # without the length nothing determines the camera
        return list(explanations)
    nodes = [node for node in first.modes.nodes if focal not in node.faults]
    seen = first._replace(modes=replace(first.modes, nodes=nodes))
    return [seen, other, *(each for each in explanations if each is not first)]


def with_doubted_bound(
    held: Posterior, views: Sequence[View], options: CalibrationOptions, shifted: Cause | None
) -> Posterior:
    """Return the posterior that allows for a wrong bound of the parallax, if something contradicts it; else ``held``.

    Ids of a view that are shifted imitate a hand. If they explain more, the bound holds.
    """
    bounded = options.gimbal is not None and options.gimbal.parallax is not None
    # A hand contradicts several statements by many sigma; it makes no pixel oblong.
    right = math.prod(1.0 - probability for name, probability in held.faults.items() if name != ASPECT)
    contradicted = right < _CONTRADICTED
    if not (bounded and contradicted and held.optimum.marginal.problem.bench.stars.discs):
        return held
    expect(3)  # the views with the bound and without it, without readings, and the latter again with them
    try:
        log_odds = _log_odds_without_bound(views, options)
        share = 0.5 + 0.5 * math.tanh(0.5 * log_odds)
        if (shifted and shifted.evidence - DECISIVE > 2.0 * log_odds) or share < _LEAST:
            return held
        free = posterior_of(views, _unbounded(options))
    except (CalibrationError, np.linalg.LinAlgError):  # without the bound nothing determines the camera
        return held
    return _with_bound(held, replace(free, faults={**free.faults, PARALLAX: 1.0}), share, log_odds)


def shifted_ids(optimum: Optimum, views: Sequence[View], options: CalibrationOptions) -> Cause | None:
    """Return the views whose ids are shifted, if the pupil is moved as in an optimum."""
    pupil = optimum.marginal.problem.bench.layout.bench.pupil
    same = options if pupil is Pupil.HELD else _unbounded(options)
    again = partial(adjust, options=same, pupil=pupil, lens=_lens(optimum))
    return find_shifted_ids(optimum, views, again)


def _unbounded(options: CalibrationOptions) -> CalibrationOptions:
    """Return options in which nothing bounds the parallax."""
    gimbal = options.gimbal
    return options if gimbal is None else replace(options, gimbal=replace(gimbal, parallax=None))


def _log_odds_without_bound(views: Sequence[View], options: CalibrationOptions) -> float:
    """Return the logarithm of the odds that a bound of the parallax is wrong, by discs and stars.

    Readings do not count: the own errors of a hand's poses could explain those that are wrong themselves.
    """
    assert options.gimbal is not None
    options = replace(options, gimbal=replace(options.gimbal, reading_sigma_deg=_NO_READING_DEG))
    held, free = (posterior_of(views, stated) for stated in (options, _unbounded(options)))
    bound = _bound(held)
    log_odds = log_evidence(free.modes, held.optimum) - log_evidence(held.modes, held.optimum)
    # A density of unknowns: that of what is stated, times the determinant of how it follows the unknowns.
    log_odds -= 0.5 * float(np.linalg.slogdet(bound.rows @ bound.rows.T)[1])
    return log_odds + _aside_as_stated(bound, held.optimum) + math.log(NO_BOUND.odds)


def _aside_as_stated(bound: Statement, optimum: Optimum) -> float:
    """Return how probable it is beforehand that a pupil lies beside the axes as a bound states: a logarithm.

    With the bound, this statement is one more datum. Without the bound there is none, so its probability is taken out.
    """
    problem = optimum.marginal.problem
    expected = math.exp(2.0 * problem.hyper.mean[problem.hyper.at(ASIDE_AMPLITUDE)])
    aside = bound.rows[:, problem.bench.layout.places(ASIDE)].any(axis=1)
    return float(-0.5 * np.log(np.diag(bound.covariance)[aside] + expected).sum())


def _with_bound(held: Posterior, free: Posterior, share: float, log_odds: float) -> Posterior:
    """Return the mixture of the posteriors with a bound of the parallax and without it, which has a share."""
    first, second, less = (held, free, share) if share < 0.5 else (free, held, 1.0 - share)
    if less > _LEAST and second.optimum.converged:
        first = mixed(first, [(second, less, NO_BOUND)])
    if share < 0.5:
        return first
    bound = _bound(held)
    sigma = np.sqrt(np.diag(bound.covariance))
    return replace(first, denied=Innovation(PARALLAX, bound, bound.values, sigma, math.sqrt(2.0 * log_odds)))


def _bound(held: Posterior) -> Statement:
    """Return all that a bound states of the parallax as one statement."""
    statements = held.optimum.marginal.problem.knowledge.statements
    parts = [statement for statement in statements if statement.name == PARALLAX]
    rows, values = (np.concatenate([getattr(part, name) for part in parts]) for name in ("rows", "values"))
    covariance = block_diagonal([part.covariance for part in parts])
    return replace(parts[0], rows=rows, values=values, covariance=covariance)
