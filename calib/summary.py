"""A fit of a reference method as a calibration result, with notes for its reader."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.degeneracy import explain_weak_geometry
from calib.calibration import Calibration, CalibrationOptions, ViewSummary
from calib.diagnosis.checks import check_adjustment
from calib.fit import Fit
from calib.model import budget_row as names
from calib.model.budget_row import ROW_QUANTITIES, BudgetRow
from calib.model.camera import CameraModel
from calib.uncertainty.covariance import Uncertainty, rotation_covariance
from calib.uncertainty.projection_uncertainty import worst_point

Array = NDArray[np.float64]

#: Views are reported as weak if the 1-sigma of a focal length, as a share of it, reaches this.
_WEAK_FOCAL_SIGMA = 0.01
_SOURCES = {
    names.STARS: "residuals of the stars",
    names.POSE_FIELDS: "differences between the views",
    names.PASSPORT: "passport of the collimator",
}


def summarize(fitted: Fit, options: CalibrationOptions) -> Calibration:
    """Convert a fit to a calibration result.

    options: Where the passport comes from.
    """
    parameters, whole, used, uncertainty = fitted.parameters, fitted.whole, fitted.used, fitted.uncertainty
    residuals = whole.residuals_px(parameters)
    weights = used * fitted.loss.weights(np.linalg.norm(whole.weighted_residuals(parameters), axis=1))
    lengths = np.linalg.norm(residuals, axis=1)
    rows = whole.observations.slices
    counted = [lengths[r][used[r]] for r in rows]
    return Calibration(
        model=fitted.model,
        camera=parameters.camera,
        collimator=None if fitted.model == "planar" else parameters.collimator,
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
        rotation_covariance=rotation_covariance(fitted.bundle, parameters, uncertainty),
        budget={
            source: dict(zip(uncertainty.names, _sigmas(part).tolist(), strict=True))
            for source, part in uncertainty.parts.items()
        },
        notes=(*_notes(fitted), *_doubts(fitted)),
        poses=whole.poses or (),
        budget_rows=_budget_rows(parameters.camera, uncertainty, options.passport_source),
    )


def _budget_rows(camera: CameraModel, uncertainty: Uncertainty, passport: str) -> tuple[BudgetRow, ...]:
    """Return the rows of the budget; the squares of their contributions add up to those of the result.

    passport: Where the passport comes from, if it is known.
    """
    size = len(camera.parameter_names)
    gradients = np.zeros((len(ROW_QUANTITIES), len(uncertainty.names)))
    gradients[range(4), range(4)] = 1.0
    gradients[4, :size] = worst_point(camera, uncertainty.covariance[:size, :size])
    variances = {
        source: np.maximum(np.einsum("qg,gh,qh->q", gradients, part, gradients), 0.0)
        for source, part in uncertainty.parts.items()
    }
    total = sum(variances.values(), start=np.zeros(len(gradients)))
    sources = {**_SOURCES, **({names.PASSPORT: passport} if passport else {})}
    return tuple(
        BudgetRow(
            source,
            "B" if source == names.PASSPORT else "A",
            sources[source],
            contribution=dict(zip(ROW_QUANTITIES, np.sqrt(part).tolist(), strict=True)),
            share=dict(zip(ROW_QUANTITIES, (part / np.where(total > 0, total, 1.0)).tolist(), strict=True)),
        )
        for source, part in variances.items()
    )


def _doubts(fitted: Fit) -> tuple[str, ...]:
    """Return sentences about views that do not fit the others; only one centre for all shows them."""
    if fitted.model == "planar":
        return ()
    sigmas = _sigmas(fitted.uncertainty.covariance).tolist()
    sigma = dict(zip(fitted.uncertainty.names, sigmas, strict=True))
    return check_adjustment(fitted.kept, fitted.bundle, fitted.parameters, sigma)


def _notes(fitted: Fit) -> tuple[str, ...]:
    """Return the notes for the reader of the result."""
    notes = _weakness(fitted)
    if fitted.uncertainty.inconsistent:
        notes.append(
            f"Views differ {fitted.uncertainty.birge_ratio:.1f} times more than star noise explains. The uncertainties "
            f"are enlarged by this ratio. The {fitted.model} model is for comparison; the joint adjustment describes "
            "such errors."
        )
    return tuple(notes)


def _weakness(fitted: Fit) -> list[str]:
    """Return a note if a focal length is poorly determined, with the reason."""
    shown = fitted.uncertainty.names
    relative = dict(
        zip(shown, _sigmas(fitted.uncertainty.covariance) / fitted.parameters.values(shown), strict=True)
    )
    name = max(("fx", "fy"), key=lambda focal: relative[focal])
    if relative[name] < _WEAK_FOCAL_SIGMA:
        return []
    why = explain_weak_geometry(fitted.views, fitted.parameters)
    text = f"Weak geometry: {name} is known only to ±{200 * relative[name]:.1f} % (k = 2). {why}".strip()
    return [f"{text} Add views turned about other axes, with the stars elsewhere in the image."]


def _sigmas(covariance: Array) -> Array:
    """Return the standard deviations."""
    return np.asarray(np.sqrt(np.maximum(np.diag(covariance), 0.0)))


def _rms(lengths: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(lengths**2)))
