"""What explains the views beside the first adjustment: other optima, lenses and ways of the pupil, as one mixture.

On a gimbal the pupil follows the turn; a hand moves it anywhere. The visible discs and the stars say how probable each
is. A bound of the parallax says that a gimbal holds the pupil near its pivot. It is a statement, and can be wrong: if
the stars contradict what is stated, the ways without it are weighed, too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calib.calibration import CalibrationOptions
from calib.errors import CalibrationError
from calib.model import result_parts as parts
from calib.model.camera import DISTORTION_SETS
from calib.view import View

from .adjust import adjusted, begun_at
from .camera import Camera, lens_names
from .evidence import log_ratio
from .knowledge import ASPECT
from .mixture import Mixture, Part
from .posterior import Posterior
from .pupils import Pupil
from .witnesses import fault_probabilities

#: The sets of coefficients that stand for the families of lenses.
_BROWN, _FISHEYE = "k1k2k3p1p2", "fisheye"
#: Tangent of the angle at the sensor's corner from which on the lens must be of the right family: at 45 degrees, three
#: radial terms of the tangent miss a fisheye lens by several U of fx.
_WIDE_FIELD = 0.8
#: Logarithm of the odds of another lens, 1 to 150: only strong evidence changes a model that was chosen (Kass and
#: Raftery, 1995).
_OTHER_LENS = -5.0
#: From this 2 log of the odds by the discs on, one way has a probability of less than 2 %, and is left out. The stars
#: count at most as much: neither way has all errors that there are, and a search can end at the wrong place.
_DECIDED = 8.0
#: Odds that a hand moves the camera although a bound is stated: who states it has measured it, and may have taken the
#: camera off since. It is asked if all that is stated is right with less than the second probability.
_NO_BOUND, _CONTRADICTED = 0.02, 0.5
#: An explanation with a smaller share adds nothing to the result.
_LEAST = 1e-3


class _Found(NamedTuple):
    """An explanation."""

    posterior: Posterior
    log_odds: float  # Against the first
    row: str  # Of the budget: what the difference belongs to

    @property
    def rank(self) -> tuple[bool, float]:
        """What orders explanations: first those whose search ended, then the more probable ones."""
        return self.posterior.optimum.converged, self.log_odds


def explanations(views: Sequence[View], options: CalibrationOptions) -> tuple[Mixture, str]:
    """Return the mixture over optima, lenses and ways of the pupil, and coefficients of a better lens, if there is one.

    In a wide field both families of lenses are always tried: there the wrong one moves the focal length. A family that
    was asked for stays, and the result says that the other one explains the views better.
    """
    first, *others = adjusted(views, options)
    found, better = [_Found(first, 0.0, parts.AMPLITUDES)], ""
    found += [_Found(other, log_ratio(other, first), parts.AMPLITUDES) for other in others]
    best = max(found, key=_rank)
    lens = _with_other_lens(best.posterior, views, options)
    if lens is not None and options.compares_lenses:
        found.append(_Found(lens[0], best.log_odds + lens[1], parts.LENS))
    elif lens is not None and lens[1] > 0.0:
        better = _family(lens[0].problem.camera)
    best = max(found, key=_rank)
    moved = _moved_otherwise(best.posterior, views, options)
    if moved is not None:
        found.append(_Found(moved[0], best.log_odds + moved[1], parts.PUPILS))
    return _mixture(found), better


def _rank(found: _Found) -> tuple[bool, float]:
    return found.rank


def _mixture(found: Sequence[_Found]) -> Mixture:
    """Return the mixture of explanations by their odds, the most probable one first."""
    first = max(found, key=_rank)
    others = [one for one in found if one is not first and one.posterior.optimum.converged]
    log_odds = np.array([first.log_odds, *(one.log_odds for one in others)])
    shares = np.exp(log_odds - np.logaddexp.reduce(log_odds)).tolist()
    kept = [(one, share) for one, share in zip(others, shares[1:], strict=True) if share > _LEAST]
    whole = shares[0] + sum(share for _, share in kept)
    members = [Part(first.posterior, shares[0] / whole)]
    return Mixture((*members, *(Part(one.posterior, share / whole, one.row) for one, share in kept)))


def _family(camera: Camera) -> str:
    """Return the set of coefficients that stands for a family of lenses."""
    return _FISHEYE if camera.is_fisheye else _BROWN


def _with_other_lens(
    first: Posterior, views: Sequence[View], options: CalibrationOptions
) -> tuple[Posterior, float] | None:
    """Return the views by the other family of lenses, with its log odds, if data choose it or the field is wide."""
    camera = first.problem.camera
    corner = 0.5 * float(np.hypot(*camera.image_size)) / (camera.f0_px * float(np.exp(first.mean[0])))
    if not options.compares_lenses and corner <= _WIDE_FIELD:
        return None
    other = _BROWN if camera.is_fisheye else _FISHEYE
    with suppress(CalibrationError, np.linalg.LinAlgError):  # these views cannot be those of such a lens
        there = adjusted(views, options, lens=lens_names(DISTORTION_SETS[other]))[0]
        return there, log_ratio(there, first) + _OTHER_LENS
    return None


def _moved_otherwise(
    first: Posterior, views: Sequence[View], options: CalibrationOptions
) -> tuple[Posterior, float] | None:
    """Return the views by the other way of the pupil, with its log odds, if neither a bound nor the discs decide."""
    moved = first.problem.moved
    if moved.discs is None or moved.pupil is Pupil.HELD or first.problem.n < 2:
        return None
    wander = moved.discs.wander
    if abs(wander) > _DECIDED:
        return None
    way, by_discs = (Pupil.WALKS, -wander) if moved.by_hand else (Pupil.BY_HAND, wander)
    with suppress(CalibrationError, np.linalg.LinAlgError):  # these views cannot be explained so
        start = begun_at(first.problem, first.optimum.state)
        there = adjusted(views, options, way, first.problem.camera.lens, [start])[0]
        by_stars = 2.0 * log_ratio(there, first)
        return there, 0.5 * (by_discs + float(np.clip(by_stars, -_DECIDED, _DECIDED)))
    return None


def without_bound(held: Mixture, views: Sequence[View], options: CalibrationOptions, worth: float) -> Mixture:
    """Return the mixture that allows for a wrong bound of the parallax, if something contradicts it; else ``held``.

    Ids of a view that are shifted imitate a hand. If they are ``worth`` more, in 2 log of the odds, the bound holds.
    """
    first = held.first
    # A hand contradicts several statements by many sigma; it makes no pixel oblong.
    faults = fault_probabilities(first)
    right = math.prod(1.0 - probability for name, probability in faults.items() if name != ASPECT)
    moved = first.problem.moved
    other_collimator = bool(first.optimum.solution.wide)  # which says all
    if moved.pupil is not Pupil.HELD or moved.discs is None or other_collimator or right > _CONTRADICTED:
        return held
    try:
        free, _ = explanations(views, unbounded(options))
    except (CalibrationError, np.linalg.LinAlgError):  # without the bound nothing determines the camera
        return held
    log_odds = log_ratio(free.first, first) + math.log(_NO_BOUND)
    if free.first.problem.moved.by_hand:
        log_odds += 0.5 * moved.discs.wander
    share = 0.5 + 0.5 * math.tanh(0.5 * log_odds)
    if worth > max(2.0 * log_odds, 0.0) or share < _LEAST:
        return held
    pairs = sorted([(share, free), (1.0 - share, held)], key=lambda pair: -pair[0])
    members = [
        replace(part, share=own * part.share, row=part.row if mixture is pairs[0][1] else parts.PUPILS)
        for own, mixture in pairs
        for part in mixture.parts
        if own * part.share > _LEAST
    ]
    whole = sum(part.share for part in members)
    return Mixture(tuple(replace(part, share=part.share / whole) for part in members), share)


def unbounded(options: CalibrationOptions) -> CalibrationOptions:
    """Return options in which nothing bounds the parallax."""
    gimbal = options.gimbal
    return options if gimbal is None else replace(options, gimbal=replace(gimbal, parallax=None))
