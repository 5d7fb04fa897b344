"""What displacements of the target that all views share add to the uncertainty.

A camera that looks through the same glass in every pose sees the same errors of the collimator in every view. They do
not average out with the number of views, and the scores of the views, which show how much the views differ, do not show
them. Here they are polynomials of the place on the target up to degree four, the same in all views. The coefficients of
one degree are random with a common variance; those of degree 1 have the variance of degree 2, because the parameters
follow most of them. The residuals determine the variances by restricted maximum likelihood (REML; Patterson and
Thompson, 1971); what the views show differently counts as noise. The covariance of the parameters is A D A^T, with
their response A to the coefficients and the variances D (JCGM 100:2008, section 5.2). Shifts, degree 0, move the centre
of the sphere and nothing else.

This module changes no estimate, and knows nothing about single views.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.bundle import Bundle
from calib.adjustment.levenberg_marquardt import Loss
from calib.adjustment.parameters import AdjustmentParameters
from calib.uncertainty.covariance import SCORE_VIEWS, Uncertainty
from calib.uncertainty.field_equations import FieldEquations, monomials
from calib.uncertainty.repeats import views_of_poses
from calib.uncertainty.restricted_likelihood import DenseForms, maximum_likelihood

Array = NDArray[np.float64]

#: Source of the budget that holds these errors.
COMMON_ERRORS = "errors that all views share"
_DEGREES = 4
_LOWEST = 2
#: Combinations of coefficients with an eigenvalue below this share of the largest are not determined.
_DETERMINED = 1e-5


@dataclass(frozen=True)
class CommonErrors:
    """Displacements that all views share, and the covariance that follows."""

    # (3,) float64 1-sigma displacement of a star by the coefficients of the degrees 1 and 2, of degree 3, and
    # of degree 4, mm.
    sigma_mm: Array
    covariance: Array  # (G, G) float64 covariance of the shared parameters from them
    degrees_of_freedom: Array  # (G,) float64 degrees of freedom of each variance (Satterthwaite, 1946)


def common_errors(
    bundle: Bundle,
    parameters: AdjustmentParameters,
    loss: Loss,
    at_optimum: FieldEquations | None = None,
) -> CommonErrors | None:
    """Estimate the displacements that all views share (REML; Patterson and Thompson, 1971).

    at_optimum: Residuals and derivatives at the optimum; None to compute them.
    Returns: None if the views have too few stars to show them.
    """
    at_optimum = at_optimum or FieldEquations(bundle, parameters, loss)
    fields, degree = _basis(bundle.observations.target[:, :2])
    count, freedom = len(bundle.names), at_optimum.degrees_of_freedom - fields.shape[2]
    if freedom <= 0:
        return None
    views = [at_optimum.of_view(i, fields[rows]) for i, rows in enumerate(bundle.observations.slices)]
    whole = np.sum([view.normal for view in views], axis=0)
    score = np.sum([view.score for view in views], axis=0)
    coupling = whole[:count, count:]
    response = np.linalg.solve(whole[:count, :count] + bundle.prior_information, coupling)
    together = whole[count:, count:] - coupling.T @ response
    eigenvalues, vectors = np.linalg.eigh(0.5 * (together + together.T))
    determined = eigenvalues > _DETERMINED * eigenvalues[-1]
    roots = np.sqrt(eigenvalues[determined])
    z = (vectors[:, determined].T @ score) / roots
    noise = (sum(view.squares for view in views) - float(z @ z)) / freedom
    if not noise > 0:
        return None
    group = np.maximum(degree, _LOWEST)
    chosen = [(group == kind) & (degree > 0) for kind in range(_LOWEST, _DEGREES + 1)]
    by_coefficient = roots[:, None] * vectors[:, determined].T
    parts = [by_coefficient[:, own] @ by_coefficient[:, own].T for own in chosen]
    to_z = vectors[:, determined] / roots
    own_errors = np.array([view.score - view.normal[count:, count:] @ (to_z @ z) for view in views]) @ to_z
    forms = DenseForms(z, parts, noise * np.eye(len(z)) + own_errors.T @ own_errors)
    start = np.array([z @ z / np.trace(part) / len(parts) for part in parts])
    variances, fisher = maximum_likelihood(forms, start)
    each = np.array(
        [v * response[:, own] @ response[:, own].T for v, own in zip(variances, chosen, strict=True)]
    )
    by_component = np.diagonal(each, axis1=1, axis2=2).T
    return CommonErrors(np.sqrt(variances), each.sum(axis=0), _satterthwaite(by_component, fisher))


def add_common_errors(
    estimate: Uncertainty, bundle: Bundle, estimate_errors: Callable[[], CommonErrors | None]
) -> Uncertainty:
    """Return the uncertainty with the errors that all views share, if the views are inconsistent.

    Views that agree within star noise do not show such errors. Views with a centre each (``planar``, ``drift``) have no
    collimator in common. Fewer than five views cannot tell errors that they share
    from errors of their own; the variance components hold both.

    estimate: Uncertainty without these errors; it may have more parameters than the bundle, at its end.
    estimate_errors: Estimates the errors; called only if they matter.
    Returns: The enlarged uncertainty; the same object if nothing is added.
    """
    if not estimate.inconsistent or bundle.free_centres or len(views_of_poses(bundle)) < SCORE_VIEWS:
        return estimate
    errors = estimate_errors()
    if errors is None:
        return estimate
    at = [estimate.names.index(name) for name in bundle.names]
    common = np.zeros_like(estimate.covariance)
    common[np.ix_(at, at)] = errors.covariance
    covariance = estimate.covariance + common
    before, added = np.diag(estimate.covariance)[at], np.diag(errors.covariance)
    # Welch-Satterthwaite (JCGM 100:2008, annex G.4); the median over the parameters, as for the scores of the views.
    spread = before**2 / estimate.effective_degrees_of_freedom + added**2 / errors.degrees_of_freedom
    freedom = float(np.median((before + added) ** 2 / spread))
    return replace(
        estimate,
        covariance=covariance,
        common=common,
        effective_degrees_of_freedom=max(1.0, min(freedom, estimate.effective_degrees_of_freedom)),
        budget={**estimate.budget, COMMON_ERRORS: np.diag(common)},
    )


def _basis(target_mm: Array) -> tuple[Array, NDArray[np.int64]]:
    """Return (N, 2, F) displacements by a unit of each coefficient, mm, and (F,) their degrees.

    They are polynomials along each axis, of unit mean square and orthogonal over all stars. Own choice of the fields.
    """
    away = target_mm - target_mm.mean(axis=0)
    away /= np.linalg.norm(away, axis=1).max()
    values, degree = monomials(away, _DEGREES)
    smooth = np.linalg.qr(values)[0] * np.sqrt(len(away))
    still = np.zeros_like(smooth)
    fields = np.concatenate([np.stack([smooth, still], axis=1), np.stack([still, smooth], axis=1)], axis=2)
    return fields, np.concatenate([degree, degree])


def _satterthwaite(by_component: Array, fisher: Array) -> Array:
    """Return (G,) the degrees of freedom of variances that are sums of (G, K) components: 2 V^2 / Var(V).

    Source: Satterthwaite (1946). The information is that on the logarithms of the components.
    """
    scatter = np.linalg.pinv(fisher, rcond=1e-6, hermitian=True)
    spread = np.einsum("gk,kl,gl->g", by_component, scatter, by_component)
    tiny = np.finfo(float).tiny
    return np.asarray(2.0 * by_component.sum(axis=1) ** 2 / np.maximum(spread, tiny) + tiny)
