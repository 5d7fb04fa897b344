"""One model fitted to given views: closed forms, refinement, covariance, summary.

Knows the order of that work and what each model frees; which model to fit is `calib.selection`'s affair.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.bundle import Bundle
from calib.adjustment.centre_drift import BIASING_DRIFT, centre_drift
from calib.adjustment.degeneracy import (
    explain_weak_geometry,
    require_constrained,
    require_distinct_poses,
    require_visible_rims,
)
from calib.adjustment.initialization import best_start, passport_starts, planar_starts, spherical_starts
from calib.adjustment.levenberg_marquardt import Loss, Refinement, refine
from calib.adjustment.observations import Observations
from calib.adjustment.parameters import AdjustmentParameters
from calib.calibration import Calibration, CalibrationOptions, ViewSummary
from calib.errors import DegenerateViews, NotConverged
from calib.model.aberrations import LADDER, aberration_prior, displacements
from calib.model.beam import Disc, inside_guard_band, visible_discs, without_guard_band
from calib.model.camera import PINHOLE
from calib.model.collimator import CENTRE, Collimator
from calib.model.homography import view_homography
from calib.uncertainty.consistency import check_passport
from calib.uncertainty.covariance import (
    Uncertainty,
    covariance_at_optimum,
    inflate,
    rotation_covariance,
)
from calib.uncertainty.cross_validation import MIN_VIEWS, CrossValidation, leave_one_out
from calib.uncertainty.passport_propagation import propagate_passport
from calib.uncertainty.variance_components import variance_components
from calib.view import View

Array = NDArray[np.float64]

#: The robust loss's limit in robust standard deviations per axis, and how often it is measured anew.
_LIMIT_SIGMAS = 2.5
_LIMIT_ROUNDS = 3
#: From this 1-sigma of a focal length on, as a share of it, views count as weak and are named so.
_WEAK = 0.01
#: Median length of a residual vector over its standard deviation per axis (Rayleigh): sqrt(2 ln 2).
_RAYLEIGH_MEDIAN = 1.1774100225154747


@dataclass(frozen=True)
class Fit:
    """A model at its optimum.

    Attributes
    ----------
    model
        Its name.
    views
        The views, with all their stars.
    bundle, refined, loss
        What was minimised, where it ended, and the loss it ended with.
    whole, used
        The same with the stars of the guard band too, and which of its stars were used.
    uncertainty
        Covariance of the shared parameters.
    cross_validation
        What leaving out views shows; None where it was not asked for, or the views are too few.
    discs
        The views' visible discs; none where the model needs none.
    """

    model: str
    views: Sequence[View]
    bundle: Bundle
    refined: Refinement
    loss: Loss
    whole: Bundle
    used: NDArray[np.bool_]
    uncertainty: Uncertainty
    cross_validation: CrossValidation | None
    discs: Sequence[Disc] = ()

    @property
    def parameters(self) -> AdjustmentParameters:
        """The optimum."""
        return self.refined.parameters


def fit_model(
    views: Sequence[View],
    options: CalibrationOptions,
    model: str,
    *,
    leave_out: bool = False,
    discs: Sequence[Disc] | None = None,
) -> Fit:
    """Fit one model; errors as in `calib.engine.calibrate`.

    Parameters
    ----------
    views, options
        As there.
    model
        A rung of `calib.model.aberrations.LADDER`, ``drift`` or ``planar``; with a passport, its terms decide.
    leave_out
        Whether to leave out each view in turn even when the views agree.
    discs
        The views' visible discs, when they are known already.
    """
    terms = options.passport.terms if options.passport else LADDER.get(model, ())
    kept = views
    if terms or options.guard_band < 1:
        discs = discs or visible_discs(views)
        require_visible_rims(views, discs)
        kept = [without_guard_band(v, disc, options.guard_band) for v, disc in zip(views, discs, strict=True)]
    bundle, start = initialize(kept, options, model)
    if terms and discs:
        bundle, start = _with_terms(kept, discs, bundle, start, options, terms)
    if model == "drift":
        bundle = replace(bundle, free_centres=True, drift_mm=options.drift_mm)
    bundle, refined, loss = refine_robustly(bundle, start, options)
    if options.passport:
        check_passport(bundle, refined.parameters, loss, options.passport)
    estimate, left_out = _uncertainty(kept, options, bundle, refined, loss, leave_out=leave_out)
    whole, used = bundle, np.ones(len(bundle.observations.view), np.bool_)
    if options.guard_band < 1 and discs:
        used = np.concatenate(
            [inside_guard_band(v, disc, options.guard_band) for v, disc in zip(views, discs, strict=True)]
        )
        shifts = _shifts(views, discs, refined.parameters.collimator, terms) if terms else None
        whole = replace(bundle, observations=Observations.from_views(views), displacements=shifts)
    return Fit(
        model, views, bundle, refined, loss, whole, used, estimate, left_out, discs if terms and discs else ()
    )


def initialize(
    views: Sequence[View], options: CalibrationOptions, model: str
) -> tuple[Bundle, AdjustmentParameters]:
    """Return what the ideal model estimates, and where to begin."""
    h = np.array([view_homography(view) for view in views])
    size, distortion = views[0].image_size, tuple(options.distortion)
    held = options.passport.names if options.passport else ()
    centre = [] if model == "planar" else [name for name in CENTRE if name not in held]
    observations = Observations.from_views(views)
    bundle = Bundle(observations, (*PINHOLE, *distortion, *centre), free_centres=model == "planar")
    if options.passport:
        states = list(passport_starts(h, size, distortion, options.passport))
    elif model == "planar":
        states = list(planar_starts(h, size, distortion))
    else:
        states = list(spherical_starts(h, size, distortion))
    return bundle, best_start(bundle, states)


def _with_terms(
    views: Sequence[View],
    discs: Sequence[Disc],
    bundle: Bundle,
    start: AdjustmentParameters,
    options: CalibrationOptions,
    terms: tuple[str, ...],
) -> tuple[Bundle, AdjustmentParameters]:
    """Add a collimator's imperfections, expressed about the ideal model's optimum; or those of the passport."""
    if options.passport:
        collimator = options.passport.collimator(start.collimator)
    else:
        ideal = refine(bundle, start, Loss("l2"), options.max_iterations).parameters.collimator
        collimator = replace(
            ideal, aberrations=dict.fromkeys(terms, 0.0), reference=(ideal.x, ideal.y, ideal.r)
        )
        names = (*bundle.names, *terms)
        bundle = replace(bundle, names=names, prior=aberration_prior(terms))
    bundle = replace(bundle, displacements=_shifts(views, discs, collimator, terms))
    return bundle, replace(start, collimator=collimator)


def _shifts(
    views: Sequence[View], discs: Sequence[Disc], collimator: Collimator, terms: tuple[str, ...]
) -> Array:
    """Return (N, 2, T) what a unit of each imperfection does to each star, view below view."""
    assert collimator.reference is not None
    reference = collimator.reference
    return np.concatenate(
        [
            displacements(view.target_mm, disc, reference, terms)
            for view, disc in zip(views, discs, strict=True)
        ]
    )


def refine_robustly(
    bundle: Bundle, start: AdjustmentParameters, options: CalibrationOptions
) -> tuple[Bundle, Refinement, Loss]:
    """Refine with the loss asked for; its limit, and the noise priors are weighed by, come from the residuals.

    The spread is the robust standard deviation per axis at the least squares optimum, and then at each robust
    one, so that the result depends on the data alone and not on the start.
    """
    given = None if options.huber_px is None else options.huber_px * bundle.observations.sigmas_per_px
    loss = Loss("l2") if given is None else Loss(options.loss, given)
    refined = refine(bundle, start, loss, options.max_iterations)
    iterations = refined.iterations
    robust = options.loss != "l2" and given is None
    for _ in range(_LIMIT_ROUNDS if robust or bundle.prior or bundle.has_drift_prior else 0):
        residuals = bundle.weighted_residuals(refined.parameters)
        spread = float(np.median(np.linalg.norm(residuals, axis=1)) / _RAYLEIGH_MEDIAN)
        if not spread > 0:
            break
        loss = Loss(options.loss, _LIMIT_SIGMAS * spread) if robust else loss
        bundle = replace(bundle, noise_variance=spread**2)
        refined = refine(bundle, refined.parameters, loss, options.max_iterations)
        iterations += refined.iterations
    return bundle, replace(refined, iterations=iterations), loss


def _uncertainty(
    views: Sequence[View],
    options: CalibrationOptions,
    bundle: Bundle,
    refined: Refinement,
    loss: Loss,
    *,
    leave_out: bool,
) -> tuple[Uncertainty, CrossValidation | None]:
    """Refuse what is no calibration; else say how sure it is."""
    parameters = refined.parameters
    if options.passport is None:
        require_distinct_poses(parameters)
    why = explain_weak_geometry(views, parameters)
    try:
        estimate = covariance_at_optimum(bundle, parameters, loss)
    except DegenerateViews as error:
        raise DegenerateViews(f"{error.what} {why}".strip(), remedy=error.remedy) from error
    require_constrained(parameters, bundle.names, estimate.covariance, why)
    if not refined.converged:
        raise NotConverged(
            f"The adjustment did not converge within {refined.iterations} steps. {why}".strip(),
            remedy="Add views from other angles, or estimate fewer distortion coefficients.",
        )
    left_out = None
    if len(views) >= MIN_VIEWS and (leave_out or estimate.inconsistent):
        left_out = leave_one_out(bundle, parameters, loss)
    if options.passport is None:
        found = partial(variance_components, bundle, parameters, loss)
        return inflate(estimate, bundle, parameters, loss, found), left_out
    estimate = propagate_passport(bundle, parameters, estimate, options.passport)
    require_constrained(
        parameters, estimate.names, estimate.covariance, "The passport does not constrain it either."
    )
    return estimate, left_out


def summarize(fitted: Fit) -> Calibration:
    """Put a fit into its final shape."""
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
    """Say what the reader should know."""
    notes = [*_weakness(fitted), *_rims_out_of_sight(fitted)]
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
    """Name views that leave a focal length hardly known, and why they do."""
    sigmas = np.sqrt(np.diag(fitted.uncertainty.covariance))
    known = dict(
        zip(
            fitted.uncertainty.names, sigmas / fitted.parameters.values(fitted.uncertainty.names), strict=True
        )
    )
    name = max(("fx", "fy"), key=lambda focal: known[focal])
    if known[name] < _WEAK:
        return []
    why = explain_weak_geometry(fitted.views, fitted.parameters)
    text = f"Weak geometry: {name} is known only to {100 * known[name]:.1f} % (1 sigma). {why}".strip()
    return [f"{text} Add views turned about other axes, with the stars elsewhere in the image."]


def _rims_out_of_sight(fitted: Fit) -> list[str]:
    """Name views whose place in the pupil was told by other views."""
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
