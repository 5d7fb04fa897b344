"""From views to a calibrated camera: `calibrate` checks its input, and fits or chooses a model."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

from calib.adjustment.bundle import Bundle
from calib.adjustment.observations import Observations
from calib.calibration import Calibration, CalibrationOptions, Candidate, ViewSummary
from calib.diagnosis.checks import check_adjustment, check_views
from calib.diagnosis.gross_stars import GrossStars, find_gross_stars, without_gross_stars
from calib.errors import DegenerateViews, InputMismatch
from calib.fit import Fit, fit_model, model_to_fit, without_readings
from calib.joint.result import calibrate_jointly
from calib.lens_choice import choose_lens, compare_lenses, lens_name
from calib.model.camera import PINHOLE
from calib.model.collimator import Collimator
from calib.model.type_b_terms import corrected_passport, corrected_views
from calib.selection import Choice, choose, enough_poses
from calib.summary import expanded_focal_px, summarize
from calib.view import View

__all__ = ["Calibration", "CalibrationOptions", "Candidate", "ViewSummary", "calibrate"]


def calibrate(views: Sequence[View], options: CalibrationOptions | None = None) -> Calibration:
    """Calibrate a camera from views of the star target through a collimator.

    The method is that of arXiv:2512.16092, extended by aberrations, passports and uncertainties.

    Parameters
    ----------
    views
        Two or more poses of one camera; one is enough with a passport that holds more than the radius.
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
    _check(views, 1 if options.passport and not options.passport.is_certificate else 2)
    options, views = _corrected(options, views)
    wrong = find_gross_stars(views)
    known_r = options.passport.values_by_name["r"] if options.passport else None
    doubts = check_views(without_gross_stars(views, wrong), known_r_mm=known_r)
    if options.model == "joint":
        return _jointly(views, options, wrong, doubts)
    choice = _choice(views, options, wrong)
    lens = ""
    if choice.fit.uncertainty.inconsistent and not options.compares_lenses:
        lens = compare_lenses(options, choice.fit).sentence(lens_name(options.distortion))
    result = summarize(choice.fit, options, lens)
    if not enough_poses(choice.fit):
        result = _without_readings_that_widen(result, choice.fit, options, lens)
    named = (one.sentence for one in wrong if one.sentence)
    notes = (*named, *doubts, *result.notes, *choice.notes)
    remarks = (*result.remarks, *choice.notes)
    return replace(result, candidates=choice.candidates, notes=notes, remarks=remarks)


def _jointly(
    views: Sequence[View], options: CalibrationOptions, wrong: Sequence[GrossStars], doubts: Sequence[str]
) -> Calibration:
    """Return the result of the joint adjustment, with the checks of wrong data."""
    result, parameters = calibrate_jointly(views, options, wrong)
    named = tuple(one.sentence for one in wrong if one.sentence)
    kept = without_gross_stars(views, wrong)
    names = tuple(name for name in result.parameter_names if name in (*PINHOLE, "x", "y", "r"))
    bundle = Bundle(Observations.from_views(kept), names)
    ideal = Collimator(parameters.collimator.x, parameters.collimator.y, parameters.collimator.r)
    shown = replace(parameters, collimator=ideal, gimbal=None)
    found = check_adjustment(kept, bundle, shown, result.sigma)
    return replace(result, notes=(*named, *doubts, *result.notes, *found))


def _corrected(
    options: CalibrationOptions, views: Sequence[View]
) -> tuple[CalibrationOptions, Sequence[View]]:
    """Apply the corrections that the budget states as known: to the target's scale and to a certificate's radius."""
    if options.passport:
        options = replace(options, passport=corrected_passport(options.passport, options.budget))
    return options, corrected_views(views, options.budget)


def _choice(views: Sequence[View], options: CalibrationOptions, wrong: Sequence[GrossStars]) -> Choice:
    """Fit the model that is asked for, or let the data choose."""
    if options.compares_lenses:
        return choose_lens(views, options, wrong)
    if options.model == "auto" and not options.passport:
        return choose(views, options, wrong)
    return Choice(fit_model(views, options, model_to_fit(options), wrong=wrong))


def _without_readings_that_widen(
    joint: Calibration, fitted: Fit, options: CalibrationOptions, lens: str
) -> Calibration:
    """Return the result of the certificate alone if readings of few poses make its uncertainty larger.

    Few poses determine hardly how much the readings disagree with the stars. The coverage factor for so few degrees of
    freedom can cost more than the readings bring.
    """
    certificate = options.passport is not None and options.passport.is_certificate
    if not certificate or joint.gimbal is None or not joint.gimbal.entered:
        return joint
    alone, options = without_readings(fitted, options), replace(options, gimbal=None)
    with_readings, without = joint.coverage_factor * joint.sigma["fx"], expanded_focal_px(alone, options)
    if without >= with_readings:
        return joint
    note = (
        "The readings of the gimbal did not enter. With so few poses they would enlarge the expanded uncertainty of "
        f"fx from {without:.1f} to {with_readings:.1f} px. The certificate determines the radius. Add poses to use the "
        "readings."
    )
    result = summarize(alone, options, lens)
    return replace(result, notes=(*result.notes, note), remarks=(*result.remarks, note))


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
