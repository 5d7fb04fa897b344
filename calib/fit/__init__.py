"""Fit of a reference method to given views: starting values, adjustment, covariance.

The methods are the spherical model of arXiv:2512.16092, in which all views share one centre, and the planar model of
Zhang (2000), in which each view has its own. `calib.summary` turns a fit into a result.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.bundle import Bundle
from calib.adjustment.degeneracy import explain_weak_geometry, require_constrained, require_distinct_poses
from calib.adjustment.levenberg_marquardt import Refinement
from calib.adjustment.loss import Loss
from calib.adjustment.observations import Observations
from calib.adjustment.parameters import AdjustmentParameters
from calib.adjustment.poses import poses_of
from calib.calibration import CalibrationOptions
from calib.diagnosis.gross_stars import GrossStars, part_of, used_stars
from calib.errors import DegenerateViews, NotConverged
from calib.fit.robust import refine_robustly
from calib.fit.starts import initialize
from calib.uncertainty.covariance import Uncertainty, covariance_at_optimum, enlarged
from calib.uncertainty.cross_validation import MIN_VIEWS, CrossValidation, leave_one_out
from calib.uncertainty.passport_propagation import propagate_passport
from calib.uncertainty.repeats import views_of_poses
from calib.view import View


@dataclass(frozen=True)
class Fit:
    """A reference method at its optimum."""

    model: str
    views: Sequence[View]
    kept: Sequence[View]
    bundle: Bundle
    refined: Refinement
    loss: Loss
    whole: Bundle  # Bundle of all stars, also of those that were not used
    used: NDArray[np.bool_]  # (N,) bool, which stars of `whole` were used
    uncertainty: Uncertainty
    # Results for views left out; None if the views are consistent, or if there are too few.
    cross_validation: CrossValidation | None

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
    wrong: Sequence[GrossStars] = (),
) -> Fit:
    """Fit one model to views; values of a passport are held.

    model: ``spherical`` or ``planar``.
    leave_out: Whether to leave out each view in turn even if the views are consistent.
    wrong: Stars with a gross error, for each view; they are left out. None if there are none.
    Raises TooFewStars, DegenerateViews, NotConverged, InputMismatch: As `calib.engine.calibrate`.
    """
    used = used_stars(views, options.guard_band, wrong)
    kept = [view if own.all() else part_of(view, own) for view, own in zip(views, used, strict=True)]
    bundle, start = initialize(kept, options, model)
    refined, loss = refine_robustly(bundle, start, options)
    bundle = replace(bundle, poses=poses_of(refined.parameters.rotations))
    estimate = _constrained(kept, options, bundle, refined, loss)
    left_out = None
    if len(views_of_poses(bundle)) >= MIN_VIEWS and (leave_out or estimate.inconsistent):
        left_out = leave_one_out(bundle, refined.parameters, loss)
    passport = options.passport
    final = (
        enlarged(estimate)
        if passport is None
        else propagate_passport(bundle, refined.parameters, estimate, passport)
    )
    require_constrained(refined.parameters, final.names, final.covariance)
    everything = np.concatenate(used)
    whole = bundle if everything.all() else replace(bundle, observations=Observations.from_views(views))
    return Fit(model, views, kept, bundle, refined, loss, whole, everything, final, left_out)


def _constrained(
    views: Sequence[View], options: CalibrationOptions, bundle: Bundle, refined: Refinement, loss: Loss
) -> Uncertainty:
    """Refuse views that do not constrain the camera; else return the uncertainty if the model is right."""
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
    return estimate
