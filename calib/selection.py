"""Choice of the model: each candidate predicts views that it has not seen.

The reprojection error cannot choose, because a richer model always has a smaller one. A camera is used for directions,
so the criterion is: with camera and centre held, how well does a rotation alone explain a view that had no part in the
calibration? The simplest model within a few per cent of the best is chosen.

Few views cannot spare one, because predictions from two or three views extrapolate. With fewer than six views the
Bayesian information criterion therefore chooses a model of the ladder. On 100 sets of three of the
published views, the focal lengths of the chosen models scatter by 15 px, less than those of any single model.

References
----------
- Schwarz (1978), Estimating the dimension of a model, Annals of Statistics 6, 461.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib.adjustment.degeneracy import MAX_FOCAL_SIGMA
from calib.calibration import CalibrationOptions, Candidate
from calib.diagnosis.gross_stars import GrossStars
from calib.errors import CalibrationError
from calib.fit import Fit, fit_model, with_uncertainty
from calib.model.aberrations import LADDER, needs_rim
from calib.model.beam import visible_discs
from calib.view import View

#: All models, from the simplest.
MODELS = (*LADDER, "drift", "planar")
#: A richer model is chosen only if it predicts views better by this share.
_MIN_IMPROVEMENT = 0.03
#: From this number of poses on, left-out poses decide.
_ENOUGH_VIEWS = 6
_KEPT_RADIAL = (
    "The radial model is used instead: these views cannot exclude a bow of the reticle or a distortion of the "
    "collimator that would change the focal length, and the uncertainties include it."
)


@dataclass(frozen=True)
class Choice:
    """A model that the data chose."""

    fit: Fit
    candidates: tuple[Candidate, ...] = ()
    notes: tuple[str, ...] = ()  # Which models could not be compared, and the reason for the choice


def choose(views: Sequence[View], options: CalibrationOptions, wrong: Sequence[GrossStars] = ()) -> Choice:
    """Fit every model and return the best.

    With six or more views, that is the simplest model that predicts left-out views about as well as the best. With
    fewer views, it is the model of the ladder with the smallest Bayesian information criterion.

    Raises CalibrationError: If no model can be fitted: the error of the first one.
    """
    discs = visible_discs(views)
    fits: list[Fit] = []
    errors: dict[str, CalibrationError] = {}
    for model in MODELS:
        try:
            near = fits[0].parameters if fits else None
            fits.append(
                fit_model(
                    views,
                    options,
                    model,
                    leave_out=True,
                    discs=discs,
                    wrong=wrong,
                    enlarge=False,
                    near=near,
                )
            )
        except CalibrationError as error:
            errors[model] = error
    if not fits:
        raise next(iter(errors.values()))
    candidates = tuple(as_candidate(one) for one in fits)
    few = not enough_poses(fits[0])
    eligible, notes = _eligible(fits), _not_fitted(errors)
    best = _by_criterion(candidates, eligible) if few else _by_prediction(candidates, eligible)
    place = best
    if candidates[best].model == "spherical" and options.radial_sigma is None:
        place = next(iter(_first(candidates, "radial")), best)
    reason = _reason(best, candidates, eligible, few=few, used=place == best)
    chosen = with_uncertainty(fits[place], options)
    if not _is_constrained(chosen):
        # No other model takes its place: one that predicts worse and states a smaller uncertainty is biased.
        notes.append(f"The {candidates[place].model} model explains the views, but does not determine fx.")
    return Choice(chosen, candidates, (*notes, reason))


def _is_constrained(fitted: Fit) -> bool:
    """Tell whether a fit determines the focal length with its final uncertainty."""
    at = fitted.uncertainty.names.index("fx")
    sigma = float(np.sqrt(fitted.uncertainty.covariance[at, at]))
    return sigma <= MAX_FOCAL_SIGMA * fitted.parameters.camera.fx


def _first(candidates: Sequence[Candidate], model: str) -> list[int]:
    """Return the index of a model, if it was fitted."""
    return [i for i, one in enumerate(candidates) if one.model == model][:1]


def enough_poses(fitted: Fit) -> bool:
    """Tell whether there are enough poses to leave one out.

    Returns: True from six poses on; repeats of a pose count once.
    """
    return max(fitted.bundle.poses or (0,)) + 1 >= _ENOUGH_VIEWS


def as_candidate(fitted: Fit) -> Candidate:
    """Summarise a fit for the comparison.

    The Bayesian information criterion (Schwarz, 1978) counts each residual component as one Gaussian measurement.
    """
    residuals = fitted.bundle.residuals_px(fitted.parameters)
    shared = len(fitted.bundle.names)
    local = fitted.parameters.rotations.shape[0] * (6 if fitted.bundle.free_centres else 3)
    mean_square = float((residuals**2).mean())
    bic = residuals.size * np.log(mean_square) + (shared + local) * np.log(residuals.size)
    rms = float(np.sqrt(2.0 * mean_square))
    unseen = None if fitted.cross_validation is None else fitted.cross_validation.total_rms_px
    return Candidate(fitted.model, shared + local, rms, unseen, float(bic))


def _eligible(fits: Sequence[Fit]) -> list[int]:
    """Return the indices of the fits that may be chosen.

    Readings of the gimbal that entered weigh more than the freedom of models that cannot use them.
    """
    used = [i for i, one in enumerate(fits) if one.bundle.gimbal is not None]
    return used or list(range(len(fits)))


def _by_prediction(candidates: Sequence[Candidate], eligible: Sequence[int]) -> int:
    """Return the index of the first model that predicts left-out views within a few per cent of the best."""
    best = min(_predicted(candidates[i]) for i in eligible)
    return next(i for i in eligible if _predicted(candidates[i]) <= (1 + _MIN_IMPROVEMENT) * best)


def _by_criterion(candidates: Sequence[Candidate], eligible: Sequence[int]) -> int:
    """Return the index of the model of the ladder with the smallest information criterion; else of the first model."""
    judged = _judged_by_criterion(candidates, eligible)
    return min(judged or [eligible[0]], key=lambda i: candidates[i].bic)


def _judged_by_criterion(candidates: Sequence[Candidate], eligible: Sequence[int]) -> list[int]:
    """Return the indices of the candidates that the information criterion may choose: the models of the ladder.

    If the rim of the beam is out of view, only the models without a rim are left. The drift model is then compared with
    them, as it follows what an imperfect collimator does: on 60 sets of three of the published views it halves the
    scatter of fx, from 37 px to 20 px.
    """
    rungs = [i for i in eligible if candidates[i].model in LADDER]
    drifts = [i for i in eligible if candidates[i].model == "drift"]
    with_rim = any(needs_rim(LADDER[candidates[i].model]) for i in rungs)
    return rungs if with_rim else sorted(rungs + drifts)


def _not_fitted(errors: Mapping[str, CalibrationError]) -> list[str]:
    """Return notes on the models that could not be fitted; models with the same reason are named together."""
    reasons = dict.fromkeys(error.what for error in errors.values())
    return [
        f"Not compared: {', '.join(model for model, error in errors.items() if error.what == reason)}. {reason}"
        for reason in reasons
    ]


def _predicted(one: Candidate) -> float:
    """Return the root mean square residual of left-out views, px; infinite if it was not measured."""
    return np.inf if one.left_out_rms_px is None else one.left_out_rms_px


def _reason(
    place: int, candidates: Sequence[Candidate], eligible: Sequence[int], *, few: bool, used: bool
) -> str:
    """Return why a model is the best one, which is the next best, and why the radial model is used if this is not."""
    chosen, was = candidates[place].model, "was" if used else "would be"
    found = _best_and_next(place, candidates, eligible, few=few)
    return f"The {chosen} model {was} chosen{found}" + ("" if used else f" {_KEPT_RADIAL}")


def _best_and_next(place: int, candidates: Sequence[Candidate], eligible: Sequence[int], *, few: bool) -> str:
    """Return the figure by which a model was chosen, and that of the next best."""
    chosen = candidates[place]
    others = [candidates[i] for i in eligible if i != place]
    if few:
        text = f" by the Bayesian information criterion ({chosen.bic:.0f})"
        rivals = [candidates[i] for i in _judged_by_criterion(candidates, eligible) if i != place]
        second = min(rivals, key=lambda one: one.bic, default=None)
        return (
            f"{text}; the next best is the {second.model} model ({second.bic:.0f})." if second else f"{text}."
        )
    text = f": it predicts left-out views to {_predicted(chosen):.3f} px rms"
    second = min(others, key=_predicted, default=None)
    return (
        f"{text}; the next best is the {second.model} model ({_predicted(second):.3f} px rms)."
        if second
        else f"{text}."
    )
