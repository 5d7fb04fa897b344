"""Which model the data support: each candidate predicts views it has not seen.

Knows fits and what leaving views out shows of them. The reprojection error cannot choose: a richer model always has
the smaller one. A camera is asked for directions, so the test is: with camera and centre held, how well does a
rotation alone explain a view that had no part in the calibration? The simplest model wins that does about as well as
the best. Few views cannot spare one: left-out errors of two or three views extrapolate, and choosing by them scatters
more than any model does. There, the Bayesian information criterion chooses a rung of the ladder: on 100 sets of three
of the published views the focal length it leads to scatters by 15 px, less than any one rung's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from calib.calibration import Calibration, CalibrationOptions, Candidate
from calib.errors import CalibrationError
from calib.fit import Fit, fit_model, summarize
from calib.model.aberrations import LADDER
from calib.model.beam import visible_discs
from calib.view import View

#: From the simplest; what all share comes first.
MODELS = (*LADDER, "drift", "planar")
#: A richer model must predict views better by this share to be worth its parameters.
_WORTH = 0.03
#: From this number of views on, leaving one out leaves enough to judge by.
_ENOUGH_VIEWS = 6


def choose(views: Sequence[View], options: CalibrationOptions) -> Calibration:
    """Fit every model and return the simplest that predicts views left out about as well as the best.

    With fewer than 6 views: the rung of the ladder with the smallest information criterion.

    Raises
    ------
    CalibrationError
        When no model can be fitted: the first one's reason.
    """
    discs = visible_discs(views)
    fits: list[Fit] = []
    errors: dict[str, CalibrationError] = {}
    for model in MODELS:
        try:
            fits.append(fit_model(views, options, model, leave_out=True, discs=discs))
        except CalibrationError as error:
            errors[model] = error
    if not fits:
        raise next(iter(errors.values()))
    candidates = tuple(as_candidate(one) for one in fits)
    few = len(views) < _ENOUGH_VIEWS
    place = _by_criterion(candidates) if few else _by_prediction(candidates)
    result, reason = summarize(fits[place]), _reason(place, candidates, few=few)
    return replace(result, candidates=candidates, notes=(*result.notes, *_not_fitted(errors), reason))


def as_candidate(fitted: Fit) -> Candidate:
    """Summarise a fit; BIC with each residual component as one Gaussian measurement."""
    residuals = fitted.bundle.residuals_px(fitted.parameters)
    shared = len(fitted.bundle.names)
    local = fitted.parameters.rotations.shape[0] * (6 if fitted.bundle.free_centres else 3)
    mean_square = float((residuals**2).mean())
    bic = residuals.size * np.log(mean_square) + (shared + local) * np.log(residuals.size)
    rms = float(np.sqrt(2.0 * mean_square))
    unseen = None if fitted.cross_validation is None else fitted.cross_validation.total_rms_px
    return Candidate(fitted.model, shared + local, rms, unseen, float(bic))


def _by_prediction(candidates: Sequence[Candidate]) -> int:
    """Return the first that predicts views left out within a few per cent of the best."""
    predicted = [_predicted(one) for one in candidates]
    return next(i for i, rms in enumerate(predicted) if rms <= (1 + _WORTH) * min(predicted))


def _by_criterion(candidates: Sequence[Candidate]) -> int:
    """Return the rung of the ladder with the smallest information criterion; else the first model at hand."""
    return min(_judged_by_criterion(candidates) or [0], key=lambda i: candidates[i].bic)


def _judged_by_criterion(candidates: Sequence[Candidate]) -> list[int]:
    """Return which candidates an information criterion may choose: the ladder's rungs.

    Where the beam's rim is out of sight there is but one, and the drift model follows what an imperfect collimator
    does: on 60 sets of three of the published views it halves the scatter of fx, 20 px against 37 px.
    """
    rungs = [i for i, one in enumerate(candidates) if one.model in LADDER]
    drifts = [i for i, one in enumerate(candidates) if one.model == "drift"]
    return rungs if len(rungs) > 1 else sorted(rungs + drifts)


def _not_fitted(errors: Mapping[str, CalibrationError]) -> list[str]:
    """Say which models could not be fitted, and why; those of one reason together."""
    reasons = dict.fromkeys(error.what for error in errors.values())
    return [
        f"Not compared: {', '.join(model for model, error in errors.items() if error.what == reason)}. {reason}"
        for reason in reasons
    ]


def _predicted(one: Candidate) -> float:
    """Return the rms residual of views left out, px; what was not measured loses every comparison."""
    return np.inf if one.left_out_rms_px is None else one.left_out_rms_px


def _reason(place: int, candidates: Sequence[Candidate], *, few: bool) -> str:
    """Say why a model was chosen, and what came next."""
    chosen = candidates[place]
    others = [one for i, one in enumerate(candidates) if i != place]
    if few:
        text = f"The {chosen.model} model was chosen by the Bayesian information criterion ({chosen.bic:.0f})"
        rivals = [candidates[i] for i in _judged_by_criterion(candidates) if i != place]
        second = min(rivals, key=lambda one: one.bic, default=None)
        return (
            f"{text}; the next best is the {second.model} model ({second.bic:.0f})." if second else f"{text}."
        )
    text = (
        f"The {chosen.model} model was chosen: it predicts left-out views to {_predicted(chosen):.3f} px rms"
    )
    second = min(others, key=_predicted, default=None)
    return (
        f"{text}; the next best is the {second.model} model ({_predicted(second):.3f} px rms)."
        if second
        else f"{text}."
    )
