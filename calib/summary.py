"""A fit as a calibration result, with notes for its reader."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.centre_drift import BIASING_DRIFT, centre_drift
from calib.adjustment.degeneracy import explain_weak_geometry
from calib.calibration import Calibration, CalibrationOptions, ViewSummary
from calib.diagnosis.checks import check_adjustment
from calib.fit import Fit
from calib.model.aberrations import PARALLAX
from calib.model.collimator import Collimator
from calib.model.gimbal import GIMBAL, MOUNTING, SCALES
from calib.model.gimbal_estimate import GimbalEstimate
from calib.model.rotation import exp_map
from calib.uncertainty.budget_parts import PASSPORT
from calib.uncertainty.budget_rows import uncertainty_budget
from calib.uncertainty.covariance import Uncertainty, rotation_covariance
from calib.uncertainty.cross_validation import MIN_VIEWS
from calib.uncertainty.passport_propagation import UNBOUNDED_PARALLAX
from calib.uncertainty.type_b import apply_budget

Array = NDArray[np.float64]

#: Views are reported as weak if the 1-sigma of a focal length, as a share of it, reaches this.
_WEAK_FOCAL_SIGMA = 0.01
_BACKWARDS = (
    "The gimbal's readings fit the stars only if the camera looked backwards on the head: the sign of one axis (pan or "
    "tilt) is probably wrong. This changes no result."
)


def summarize(fitted: Fit, options: CalibrationOptions, lens: str = "") -> Calibration:
    """Convert a fit to a calibration result, with the whole uncertainty budget.

    options: Type B terms, and where the passport comes from.
    lens: What a comparison of lens models shows, if another lens explains the views better; else empty.
    Returns: Result without candidates.
    """
    parameters, whole, used = fitted.parameters, fitted.whole, fitted.used
    sources = {PASSPORT: options.passport_source} if options.passport_source else {}
    budget = uncertainty_budget(
        fitted.bundle, parameters, fitted.loss, fitted.uncertainty, options.budget, sources
    )
    uncertainty, gimbal = _without_gimbal(budget.applied.uncertainty), _gimbal_estimate(fitted)
    rotations = rotation_covariance(fitted.bundle, parameters, budget.applied.without_terms)
    residuals = whole.residuals_px(parameters)
    weights = used * fitted.loss.weights(np.linalg.norm(whole.weighted_residuals(parameters), axis=1))
    lengths = np.linalg.norm(residuals, axis=1)
    rows = whole.observations.slices
    counted = [lengths[r][used[r]] for r in rows]
    rims = _rims_out_of_view(fitted)
    return Calibration(
        model=fitted.model,
        camera=parameters.camera,
        collimator=None if fitted.model == "planar" else _without_parallax(parameters.collimator),
        rotations=parameters.rotations,
        centres=parameters.centres,
        parameter_names=uncertainty.names,
        values=parameters.values(uncertainty.names),
        covariance=uncertainty.covariance,
        residuals_px=[residuals[r] for r in rows],
        weights=[weights[r] for r in rows],
        rms_px=_rms(lengths[used]),
        mean_px=float(lengths[used].mean()),
        variance_factor=uncertainty.variance_factor,
        degrees_of_freedom=uncertainty.degrees_of_freedom,
        birge_ratio=uncertainty.birge_ratio,
        coverage_factor=uncertainty.coverage_factor,
        left_out_rms_px=fitted.cross_validation.total_rms_px if fitted.cross_validation else None,
        views=tuple(
            ViewSummary(view.name, len(own), _rms(own), float(own.mean()))
            for view, own in zip(fitted.views, counted, strict=True)
        ),
        converged=fitted.refined.converged,
        iterations=fitted.refined.iterations,
        rotation_covariance=rotations + budget.applied.rotation_covariance,
        budget={
            source: dict(zip(uncertainty.names, np.sqrt(np.maximum(variances, 0.0)).tolist(), strict=True))
            for source, variances in uncertainty.budget.items()
        },
        notes=(*rims, *_notes(fitted, lens), *_doubts(fitted, uncertainty), *reading_notes(gimbal)),
        remarks=tuple(rims),
        gimbal=gimbal,
        poses=whole.poses or (),
        budget_rows=budget.rows,
        not_included=budget.not_included,
    )


def expanded_focal_px(fitted: Fit, options: CalibrationOptions) -> float:
    """Return the expanded uncertainty of fx that `summarize` would state.

    Returns: Coverage factor times 1-sigma of fx with the type B terms, px.
    """
    estimate = fitted.uncertainty
    applied = apply_budget(
        fitted.bundle, fitted.parameters, fitted.loss, estimate, options.budget
    ).uncertainty
    at = applied.names.index("fx")
    return applied.coverage_factor * float(np.sqrt(applied.covariance[at, at]))


def _doubts(fitted: Fit, uncertainty: Uncertainty) -> tuple[str, ...]:
    """Return sentences about views that do not fit the others; only a model with one centre for all shows them."""
    if fitted.model in ("drift", "planar"):
        return ()
    sigma = dict(zip(uncertainty.names, np.sqrt(np.diag(uncertainty.covariance)).tolist(), strict=True))
    return check_adjustment(fitted.kept, fitted.bundle, fitted.parameters, sigma)


def _without_gimbal(whole: Uncertainty) -> Uncertainty:
    """Return the uncertainty of camera and collimator alone: the gimbal's parameters are summed out."""
    kept = [i for i, name in enumerate(whole.names) if name not in (*GIMBAL, *PARALLAX)]
    return replace(
        whole,
        names=tuple(whole.names[i] for i in kept),
        covariance=whole.covariance[np.ix_(kept, kept)],
        budget={source: variances[kept] for source, variances in whole.budget.items()},
    )


def _without_parallax(collimator: Collimator) -> Collimator:
    """Return the collimator without the parallax, which belongs to the gimbal before it."""
    own = {name: value for name, value in collimator.aberrations.items() if name not in PARALLAX}
    return replace(collimator, aberrations=own, reference=collimator.reference if own else None)


def _gimbal_estimate(fitted: Fit) -> GimbalEstimate | None:
    """Return the gimbal's parameters and the test of its readings; None if there were none."""
    test, used = fitted.readings, fitted.bundle.gimbal
    if test is None:
        return None
    names = [name for name in fitted.uncertainty.names if name in (*GIMBAL, *PARALLAX)]
    at = [fitted.uncertainty.names.index(name) for name in names]
    unit = np.array([1.0 if name in (*SCALES, *PARALLAX) else np.rad2deg(1.0) for name in names])
    sigmas = unit * np.sqrt(np.diag(fitted.uncertainty.covariance)[at])
    values = unit * fitted.parameters.values(names)
    return GimbalEstimate(
        entered=used is not None,
        values=dict(zip(names, values.tolist(), strict=True)),
        sigma=dict(zip(names, sigmas.tolist(), strict=True)),
        chi_square=test.chi_square,
        degrees_of_freedom=test.degrees_of_freedom,
        rms_deg=test.rms_deg,
        reading_sigma_deg=float(np.rad2deg(test.sigma_rad)),
        scatter=test.times_stated,
        source=test.source,
    )


def reading_notes(gimbal: GimbalEstimate | None) -> tuple[str, ...]:
    """Return what a reader must know about the gimbal's readings.

    gimbal: What was found out about the gimbal; None if its readings took no part.
    Returns: Sentences; none if the readings agree with the stars as stated.
    """
    if gimbal is None:
        return ()
    mounting = (
        exp_map(np.radians([gimbal.values[name] for name in MOUNTING])) if gimbal.entered else np.eye(3)
    )
    if mounting[2, 2] < 0:
        return (_BACKWARDS,)
    if gimbal.entered and gimbal.scatter == 1.0:
        return ()
    text = (
        f"The gimbal's readings contradict the stars: {gimbal.rms_deg:.3f} degrees rms, chi-square "
        f"{gimbal.chi_square:.0f} with {gimbal.degrees_of_freedom} degrees of freedom. They did not enter. Check the "
        "sign and the scale of each axis, the stated bounds, and whether an axis slipped. A camera that moves across "
        "the beam from pose to pose does the same: the collimator's errors then differ from view to view."
    )
    if gimbal.entered:
        text = (
            f"The gimbal's readings scatter {gimbal.scatter:.1f} times more than stated. They entered with "
            f"{gimbal.reading_sigma_deg:.4f} degrees each."
        )
    return (text,)


_SHARED = {
    False: ". They do not show an error that all views have in common, such as a bow of the reticle.",
    True: ", and errors that all views share, as far as the residuals show them.",
}
"""End of a note: whether the uncertainties include errors that all views share."""


def _notes(fitted: Fit, lens: str) -> tuple[str, ...]:
    """Return the notes for the reader of the result."""
    notes = _weakness(fitted)
    if not fitted.uncertainty.inconsistent:
        return tuple(notes)
    differ = f"Views differ {fitted.uncertainty.birge_ratio:.1f} times more than star noise explains"
    held = fitted.uncertainty.common is not None
    if held and not lens and fitted.model not in ("spherical", "drift", "planar"):
        return (*notes, f"{differ}: {_explained(fitted.model)}")
    notes.append(f"{differ}. The uncertainties include what differs from view to view{_SHARED[held]}")
    if UNBOUNDED_PARALLAX in fitted.uncertainty.budget:
        notes.append(
            "Neither a certificate nor bounded readings determine the focal length: a parallax of about 1 % cannot be "
            "excluded, and the uncertainties include it."
        )
    if lens:
        notes.append(f"{lens} Set distortion to it, or to auto.")
    elif fitted.model == "spherical" and len(fitted.views) >= MIN_VIEWS:
        drift = centre_drift(fitted.bundle, fitted.parameters, fitted.loss)
        if np.linalg.norm(drift) > BIASING_DRIFT:
            shares = " / ".join(f"{100 * share:.2f}" for share in drift)
            notes.append(
                f"The centre moves by {shares} % of r (rms along x / y / z) from view to view, so the spherical "
                "model is biased. Use the model auto, or a passport that contains the collimator's aberrations."
            )
    elif fitted.model not in ("drift", "planar"):
        notes.append(f"The collimator has errors that the {fitted.model} model does not describe.")
    return tuple(notes)


def _explained(model: str) -> str:
    return (
        f"the collimator has errors that the {model} model does not describe, and the uncertainties hold them, as far "
        "as the residuals show them."
    )


def _weakness(fitted: Fit) -> list[str]:
    """Return a note if a focal length is poorly determined, with the reason."""
    sigmas = np.sqrt(np.diag(fitted.uncertainty.covariance))
    names = fitted.uncertainty.names
    relative = dict(zip(names, sigmas / fitted.parameters.values(names), strict=True))
    name = max(("fx", "fy"), key=lambda focal: relative[focal])
    if relative[name] < _WEAK_FOCAL_SIGMA:
        return []
    why = explain_weak_geometry(fitted.views, fitted.parameters)
    text = f"Weak geometry: {name} is known only to ±{200 * relative[name]:.1f} % (k = 2). {why}".strip()
    return [f"{text} Add views turned about other axes, with the stars elsewhere in the image."]


def _rims_out_of_view(fitted: Fit) -> list[str]:
    """Return a note that names views whose disc other views helped to locate."""
    names = [
        view.name for view, disc in zip(fitted.views, fitted.discs, strict=False) if disc.uses_other_views
    ]
    if not names:
        return []
    return [
        f"The rim of the beam is out of view in {', '.join(names)}; the discs of the other views helped to locate it."
    ]


def _rms(lengths: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(lengths**2)))
