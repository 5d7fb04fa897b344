"""A fit as a calibration result, with notes for its reader."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.centre_drift import BIASING_DRIFT, centre_drift
from calib.adjustment.degeneracy import explain_weak_geometry
from calib.calibration import Calibration, ViewSummary
from calib.fit import Fit
from calib.uncertainty.covariance import rotation_covariance
from calib.uncertainty.cross_validation import MIN_VIEWS

Array = NDArray[np.float64]

#: Views are reported as weak if the 1-sigma of a focal length, as a share of it, reaches this.
_WEAK_FOCAL_SIGMA = 0.01


def summarize(fitted: Fit) -> Calibration:
    """Convert a fit to a calibration result.

    Parameters
    ----------
    fitted
        The fitted model.

    Returns
    -------
    Calibration
        Result without candidates.
    """
    parameters, whole, used = fitted.parameters, fitted.whole, fitted.used
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
        parameter_names=fitted.uncertainty.names,
        values=parameters.values(fitted.uncertainty.names),
        covariance=fitted.uncertainty.covariance,
        residuals_px=[residuals[r] for r in rows],
        weights=[weights[r] for r in rows],
        rms_px=_rms(lengths[used]),
        mean_px=float(lengths[used].mean()),
        variance_factor=fitted.uncertainty.variance_factor,
        degrees_of_freedom=fitted.uncertainty.degrees_of_freedom,
        birge_ratio=fitted.uncertainty.birge_ratio,
        coverage_factor=fitted.uncertainty.coverage_factor,
        left_out_rms_px=fitted.cross_validation.total_rms_px if fitted.cross_validation else None,
        views=tuple(
            ViewSummary(view.name, len(own), _rms(own), float(own.mean()))
            for view, own in zip(fitted.views, counted, strict=True)
        ),
        converged=fitted.refined.converged,
        iterations=fitted.refined.iterations,
        rotation_covariance=rotation_covariance(fitted.bundle, parameters, fitted.uncertainty),
        budget={
            source: dict(
                zip(fitted.uncertainty.names, np.sqrt(np.maximum(variances, 0.0)).tolist(), strict=True)
            )
            for source, variances in fitted.uncertainty.budget.items()
        },
        notes=_notes(fitted),
    )


def _notes(fitted: Fit) -> tuple[str, ...]:
    """Return the notes for the reader of the result."""
    notes = [*_weakness(fitted), *_rims_out_of_view(fitted)]
    if not fitted.uncertainty.inconsistent:
        return tuple(notes)
    notes.append(
        f"Views differ {fitted.uncertainty.birge_ratio:.1f} times more than star noise explains; uncertainties are "
        f"enlarged accordingly. The {fitted.model} model is probably incomplete."
    )
    if fitted.model == "spherical" and len(fitted.views) >= MIN_VIEWS:
        drift = centre_drift(fitted.bundle, fitted.parameters, fitted.loss)
        if np.linalg.norm(drift) > BIASING_DRIFT:
            shares = " / ".join(f"{100 * share:.2f}" for share in drift)
            notes.append(
                f"The centre moves by {shares} % of r (rms along x / y / z) from view to view, so the spherical "
                "model is biased. Use the model auto, or a passport that contains the collimator's aberrations."
            )
    return tuple(notes)


def _weakness(fitted: Fit) -> list[str]:
    """Return a note if a focal length is poorly determined, with the reason."""
    sigmas = np.sqrt(np.diag(fitted.uncertainty.covariance))
    names = fitted.uncertainty.names
    relative = dict(zip(names, sigmas / fitted.parameters.values(names), strict=True))
    name = max(("fx", "fy"), key=lambda focal: relative[focal])
    if relative[name] < _WEAK_FOCAL_SIGMA:
        return []
    why = explain_weak_geometry(fitted.views, fitted.parameters)
    text = f"Weak geometry: {name} is known only to {100 * relative[name]:.1f} % (1 sigma). {why}".strip()
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
