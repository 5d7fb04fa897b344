"""Covariance of all parameters if a passport holds those of the collimator.

The passport's values are not estimated again; their covariance is propagated to the camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.bundle import Bundle
from calib.adjustment.parameters import AdjustmentParameters
from calib.model.passport import Passport
from calib.model.prior import Prior
from calib.model.type_b_terms import RADII, TypeBTerm, with_effective_radius
from calib.uncertainty.covariance import INCONSISTENCY, Uncertainty, inverse_information

Array = NDArray[np.float64]

#: Source of the budget for a parallax that nobody bounds.
UNBOUNDED_PARALLAX = "parallax, not bounded"


def propagate_passport(
    bundle: Bundle, parameters: AdjustmentParameters, nominal: Uncertainty, passport: Passport
) -> Uncertainty:
    """Return the uncertainty of all parameters if a passport held some of them.

    Star noise is multiplied by the Birge ratio of these views or of those from which the passport was made, whichever
    is larger. Otherwise the small errors of a model would appear as knowledge. Consider covariance: Tapley, Schutz and
    Born (2004), chapter 6. The factor on star noise is this project's own.

    bundle: Bundle that was adjusted with the passport's values held.
    nominal: Uncertainty of the free parameters (`covariance_at_optimum`).
    Returns: Uncertainty of the camera's and the collimator's parameters.
    Raises DegenerateViews: If the views do not constrain a free parameter.
    """
    names, information = _whole_information(bundle, parameters, passport)
    growth = max(nominal.birge_ratio if nominal.inconsistent else 1.0, passport.birge_ratio)
    noise = nominal.variance_factor
    stars, total = (consider_covariance(information / v, names, passport) for v in (noise, growth**2 * noise))
    alone = consider_covariance(
        information / noise, names, replace(passport, covariance=0.0 * passport.covariance)
    )
    own = np.diag(alone)
    return replace(
        nominal,
        names=names,
        covariance=total,
        budget={
            "stars": own,
            INCONSISTENCY: np.diag(total) - np.diag(stars),
            "passport of the collimator": np.diag(stars) - own,
        },
    )


def add_certificate(
    bundle: Bundle, parameters: AdjustmentParameters, estimate: Uncertainty, certificate: Passport
) -> Uncertainty:
    """Return the uncertainty of all parameters if a certificate held the radius.

    A certificate says nothing about the model of these views, so `estimate` already holds what their inconsistency
    adds. The certificate's share is that of a consider covariance (Tapley, Schutz and Born, 2004, chapter 6).

    estimate: Uncertainty of the free parameters, enlarged if the views are inconsistent.
    """
    names, information = _whole_information(bundle, parameters, certificate)
    count = len(bundle.names)
    response = -np.linalg.solve(information[:count, :count], information[:count, count:])
    moved = np.vstack([response, np.eye(len(certificate.names))])
    shared = moved @ certificate.covariance @ moved.T
    covariance = shared.copy()
    covariance[:count, :count] += estimate.covariance
    added = np.zeros(len(certificate.names))
    own = {source: np.concatenate([variances, added]) for source, variances in estimate.budget.items()}
    return replace(
        estimate,
        names=names,
        covariance=covariance,
        budget={**own, "passport of the collimator": np.diag(shared)},
    )


def add_parallax(parameters: AdjustmentParameters, estimate: Uncertainty, share: float) -> Uncertainty:
    """Return the uncertainty with a parallax that nobody bounds, if the model does not estimate it.

    A pupil that moves across the beam of a collimator out of focus changes both focal lengths by one share. The
    residuals do not show it. The models ``field`` and ``coma`` estimate it. The models ``pupil`` and ``rim`` have a
    term for it too, but with inconsistent views their term also holds the curvature and the tilt of the field: of 8
    drawn benches with the model ``rim``, 5 were wrong by up to 1 % of the focal length, beyond their uncertainty.

    parameters: Optimum of an adjustment without certificate and without readings.
    share: 1-sigma of the parallax, as a share of the focal length.
    """
    if "field_curve" in parameters.collimator.aberrations or not share > 0:
        return estimate
    focal = {"fx": parameters.camera.fx, "fy": parameters.camera.fy}
    change = share * np.array([focal.get(name, 0.0) for name in estimate.names])
    return replace(
        estimate,
        covariance=estimate.covariance + np.outer(change, change),
        budget={**estimate.budget, UNBOUNDED_PARALLAX: change**2},
    )


def certificate_prior(certificate: Passport, terms: Sequence[TypeBTerm]) -> Prior:
    """Return the prior of the effective radius over the beam by a certificate.

    Its variance is that of the certificate and that of the terms of the budget that separate the certified radius from
    the effective one (`calib.uncertainty.type_b`).

    Returns: Prior of r, mm.
    """
    r = certificate.values_by_name["r"]
    variance = float(certificate.covariance[0, 0])
    variance += sum(
        (r * term.standard_uncertainty) ** 2 for term in with_effective_radius(terms) if term.kind in RADII
    )
    return Prior(("r",), np.array([r]), np.array([[1.0 / variance]]))


def certificate_share(
    bundle: Bundle, parameters: AdjustmentParameters, estimate: Uncertainty, certificate: Passport
) -> Uncertainty:
    """Return the uncertainty with the certificate's own share, if its radius is a parameter with a prior.

    The prior also holds the terms of the budget that separate the certified radius from the effective one. Their share
    is taken out here, because the budget adds each of them as a row of its own. The response to the mean of a prior is
    that of one more observation (JCGM 100:2008, section 5.2).

    estimate: Uncertainty of the free parameters, enlarged if the views are inconsistent.
    """
    assert bundle.prior is not None
    at, own = bundle.names.index("r"), bundle.prior.names.index("r")
    whole = 1.0 / float(bundle.prior.information[own, own])
    equations = bundle.normal_equations(parameters, bundle.weighted_residuals(parameters))
    inverse = inverse_information(equations.reduced(), bundle.names)
    response = bundle.noise_variance / whole * inverse[:, at]
    certified = min(float(certificate.covariance[0, 0]), whole)
    others = (whole - certified) * np.outer(response, response)
    share = certified * response**2
    known = estimate.budget.get("known beforehand", np.zeros(len(response)))
    budget = {**estimate.budget, "known beforehand": np.maximum(known - whole * response**2, 0.0)}
    budget["passport of the collimator"] = share
    return replace(estimate, covariance=estimate.covariance - others, budget=budget)


def _whole_information(
    bundle: Bundle, parameters: AdjustmentParameters, passport: Passport
) -> tuple[tuple[str, ...], Array]:
    """Return the names of the free and of the held parameters, and their (G, G) information."""
    names = (*bundle.names, *(name for name in passport.names if name not in bundle.names))
    whole = replace(bundle, names=names)
    return names, whole.normal_equations(parameters, whole.weighted_residuals(parameters)).reduced()


def consider_covariance(information: Array, names: Sequence[str], passport: Passport) -> Array:
    """Return the covariance of all parameters if some are held at the values of a passport.

    This is a consider covariance (Tapley, Schutz and Born, 2004, chapter 6). With the information S, free parameters f
    and held parameters p, a change of p moves f by -S_ff^-1 S_fp, so cov_ff = S_ff^-1 + (S_ff^-1 S_fp) cov_p (S_ff^-1
    S_fp)^T.

    information: (G, G) information of the views on all parameters.
    Returns: (G, G) covariance, in the order of the names.
    Raises DegenerateViews: If the views do not constrain a free parameter.
    """
    held = [list(names).index(name) for name in passport.names]
    free = [i for i in range(len(names)) if i not in held]
    own = inverse_information(information[np.ix_(free, free)], [names[i] for i in free])
    answer = -own @ information[np.ix_(free, held)]
    covariance = np.zeros_like(information)
    covariance[np.ix_(free, free)] = own + answer @ passport.covariance @ answer.T
    covariance[np.ix_(free, held)] = answer @ passport.covariance
    covariance[np.ix_(held, free)] = covariance[np.ix_(free, held)].T
    covariance[np.ix_(held, held)] = passport.covariance
    return covariance
