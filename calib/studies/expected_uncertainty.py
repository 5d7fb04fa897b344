"""Expected uncertainty of an adjustment, as the engine would state it.

The covariance is H^-1 (sum of the covariances of the poses' scores) H^-1 (Liang and Zeger, 1986). The degrees of
freedom are those with which the engine would estimate it, and a passport is propagated as the engine does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from calib.calibration import CalibrationOptions
from calib.errors import DegenerateViews
from calib.model.passport import Passport
from calib.studies.expected_fit import Angles, ExpectedFit, PoseShare
from calib.studies.predicted_views import ExpectedBench
from calib.uncertainty.budget_parts import PASSPORT, PRIORS, STARS
from calib.uncertainty.cluster_robust import cluster_robust_covariance
from calib.uncertainty.common_errors import COMMON_ERRORS
from calib.uncertainty.covariance import INCONSISTENCY, SCORE_VIEWS, Uncertainty, inverse_information
from calib.uncertainty.passport_propagation import add_parallax, certificate_share, consider_covariance
from calib.uncertainty.projection_uncertainty import projection_derivatives
from calib.view import View

Array = NDArray[np.float64]

#: A pose determines a direction of the shared parameters if the relative eigenvalue exceeds this.
_DETERMINED = 1e-6
#: Probability that consistent poses are reported as inconsistent.
_FALSE_ALARMS = 1e-3
_GRID_POINTS = 9
_SMALLEST_EIGENVALUE = 1e-15


def expected_fit(
    bench: ExpectedBench,
    views: Sequence[View],
    rotations: Array,
    angles_deg: Sequence[Angles],
    *,
    candidates: bool = False,
) -> ExpectedFit:
    """Return the expected adjustment of views, with the weight that the engine gives to readings of the gimbal.

    If the poses are inconsistent, stars weigh less against the readings by the Birge ratio (Birge, 1932), as in
    `calib.fit`.

    rotations: (n, 3, 3) rotations of the views, camera <- target.
    angles_deg: Angles of the gimbal for each view, degrees.
    candidates: Whether only some of the poses will be recorded (`ExpectedFit`).
    """
    fit = ExpectedFit(bench, views, rotations, angles_deg, candidates=candidates)
    if fit.bundle.gimbal is None:
        return fit
    try:
        birge = expected_estimate(fit, fit.shares).birge_ratio
    except DegenerateViews:
        return fit
    if birge == 1.0:
        return fit
    return ExpectedFit(bench, views, rotations, angles_deg, birge, candidates=candidates)


@dataclass(frozen=True)
class Sigmas:
    """Standard uncertainties that some poses leave; infinite if the poses do not suffice."""

    fx_px: float  # 1-sigma of the focal length fx, px
    worst_px: float  # Largest projection uncertainty over the sensor, 1 sigma, px
    # 0 if the poses determine the camera; otherwise a measure, at least 1, of how far they are from that.
    missing: float = 0.0


class PoseJudge:
    """Judges sums of poses by the uncertainties that they leave."""

    def __init__(self, fit: ExpectedFit) -> None:
        self._fit = fit
        self._by_parameters = projection_derivatives(fit.parameters.camera, _GRID_POINTS)[1]

    def sigmas(self, information: Array, noise: Array) -> Sigmas:
        """Return the uncertainties that some poses leave.

        The criterion of the worst point is the G-optimality of Kiefer and Wolfowitz (1960). With too little
        information, the logarithms of its eigenvalues, scaled to a unit diagonal, order the poses: the pose that
        determines the most directions is the best one (own substitute).

        information, noise: (G, G) sums of the poses' information and of the covariances of their scores.
        Returns: Uncertainties without type B terms, which no pose changes much.
        """
        try:
            covariance = expected_covariance(self._fit, information, noise)
        except DegenerateViews:
            scale = 1.0 / np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
            eigenvalues = np.linalg.eigvalsh(information * np.outer(scale, scale))
            missing = -np.log(np.clip(eigenvalues, _SMALLEST_EIGENVALUE, 1.0)).sum()
            return Sigmas(np.inf, np.inf, 1.0 + float(missing))
        left = self._by_parameters
        size = left.shape[2]
        variances = left @ covariance[:size, :size] @ np.swapaxes(left, 1, 2)
        worst = float(np.linalg.eigvalsh(variances)[:, 1].max())
        fx = self._fit.names.index("fx")
        return Sigmas(float(np.sqrt(covariance[fx, fx])), float(np.sqrt(max(worst, 0.0))))


def expected_covariance(fit: ExpectedFit, information: Array, noise: Array) -> Array:
    """Return the covariance that some poses leave, without a test for their consistency: quick, to compare poses.

    information, noise: (G, G) sums of the poses' information and of the covariances of their scores.
    Returns: (G, G) covariance of all parameters, in the order of `ExpectedFit.names`.
    Raises DegenerateViews: If the poses do not constrain a free parameter.
    """
    count, size = len(fit.bundle.names), len(fit.names)
    prior = fit.prior_information
    own = inverse_information((information + prior)[:count, :count], fit.bundle.names)
    covariance = np.zeros((size, size))
    covariance[:count, :count] = own @ (noise + prior)[:count, :count] @ own
    if fit.passport is None:
        return covariance
    return covariance + _by_passport(fit.passport, own, information)


def expected_estimate(fit: ExpectedFit, shares: Sequence[PoseShare]) -> Uncertainty:
    """Return the uncertainty that the engine is expected to state for some poses, without type B terms.

    Raises DegenerateViews: If the poses do not constrain a free parameter.
    """
    count = len(fit.bundle.names)
    prior = fit.prior_information[:count, :count]
    whole = sum((share.information for share in shares), start=fit.prior_information)
    own = inverse_information(whole[:count, :count], fit.bundle.names)
    ratio, freedom = _birge(shares, own, prior)
    ratio *= fit.growth**2
    inconsistent = freedom > 0 and ratio > special.chdtri(freedom, _FALSE_ALARMS) / freedom
    parts = {STARS: own - own @ prior @ own, PRIORS: own @ prior @ own}
    effective = np.inf
    if inconsistent and (fit.passport is None or fit.passport.is_certificate):
        stars, fields = (
            own @ sum(noises, start=np.zeros_like(own)) @ own
            for noises in (
                [share.noise[:count, :count] for share in shares],
                [share.field_noise[:count, :count] for share in shares],
            )
        )
        parts |= {STARS: stars, INCONSISTENCY: fields}
        effective = _degrees_of_freedom(shares, own, prior)
    parts = {source: _padded(part, len(fit.names)) for source, part in parts.items()}
    birge = float(np.sqrt(ratio)) if inconsistent else 1.0
    if fit.passport is not None and not fit.passport.is_certificate:
        parts = _with_passport(fit, fit.passport, whole, max(birge, fit.passport.birge_ratio))
    elif fit.passport is not None:
        parts[PASSPORT] = _by_passport(fit.passport, own, whole)
    estimate = Uncertainty(
        fit.names,
        np.asarray(sum(parts.values(), start=np.zeros_like(whole))),
        variance_factor=1.0,
        degrees_of_freedom=0,
        birge_ratio=birge,
        inconsistent=bool(inconsistent),
        effective_degrees_of_freedom=float(effective),
        budget={source: np.diag(part) for source, part in parts.items()},
    )
    if fit.certificate is not None:
        estimate = certificate_share(fit.bundle, fit.parameters, estimate, fit.certificate)
    elif inconsistent and fit.passport is None and fit.bundle.gimbal is None:
        estimate = add_parallax(fit.parameters, estimate, CalibrationOptions.parallax_sigma)
    if inconsistent and (fit.passport is None or fit.passport.is_certificate):
        return _with_common_errors(fit, shares, own, estimate)
    return estimate


def _with_common_errors(
    fit: ExpectedFit, shares: Sequence[PoseShare], own: Array, estimate: Uncertainty
) -> Uncertainty:
    """Return the uncertainty with the errors of the collimator that all views share, as the engine adds them.

    The covariance is A D A^T, with the response A of the parameters to the coefficients and their variances D (JCGM
    100:2008, section 5.2). The degrees of freedom stay those of the scores: how well the engine will know D differs
    from one drawn bench to the next.
    """
    if len(shares) < SCORE_VIEWS or not fit.common_variances.size:
        return estimate
    count = len(own)
    response = own @ sum(
        (share.common[:count] for share in shares), start=np.zeros_like(shares[0].common[:count])
    )
    common = np.zeros_like(estimate.covariance)
    common[:count, :count] = (response * fit.common_variances) @ response.T
    return replace(
        estimate,
        covariance=estimate.covariance + common,
        common=common,
        budget={**estimate.budget, COMMON_ERRORS: np.diag(common)},
    )


def _padded(part: Array, size: int) -> Array:
    """Return a covariance of the free parameters with zeros for those that the passport holds."""
    return np.pad(part, (0, size - len(part)))


def _by_passport(passport: Passport, own: Array, information: Array) -> Array:
    """Return (G, G) the covariance that a passport causes (Tapley, Schutz and Born, 2004, chapter 6)."""
    count = len(own)
    moved = np.vstack([-own @ information[:count, count:], np.eye(len(information) - count)])
    return np.asarray(moved @ passport.covariance @ moved.T)


def _with_passport(
    fit: ExpectedFit, passport: Passport, information: Array, growth: float
) -> dict[str, Array]:
    """Return the covariance by source if a passport from views holds the collimator (`propagate_passport`)."""
    exact = replace(passport, covariance=0.0 * passport.covariance)
    alone, stars = (consider_covariance(information, fit.names, held) for held in (exact, passport))
    return {STARS: alone, INCONSISTENCY: (growth**2 - 1.0) * alone, PASSPORT: stars - alone}


def _birge(shares: Sequence[PoseShare], own: Array, prior: Array) -> tuple[float, int]:
    """Return the expected squared Birge ratio of the poses and its degrees of freedom (`calib.uncertainty.covariance`).

    The score of a pose at the optimum has the covariance M - K M - M K^T + K T K^T, with its own M, that of all poses
    and the prior T, and the leverage K (Bell and McCaffrey, 2002).
    """
    count = len(own)
    noises = [(share.noise + share.field_noise)[:count, :count] for share in shares]
    together = sum(noises, start=prior)
    total, freedom = 0.0, int(np.count_nonzero(np.diag(prior))) - count
    for share, noise in zip(shares, noises, strict=True):
        information = share.information[:count, :count]
        leverage = information @ own
        crossed = leverage @ noise
        remaining = noise - crossed - crossed.T + leverage @ together @ leverage.T
        scale = 1.0 / np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
        eigenvalues, vectors = np.linalg.eigh(information * np.outer(scale, scale))
        determined = eigenvalues > _DETERMINED * eigenvalues[-1]
        seen = scale[:, None] * vectors[:, determined] / np.sqrt(eigenvalues[determined])
        total += float(np.einsum("ij,ik,kj->", seen, remaining, seen))
        freedom += int(determined.sum())
    return (total / freedom, freedom) if freedom > 0 else (1.0, 0)


def _degrees_of_freedom(shares: Sequence[PoseShare], own: Array, prior: Array) -> float:
    """Return the degrees of freedom with which the engine estimates the covariance of inconsistent poses.

    From five poses on, those of the scores (Bell and McCaffrey, 2002). With fewer poses, those of the variance
    components scatter from 1 to 8 from one drawn bench to the next; their median is about half a degree of freedom less
    than the number of poses.
    """
    if len(shares) < SCORE_VIEWS:
        return max(1.0, len(shares) - 0.5)
    count = len(own)
    informations = np.array([share.information[:count, :count] for share in shares])
    noises = np.array([(share.noise + share.field_noise)[:count, :count] for share in shares])
    still = np.zeros((len(shares), count))
    shown = cluster_robust_covariance(still, informations, noises, prior, prior)
    return max(1.0, float(np.median(shown.degrees_of_freedom)))
