"""Fit of a reference method to given views, and its result: starting values, adjustment, covariance, notes.

The methods are the spherical model of arXiv:2512.16092 and the planar model of Zhang (2000).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.adjustment.bundle import Bundle, Observations
from calib.adjustment.initialization import initialized
from calib.adjustment.levenberg_marquardt import Refinement, refine
from calib.adjustment.loss import Loss, lengths
from calib.adjustment.parameters import (
    AdjustmentParameters,
    explain_weak_geometry,
    poses_of,
    require_constrained,
    require_distinct_poses,
)
from calib.arrays import RAYLEIGH_MEDIAN, Bools, median
from calib.calibration import Calibration, CalibrationOptions, ViewSummary, rms_and_mean
from calib.diagnosis.gross_stars import GrossStars, used_stars
from calib.errors import DegenerateViews, NotConverged
from calib.model import result_parts as names
from calib.model.camera import CameraModel
from calib.model.result_parts import ROW_QUANTITIES, BudgetRow
from calib.uncertainty.covariance import (
    Uncertainty,
    covariance_at_optimum,
    leave_one_out,
    rotation_covariance,
)
from calib.uncertainty.projection_uncertainty import worst_point
from calib.view import View

#: Limit of the robust loss in robust standard deviations per axis: 4 % of right residuals reach it. And the number of
#: times it is estimated again, each from the last optimum: one more moves it by 0.1 % on real views.
_LIMIT_SIGMAS = 2.5
_LIMIT_ROUNDS = 3

#: Views are reported as weak if the 1-sigma of a focal length, as a share of it, reaches this: a data sheet says nearly
#: as much.
_WEAK_FOCAL_SIGMA = 0.01
_SOURCES = {
    names.STARS: "residuals of the points",
    names.POSE_FIELDS: "differences between the views",
}
#: What describes views that differ by more than noise.
_OTHERWISE = {
    "spherical": "The joint adjustment describes such errors.",
    "planar": "The lens may need other coefficients (such as k1k2k3p1p2 or fisheye), the target may not be flat, or "
    "the focus changed. Behind a collimator, the joint adjustment describes such errors.",
}


@dataclass(frozen=True)
class Fit:
    """A reference method at its optimum."""

    model: str
    views: Sequence[View]
    bundle: Bundle  # Of the stars that were used
    refined: Refinement[AdjustmentParameters]
    loss: Loss
    used: Bools  # (N,) bool, which stars of all views were used
    uncertainty: Uncertainty
    # Root mean square residual of views left out, px; None if the views are consistent, or if there are too few.
    left_out_rms_px: float | None

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
    """Fit ``spherical`` or ``planar`` to views without wrong stars; values of a passport are held as exact.

    ``leave_out`` leaves out each view in turn even if the views are consistent. Errors as of `calib.engine.calibrate`.
    """
    used = used_stars(views, options.guard_band, wrong)
    kept = [view if own.all() else view.part(own) for view, own in zip(views, used, strict=True)]
    bundle, start = initialized(kept, options.distortion, options.passport, planar=model == "planar")
    refined, loss = refine_robustly(bundle, start, options)
    if options.passport is None:
        require_distinct_poses(refined.parameters)
    uncertainty = _constrained(kept, bundle, refined, loss)
    leave_out = leave_out or uncertainty.inconsistent
    left_out = leave_one_out(bundle, refined.parameters, loss) if leave_out else None
    return Fit(model, views, bundle, refined, loss, np.concatenate(used), uncertainty, left_out)


def _constrained(
    views: Sequence[View], bundle: Bundle, refined: Refinement[AdjustmentParameters], loss: Loss
) -> Uncertainty:
    """Refuse views that do not constrain the camera; else return the uncertainty."""
    parameters = refined.parameters
    why = explain_weak_geometry(views, parameters)
    try:
        uncertainty = covariance_at_optimum(bundle, parameters, loss)
        require_constrained(parameters, uncertainty.sigma)
    except DegenerateViews as error:
        raise DegenerateViews(f"{error.what} {why}".strip(), remedy=error.remedy) from error
    if not refined.converged:
        raise NotConverged(
            f"The adjustment did not converge within {refined.iterations} steps. {why}".strip(),
            remedy="Add views from other angles, or estimate fewer distortion coefficients.",
        )
    return uncertainty


def refine_robustly(
    bundle: Bundle, start: AdjustmentParameters, options: CalibrationOptions
) -> tuple[Refinement[AdjustmentParameters], Loss]:
    """Adjust with the chosen loss; return the optimum, and the loss with its limit, which comes from the residuals.

    The spread of the residuals is their robust standard deviation per axis at the least squares optimum, and then at
    each robust optimum. The result therefore depends on the data only, not on the start. Own procedure: sigma is the
    median length of the residuals over 1.1774 = sqrt(2 ln 2), that of a two-dimensional standard normal vector.
    """
    name, loss = options.loss or "huber", Loss("l2")
    if name != "l2" and options.huber_px is not None:
        loss = Loss(name, options.huber_px * bundle.observations.sigmas_per_px)
    refined = refine(bundle, start, loss)
    iterations = refined.iterations
    for _ in range(_LIMIT_ROUNDS if loss.name != name else 0):
        residuals = bundle.weighted_residuals(refined.parameters)
        spread = median(lengths(residuals)) / RAYLEIGH_MEDIAN
        if not spread > 0:
            break
        loss = Loss(name, _LIMIT_SIGMAS * spread)
        refined = refine(bundle, refined.parameters, loss)
        iterations += refined.iterations
    return replace(refined, iterations=iterations), loss


def summarize(fitted: Fit) -> Calibration:
    """Convert a fit to a calibration result."""
    parameters, used, uncertainty = fitted.parameters, fitted.used, fitted.uncertainty
    whole = replace(fitted.bundle, observations=Observations.from_views(fitted.views))
    residuals = whole.residuals_px(parameters)
    weights = used * fitted.loss.weights(np.linalg.norm(whole.weighted_residuals(parameters), axis=1))
    lengths = np.linalg.norm(residuals, axis=1)
    rows = whole.observations.slices
    counted = [lengths[r][used[r]] for r in rows]
    rms_px, mean_px = rms_and_mean(lengths[used])
    return Calibration(
        model=fitted.model,
        camera=parameters.camera,
        collimator=None if fitted.model == "planar" else parameters.collimator,
        rotations=parameters.rotations,
        centres=parameters.centres,
        parameter_names=uncertainty.names,
        estimates=parameters.values(uncertainty.names),
        covariance=uncertainty.covariance,
        residuals_px=[residuals[r] for r in rows],
        weights=[weights[r] for r in rows],
        rms_px=rms_px,
        mean_px=mean_px,
        variance_factor=uncertainty.variance_factor,
        degrees_of_freedom=uncertainty.degrees_of_freedom,
        birge_ratio=uncertainty.birge_ratio,
        coverage_factor=uncertainty.coverage_factor,
        left_out_rms_px=fitted.left_out_rms_px,
        views=tuple(
            ViewSummary(view.name, len(own), *rms_and_mean(own))
            for view, own in zip(fitted.views, counted, strict=True)
        ),
        converged=fitted.refined.converged,
        iterations=fitted.refined.iterations,
        rotation_covariance=rotation_covariance(fitted.bundle, parameters, uncertainty),
        budget={
            source: {name: share**0.5 * sigma for name, sigma in uncertainty.sigma.items()}
            for source, share in uncertainty.shares.items()
        },
        notes=_notes(fitted),
        poses=poses_of(parameters.rotations),
        budget_rows=_budget_rows(parameters.camera, uncertainty),
    )


def _budget_rows(camera: CameraModel, uncertainty: Uncertainty) -> tuple[BudgetRow, ...]:
    """Return the rows of the budget; the squares of their contributions add up to those of the result."""
    size = len(camera.parameter_names)
    gradients = np.zeros((len(ROW_QUANTITIES), len(uncertainty.names)))
    gradients[range(4), range(4)] = 1.0
    gradients[4, :size] = worst_point(camera, uncertainty.covariance[:size, :size])
    total = np.maximum(np.einsum("qg,gh,qh->q", gradients, uncertainty.covariance, gradients), 0.0)
    return tuple(
        BudgetRow.of(source, "A", _SOURCES[source], share * total, total)
        for source, share in uncertainty.shares.items()
    )


def _notes(fitted: Fit) -> tuple[str, ...]:
    """Return notes for the reader: a weak focal length, and views that disagree."""
    notes, sigma, camera = [], fitted.uncertainty.sigma, fitted.parameters.camera
    relative = {"fx": sigma["fx"] / camera.fx, "fy": sigma["fy"] / camera.fy}
    name = max(relative, key=lambda focal: relative[focal])
    if not relative[name] < _WEAK_FOCAL_SIGMA:
        why = explain_weak_geometry(fitted.views, fitted.parameters)
        text = f"Weak geometry: {name} is known only to ±{200 * relative[name]:.1f} % (k = 2). {why}".strip()
        notes.append(f"{text} Add views turned about other axes, with the points elsewhere in the image.")
    if fitted.uncertainty.inconsistent:
        notes.append(
            f"Views differ {fitted.uncertainty.birge_ratio:.1f} times more than noise explains. The uncertainties "
            f"are enlarged by this ratio. {_OTHERWISE[fitted.model]}"
        )
    return tuple(notes)
