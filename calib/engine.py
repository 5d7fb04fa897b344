"""From views to a calibrated camera: `calibrate` checks its input, and fits or chooses a model."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from calib.calibration import Calibration, CalibrationOptions, Candidate, ModelName, ViewSummary
from calib.errors import DegenerateViews, InputMismatch
from calib.fit import fit_model
from calib.model.aberrations import model_with_terms
from calib.model.passport import Passport
from calib.selection import choose
from calib.summary import summarize
from calib.view import View

__all__ = ["Calibration", "CalibrationOptions", "Candidate", "ViewSummary", "calibrate"]


def calibrate(views: Sequence[View], options: CalibrationOptions | None = None) -> Calibration:
    """Calibrate a camera from views of the star target through a collimator.

    The method is that of arXiv:2512.16092, extended by aberrations, passports and uncertainties.

    Parameters
    ----------
    views
        Two or more poses of one camera; with a passport, one or more.
    options
        Model, distortion, loss, passport and guard band; None for the defaults.

    Returns
    -------
    Calibration
        Intrinsics, distortion, collimator and rotations, with their covariance.

    Raises
    ------
    InputMismatch
        If views contradict each other (image sizes, names) or show the target mirrored.
    TooFewStars
        If a view has fewer than 4 stars.
    DegenerateViews
        If the views do not constrain the camera; says why.
    PassportContradicted
        If the views contradict the passport.
    NotConverged
        If the adjustment did not reach an optimum.
    """
    options = options or CalibrationOptions()
    _check(views, 1 if options.passport else 2)
    if options.passport:
        return summarize(fit_model(views, options, _model_with_passport(options.model, options.passport)))
    if options.model == "auto":
        return choose(views, options)
    return summarize(fit_model(views, options, options.model))


def _model_with_passport(model: ModelName, passport: Passport) -> str:
    """Return the model to fit if the collimator has a passport.

    A certificate states the radius on the axis; the radial term is what it does not state. A passport from views holds
    the terms of its own model.
    """
    if passport.is_certificate:
        return "radial" if model == "auto" else model
    return model_with_terms(passport.terms)


def _check(views: Sequence[View], fewest: int) -> None:
    """Refuse views that do not belong together, or are too few."""
    if len(views) < fewest:
        or_passport = ", or give a collimator's passport" if len(views) == 1 else ""
        raise DegenerateViews(
            f"{len(views)} view{'s' if len(views) != 1 else ''} given; at least {fewest} needed.",
            remedy=f"Record the target from more angles{or_passport}.",
        )
    sizes = sorted({view.image_size for view in views})
    if len(sizes) > 1:
        shown = ", ".join(f"{width} x {height}" for width, height in sizes)
        raise InputMismatch(
            f"Views of different image sizes: {shown}.", remedy="Calibrate one camera at a time."
        )
    name, times = Counter(view.name for view in views).most_common(1)[0]
    if times > 1:
        raise InputMismatch(f"{times} views are named {name!r}.", remedy="Give each view its own name.")
