"""Choice of the lens model: which distortion the data support, and whether the lens or the collimator is incomplete.

A missing term of the lens looks like an error of the collimator: the views differ more than star noise explains. Both
causes are therefore compared in the same way, by poses that had no part in the fit, or with few poses by the Bayesian
information criterion.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.calibration import CalibrationOptions, Candidate
from calib.diagnosis.gross_stars import GrossStars, part_of
from calib.errors import CalibrationError
from calib.fit import Fit, fit_model, model_to_fit
from calib.model.camera import DISTORTION_SETS
from calib.selection import Choice, as_candidate, choose, enough_poses
from calib.view import View

#: Lens models that are compared, from the simplest.
LENSES = ("k1k2", "k1k2k3", "k1k2p1p2", "k1k2k3p1p2", "fisheye")
#: A richer lens is chosen only if it predicts views better by this share. Errors of a collimator differ from pose to
#: pose, so that lenses differ by some per cent by chance.
_MIN_IMPROVEMENT = 0.1
#: The richest lenses: if they do not predict better, none does.
_RICHEST = ("k1k2k3p1p2", "fisheye")
#: With few poses, a richer lens is chosen only if its criterion is smaller by this much: strong evidence (Kass and
#: Raftery, 1995).
_MIN_CRITERION = 10.0
#: Stars of a view that take part in a comparison, about.
_COMPARED_STARS = 150


@dataclass(frozen=True)
class LensComparison:
    """Lens models with the same model of the collimator."""

    candidates: Mapping[str, Candidate]
    best: str

    def sentence(self, used: str) -> str:
        """Return what the comparison shows, in words.

        Returns: One sentence; empty if the data support the lens that was used.
        """
        if self.best == used or used not in self.candidates:
            return ""
        mine, other = self.candidates[used], self.candidates[self.best]
        if mine.left_out_rms_px is not None and other.left_out_rms_px is not None:
            how = (
                f"it predicts left-out poses to {other.left_out_rms_px:.3f} px rms, {used} to "
                f"{mine.left_out_rms_px:.3f} px"
            )
        else:
            how = f"its residuals are {other.rms_px:.3f} px rms, those of {used} {mine.rms_px:.3f} px"
        return f"The data support the lens model {self.best}: {how}."


def choose_lens(
    views: Sequence[View], options: CalibrationOptions, wrong: Sequence[GrossStars] = ()
) -> Choice:
    """Choose the lens, and the model of the collimator if it is ``auto``.

    The collimator's model is chosen with k1 and k2, then the lens, then the collimator's model again if the lens
    changed. Own procedure.
    """
    first = _with_lens(views, options, "k1k2", wrong)
    found = compare_lenses(options, first.fit)
    if found.best == "k1k2":
        return replace(
            first, notes=(*first.notes, "The lens model k1k2 was kept: no richer one predicts better.")
        )
    last = _with_lens(views, options, found.best, wrong)
    return replace(last, notes=(*last.notes, found.sentence("k1k2")))


def compare_lenses(options: CalibrationOptions, fitted: Fit) -> LensComparison:
    """Compare lens models with the collimator's model of a fit, on some of its stars and without the gimbal's readings.

    Left-out poses decide from six poses on, as for collimator models; with fewer the Bayesian information criterion
    (Schwarz, 1978) decides.
    """
    used = lens_name(options.distortion)
    first = dict.fromkeys((used, *_RICHEST))
    found = _candidates(first, options, fitted)
    few = not enough_poses(fitted)
    if _best(found, few=few) == used:
        return LensComparison(found, used)
    found |= _candidates((lens for lens in LENSES if lens not in first), options, fitted)
    ordered = {name: found[name] for name in dict.fromkeys((*LENSES, used)) if name in found}
    return LensComparison(ordered, _best(ordered, few=few))


def _candidates(lenses: Iterable[str], options: CalibrationOptions, fitted: Fit) -> dict[str, Candidate]:
    """Fit lenses with the collimator's model of a fit, and return those that could be fitted."""
    found: dict[str, Candidate] = {}
    kept = [_thinned(view) for view in fitted.kept]
    without = replace(options, gimbal=None, guard_band=1.0)
    for lens in lenses:
        coefficients = DISTORTION_SETS.get(lens, tuple(options.distortion))
        try:
            one = fit_model(
                kept,
                replace(without, distortion=coefficients),
                fitted.model,
                leave_out=True,
                discs=fitted.discs or None,
                enlarge=False,
                near=fitted.parameters,
            )
        except CalibrationError:  # too many parameters for these views
            continue
        found[lens] = as_candidate(one)
    return found


def _best(found: Mapping[str, Candidate], *, few: bool) -> str:
    """Return the name of the first lens that predicts about as well as the best.

    With few poses a better one also needs strong evidence by the information criterion.
    """
    first = next(iter(found), "k1k2")
    predicted = {name: one.left_out_rms_px for name, one in found.items() if one.left_out_rms_px is not None}
    if not predicted:
        best = min(found, key=lambda name: found[name].bic, default=first)
        return best if found and found[best].bic < found[first].bic - _MIN_CRITERION else first
    best = min(predicted, key=lambda name: predicted[name])
    if few and found[best].bic > found[first].bic - _MIN_CRITERION:
        return first
    return next(name for name in predicted if predicted[name] <= predicted[best] / (1 - _MIN_IMPROVEMENT))


def lens_name(coefficients: str | Sequence[str]) -> str:
    """Return the name of a set of coefficients.

    coefficients: Names of the coefficients, in the order of their family.
    Returns: Name in `calib.model.camera.DISTORTION_SETS`; the joined coefficients if the set has no name.
    """
    known = {names: name for name, names in DISTORTION_SETS.items()}
    return known.get(tuple(coefficients), "".join(coefficients))


def _thinned(view: View) -> View:
    """Return a view with fewer stars, evenly spread over its list: enough to compare lenses."""
    kept = np.zeros(len(view), np.bool_)
    kept[:: max(1, len(view) // _COMPARED_STARS)] = True
    return view if kept.all() else part_of(view, kept)


def _with_lens(
    views: Sequence[View], options: CalibrationOptions, lens: str, wrong: Sequence[GrossStars]
) -> Choice:
    """Fit with one lens: the model that is asked for, or the one that the data choose."""
    chosen = replace(options, distortion=DISTORTION_SETS[lens])
    if options.model == "auto" and not options.passport:
        return choose(views, chosen, wrong)
    return Choice(fit_model(views, chosen, model_to_fit(chosen), wrong=wrong))
