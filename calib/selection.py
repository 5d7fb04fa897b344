"""Which model the data support: each candidate predicts views it has not seen.

Knows fits and what leaving views out shows of them. The reprojection error cannot choose: a richer model always has
the smaller one. A camera is asked for directions, so the test is: with camera and centre held, how well does a
rotation alone explain a view that had no part in the calibration? The simplest model wins that does about as well as
the best.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.beam import visible_disc
from calib.calibration import Calibration, CalibrationOptions, Candidate
from calib.errors import CalibrationError
from calib.fit import Fit, fit, summary
from calib.imperfections import LADDER
from calib.resample import MIN_VIEWS
from calib.view import View

#: From the simplest; what all share comes first.
MODELS = (*LADDER, "drift", "planar")
#: A richer model must predict views better by this share to be worth its parameters.
_WORTH = 0.03


def choose(views: Sequence[View], options: CalibrationOptions) -> Calibration:
    """Fit every model and return the simplest that predicts views left out about as well as the best.

    With two views nothing can be left out; the spherical model is taken.

    Raises
    ------
    CalibrationError
        When no model can be fitted: the first one's reason.
    """
    discs = [visible_disc(view) for view in views]
    fits: list[Fit] = []
    errors: list[CalibrationError] = []
    for model in MODELS:
        try:
            fits.append(fit(views, options, model, leave_out=True, discs=discs))
        except CalibrationError as error:
            errors.append(error)
    if not fits:
        raise errors[0]
    chosen = fits[0] if len(views) < MIN_VIEWS else _simplest_of_the_best(fits)
    candidates = tuple(candidate(one) for one in fits)
    result = summary(chosen)
    return replace(result, candidates=candidates, notes=(*result.notes, _reason(chosen, fits)))


def candidate(fitted: Fit) -> Candidate:
    """Summarise a fit; BIC with each residual component as one Gaussian measurement."""
    misses = fitted.bundle.misses_px(fitted.state)
    shared = len(fitted.bundle.names)
    local = fitted.state.rotations.shape[0] * (6 if fitted.bundle.free_centres else 3)
    mean_square = float((misses**2).mean())
    bic = misses.size * np.log(mean_square) + (shared + local) * np.log(misses.size)
    rms = float(np.sqrt(2.0 * mean_square))
    return Candidate(fitted.model, shared + local, rms, _left_out(fitted), float(bic))


def _simplest_of_the_best(fits: Sequence[Fit]) -> Fit:
    """Return the first that predicts within a few per cent of the best."""
    predicted = [np.inf if one.left_out is None else one.left_out.total_rms_px for one in fits]
    return next(one for one, rms in zip(fits, predicted, strict=True) if rms <= (1 + _WORTH) * min(predicted))


def _left_out(fitted: Fit) -> float | None:
    """Return the rms residual of views left out, px."""
    return None if fitted.left_out is None else fitted.left_out.total_rms_px


def _reason(chosen: Fit, fits: Sequence[Fit]) -> str:
    """Say why a model was chosen, and what came next."""
    if chosen.left_out is None:
        return f"Two views cannot choose between models; the {chosen.model} one was taken."
    others = [one for one in fits if one is not chosen and one.left_out is not None]
    text = (
        f"The {chosen.model} model was chosen: it predicts a view left out to {_left_out(chosen):.3f} px rms"
    )
    if not others:
        return f"{text}."
    second = min(others, key=lambda one: _left_out(one) or np.inf)
    return f"{text}; next is the {second.model} model with {_left_out(second):.3f} px."
