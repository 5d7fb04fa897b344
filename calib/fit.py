"""One model fitted to given views: closed forms, refinement, covariance, summary.

Knows the order of that work; which model to fit is `calib.selection`'s affair.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calib import degeneracy, uncertainty
from calib.bundle import Bundle, Observations, State
from calib.calibration import Calibration, CalibrationOptions, ViewSummary
from calib.camera import PINHOLE
from calib.collimator import PARAMETERS as COLLIMATOR_PARAMETERS
from calib.errors import DegenerateViews, NotConverged
from calib.homography import fit_homography
from calib.refine import Loss, Refined, refine
from calib.start import planar_states, spherical_states, winner
from calib.view import View

Array = NDArray[np.float64]
Motion = Literal["spherical", "planar"]

#: The robust loss's limit in robust standard deviations per axis, and how often it is measured anew.
_LIMIT_SIGMAS = 2.5
_LIMIT_ROUNDS = 3
#: Median length of a residual vector over its standard deviation per axis (Rayleigh): sqrt(2 ln 2).
_RAYLEIGH_MEDIAN = 1.1774100225154747


def fit(views: Sequence[View], options: CalibrationOptions, motion: Motion) -> Calibration:
    """Fit one model; parameters, result and errors as in `calib.calibrate.calibrate`."""
    homographies = np.array([fit_homography(view) for view in views])
    bundle = bundle_of(views, options, motion)
    states = spherical_states if motion == "spherical" else planar_states
    names = tuple(options.distortion)
    start = winner(views, bundle, list(states(homographies, views[0].image_size, names)))
    refined, loss = refine_robustly(bundle, start, options)
    degeneracy.require_turned(refined.state)
    why = degeneracy.reason(views, refined.state)
    try:
        known = uncertainty.at_optimum(bundle, refined.state, loss)
    except DegenerateViews as error:
        raise DegenerateViews(f"{error.what} {why}".strip(), remedy=error.remedy) from error
    degeneracy.require_constrained(refined.state, bundle.names, known.covariance, why)
    if not refined.converged:
        raise NotConverged(
            f"No optimum after {refined.iterations} steps. {why}".strip(),
            remedy="Add views from other angles, or estimate fewer distortion coefficients.",
        )
    return _summary(views, bundle, refined, loss, known, motion)


def bundle_of(views: Sequence[View], options: CalibrationOptions, motion: Motion) -> Bundle:
    """Return what a model estimates from these views."""
    shared = COLLIMATOR_PARAMETERS if motion == "spherical" else ()
    names = (*PINHOLE, *options.distortion, *shared)
    return Bundle(Observations.from_views(views), names, free_centres=motion == "planar")


def refine_robustly(bundle: Bundle, start: State, options: CalibrationOptions) -> tuple[Refined, Loss]:
    """Refine with the loss asked for; where its limit is not given, from the residuals' own spread.

    The spread is the robust standard deviation per axis at the least squares optimum, and then at each robust
    one, so that the result depends on the data alone and not on the start.
    """
    if options.loss == "l2" or options.huber_px is not None:
        limit = np.inf if options.huber_px is None else options.huber_px * _whitening_scale(bundle)
        loss = Loss(options.loss, float(limit))
        return refine(bundle, start, loss, options.max_iterations), loss
    refined, loss = refine(bundle, start, Loss("l2"), options.max_iterations), Loss("l2")
    iterations = refined.iterations
    for _ in range(_LIMIT_ROUNDS):
        lengths = np.linalg.norm(bundle.residuals(refined.state), axis=1)
        limit = _LIMIT_SIGMAS * np.median(lengths) / _RAYLEIGH_MEDIAN
        if not limit > 0:
            break
        loss = Loss(options.loss, float(limit))
        refined = refine(bundle, refined.state, loss, options.max_iterations)
        iterations += refined.iterations
    return Refined(refined.state, refined.cost, refined.converged, iterations), loss


def _whitening_scale(bundle: Bundle) -> float:
    """Return the factor from px to units of the typical star's uncertainty."""
    determinants = np.linalg.det(bundle.observations.whitening)
    return float(np.sqrt(np.median(np.abs(determinants))))


def _summary(
    views: Sequence[View],
    bundle: Bundle,
    refined: Refined,
    loss: Loss,
    known: uncertainty.Uncertainty,
    motion: Motion,
) -> Calibration:
    """Put the result into its final shape."""
    state = refined.state
    misses = bundle.misses_px(state)
    weights = loss.weights(np.linalg.norm(bundle.residuals(state), axis=1))
    lengths = np.linalg.norm(misses, axis=1)
    rows = bundle.observations.slices
    return Calibration(
        model=motion,
        camera=state.camera,
        collimator=state.collimator if motion == "spherical" else None,
        rotations=state.rotations,
        centres=state.centres,
        parameter_names=bundle.names,
        values=state.values(bundle.names),
        covariance=known.covariance,
        residuals_px=[misses[r] for r in rows],
        weights=[weights[r] for r in rows],
        rms_px=_rms(lengths),
        mean_px=float(lengths.mean()),
        variance_factor=known.variance_factor,
        degrees_of_freedom=known.degrees_of_freedom,
        views=tuple(
            ViewSummary(view.name, len(view), _rms(lengths[r]), float(lengths[r].mean()))
            for view, r in zip(views, rows, strict=True)
        ),
        converged=refined.converged,
        iterations=refined.iterations,
    )


def _rms(lengths: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(lengths**2)))
