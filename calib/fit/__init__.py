"""Fit of one model to given views: starting values, adjustment, covariance.

This module fixes the order of these steps and the free parameters of each model. `calib.selection` chooses the model,
and `calib.summary` turns a fit into a result.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.bundle import Bundle
from calib.adjustment.collimator_terms import add_terms
from calib.adjustment.degeneracy import (
    explain_weak_geometry,
    require_constrained,
    require_distinct_poses,
    require_visible_rims,
)
from calib.adjustment.levenberg_marquardt import Loss, Refinement, refine
from calib.adjustment.observations import Observations
from calib.adjustment.parameters import AdjustmentParameters
from calib.adjustment.poses import poses_of
from calib.adjustment.readings import ReadingsTest, with_turns
from calib.calibration import CalibrationOptions
from calib.diagnosis.gross_stars import GrossStars, part_of
from calib.errors import DegenerateViews, NotConverged
from calib.fit.readings import with_readings
from calib.fit.robust import refine_robustly
from calib.fit.starts import initialize
from calib.model.aberrations import LADDER, model_with_terms, needs_rim
from calib.model.beam import Disc, inside_guard_band, visible_discs
from calib.uncertainty.common_errors import add_common_errors, common_errors
from calib.uncertainty.consistency import check_passport
from calib.uncertainty.covariance import (
    Uncertainty,
    covariance_at_optimum,
    inflate,
)
from calib.uncertainty.cross_validation import MIN_VIEWS, CrossValidation, leave_one_out
from calib.uncertainty.field_equations import FieldEquations
from calib.uncertainty.passport_propagation import (
    add_certificate,
    add_parallax,
    certificate_share,
    propagate_passport,
)
from calib.uncertainty.repeats import views_of_poses
from calib.uncertainty.variance_components import variance_components
from calib.view import View

Array = NDArray[np.float64]

#: Models that the gimbal's readings do not enter: they free the centre of each view.
WITHOUT_READINGS = ("drift", "planar")


@dataclass(frozen=True)
class Fit:
    """A model at its optimum."""

    model: str
    views: Sequence[View]
    kept: Sequence[View]
    bundle: Bundle
    refined: Refinement
    loss: Loss
    whole: Bundle
    used: NDArray[np.bool_]  # (N,) bool, which stars of `whole` were used
    uncertainty: Uncertainty
    # Results for views left out; None if it was not done, or if there are too few views.
    cross_validation: CrossValidation | None
    discs: Sequence[Disc] = ()  # The visible discs of the views; none if the model does not depend on them
    # Whether the gimbal's readings agree with the stars; None if they did not take part. They entered the
    # estimate if `bundle` has them.
    readings: ReadingsTest | None = None
    # Bundle, end and loss of the adjustment that the readings were added to; None if there were no readings.
    before_readings: tuple[Bundle, Refinement, Loss] | None = None

    @property
    def parameters(self) -> AdjustmentParameters:
        """The parameters at the optimum."""
        return self.refined.parameters


def fit_model(
    views: Sequence[View],
    options: CalibrationOptions,
    model: str,
    *,
    leave_out: bool = False,
    discs: Sequence[Disc] | None = None,
    wrong: Sequence[GrossStars] = (),
    enlarge: bool = True,
    near: AdjustmentParameters | None = None,
) -> Fit:
    """Fit one model to views.

    model: A model of `calib.model.aberrations.LADDER`, ``drift`` or ``planar``. Terms of a passport are held.
    leave_out: Whether to leave out each view in turn even if the views are consistent.
    discs: The visible discs of the views, if they are known already.
    wrong: Stars with a gross error, for each view; they are left out. None if there are none.
    enlarge: Whether to enlarge the uncertainty of inconsistent views at once; else `with_uncertainty` does it
      later.
    near: The end of another model's fit to the same views, as the start; None to compare starts.
    Raises TooFewStars, DegenerateViews, NotConverged, InputMismatch, PassportContradicted: As
      `calib.engine.calibrate`.
    """
    passport = options.passport
    held = passport.terms if passport else ()
    free = tuple(term for term in LADDER.get(model, ()) if term not in held)
    terms = (*held, *free)
    discs = _discs_with_rims(views, discs) if needs_rim(terms) or options.guard_band < 1 else ()
    used = _used_stars(views, discs, options.guard_band, wrong)
    kept = _used_parts(views, used)
    bundle, start = initialize(kept, options, model, near)
    if terms:
        if not held:
            start = refine(bundle, start, Loss("l2"), options.max_iterations).parameters
        bundle, start = add_terms(kept, discs, bundle, start, free, passport, options.radial_sigma)
    if model == "drift":
        bundle = replace(bundle, free_centres=True, drift_mm=options.drift_mm)
    bundle, refined, loss = refine_robustly(bundle, start, options)
    if passport:
        bundle = replace(bundle, poses=poses_of(refined.parameters.rotations))
        check_passport(bundle, refined.parameters, loss, passport, options.budget, options.parallax_sigma)
    test = before = None
    if options.gimbal and options.gimbal.parallax and model not in WITHOUT_READINGS:
        before = (bundle, refined, loss)
        bundle, refined, loss, test = with_readings(kept, discs, bundle, refined, loss, options)
    bundle = replace(bundle, poses=poses_of(refined.parameters.rotations))
    estimate, left_out = _constrained(kept, options, bundle, refined, loss, leave_out=leave_out)
    whole = bundle if used.all() else _with_all_stars(views, discs, bundle, refined.parameters)
    shown = discs if needs_rim(terms) else ()
    found = Fit(
        model, views, kept, bundle, refined, loss, whole, used, estimate, left_out, shown, test, before
    )
    return with_uncertainty(found, options) if enlarge else found


def without_readings(fitted: Fit, options: CalibrationOptions) -> Fit:
    """Return the fit to the same stars without the gimbal's readings.

    Raises DegenerateViews, NotConverged: As `fit_model`.
    """
    assert fitted.before_readings is not None
    bundle, refined, loss = fitted.before_readings
    bundle = replace(bundle, poses=poses_of(refined.parameters.rotations))
    estimate, left_out = _constrained(fitted.kept, options, bundle, refined, loss, leave_out=False)
    whole = bundle
    if not fitted.used.all():
        whole = _with_all_stars(fitted.views, fitted.discs, bundle, refined.parameters)
    found = replace(
        fitted,
        bundle=bundle,
        refined=refined,
        loss=loss,
        whole=whole,
        uncertainty=estimate,
        cross_validation=left_out,
        readings=None,
        before_readings=None,
    )
    return with_uncertainty(found, replace(options, gimbal=None))


def model_to_fit(options: CalibrationOptions) -> str:
    """Return the model to fit if the data do not choose it.

    A certificate states the radius on the axis; it does not state the radial terms, which are then free. A passport
    from views holds the terms of its own model.

    Returns: A model of `calib.model.aberrations.LADDER`, ``drift`` or ``planar``.
    """
    passport = options.passport
    if passport is None:
        return options.model
    if passport.is_certificate:
        return "radial" if options.model == "auto" else options.model
    return model_with_terms(passport.terms)


def _discs_with_rims(views: Sequence[View], discs: Sequence[Disc] | None) -> Sequence[Disc]:
    """Return the visible discs; refuse views if most of them do not show the rim."""
    discs = discs or visible_discs(views)
    require_visible_rims(views, discs)
    return discs


def _used_parts(views: Sequence[View], used: NDArray[np.bool_]) -> Sequence[View]:
    """Return the views with their used stars; a view whose stars are all used is the same object."""
    if used.all():
        return views
    ends = np.cumsum([len(view) for view in views])
    return [
        view if own.all() else part_of(view, own)
        for view, own in zip(views, np.split(used, ends[:-1]), strict=True)
    ]


def _with_all_stars(
    views: Sequence[View], discs: Sequence[Disc], bundle: Bundle, parameters: AdjustmentParameters
) -> Bundle:
    """Return the bundle with the stars that were left out too."""
    whole = replace(bundle, observations=Observations.from_views(views))
    return with_turns(views, discs, whole, parameters) if bundle.displacements is not None else whole


def _used_stars(
    views: Sequence[View], discs: Sequence[Disc], share: float, wrong: Sequence[GrossStars]
) -> NDArray[np.bool_]:
    """Return which stars are neither in a guard band nor a gross error, (N,) bool."""
    used = [np.ones(len(view), np.bool_) for view in views]
    if share < 1.0:
        used = [inside_guard_band(view, disc, share) for view, disc in zip(views, discs, strict=True)]
    if not wrong:
        return np.concatenate(used)
    return np.concatenate([own & ~found.wrong for own, found in zip(used, wrong, strict=True)])


def _constrained(
    views: Sequence[View],
    options: CalibrationOptions,
    bundle: Bundle,
    refined: Refinement,
    loss: Loss,
    *,
    leave_out: bool,
) -> tuple[Uncertainty, CrossValidation | None]:
    """Refuse views that do not constrain the camera; else return the uncertainty and the cross-validation."""
    parameters = refined.parameters
    if options.passport is None:
        require_distinct_poses(parameters)
    try:
        estimate = covariance_at_optimum(bundle, parameters, loss)
        require_constrained(parameters, bundle.names, estimate.covariance)
    except DegenerateViews as error:
        why = explain_weak_geometry(views, parameters)
        raise DegenerateViews(f"{error.what} {why}".strip(), remedy=error.remedy) from error
    if not refined.converged:
        why = explain_weak_geometry(views, parameters)
        raise NotConverged(
            f"The adjustment did not converge within {refined.iterations} steps. {why}".strip(),
            remedy="Add views from other angles, or estimate fewer distortion coefficients.",
        )
    left_out = None
    if len(views_of_poses(bundle)) >= MIN_VIEWS and (leave_out or estimate.inconsistent):
        left_out = leave_one_out(bundle, parameters, loss)
    return estimate, left_out


def with_uncertainty(fitted: Fit, options: CalibrationOptions) -> Fit:
    """Return a fit with its final uncertainty: enlarged if the views are inconsistent, with the passport's share.

    Variance components: Patterson and Thompson (1971). Scores: Bell and McCaffrey (2002). Passport: consider covariance
    (Tapley, Schutz and Born, 2004, chapter 6).

    fitted: A fit with the uncertainty that holds if its model is right.
    Raises DegenerateViews: If the views do not constrain the camera with this passport.
    """
    bundle, parameters, loss = fitted.bundle, fitted.parameters, fitted.loss
    estimate, passport = fitted.uncertainty, options.passport
    at_optimum = cache(partial(FieldEquations, bundle, parameters, loss))
    if passport is None or passport.is_certificate:
        estimate = inflate(
            estimate,
            bundle,
            parameters,
            loss,
            lambda: variance_components(bundle, parameters, loss, at_optimum()),
        )
    unbounded = passport is None and bundle.gimbal is None and fitted.model != "planar"
    if unbounded and estimate.inconsistent:
        estimate = add_parallax(parameters, estimate, options.parallax_sigma)
    if passport is not None:
        if not passport.is_certificate:
            estimate = propagate_passport(bundle, parameters, estimate, passport)
        elif "r" in bundle.names:
            estimate = certificate_share(bundle, parameters, estimate, passport)
        else:
            estimate = add_certificate(bundle, parameters, estimate, passport)
        why = "The passport does not constrain it either."
        require_constrained(parameters, estimate.names, estimate.covariance, why)
    if passport is None or passport.is_certificate:
        estimate = add_common_errors(
            estimate, bundle, lambda: common_errors(bundle, parameters, loss, at_optimum())
        )
    return replace(fitted, uncertainty=estimate)
