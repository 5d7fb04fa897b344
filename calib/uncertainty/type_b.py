"""Type B terms of the budget: what they add to the uncertainty of an adjustment.

The terms displace the stars on the target, or change a radius that a certificate gives
(`calib.uncertainty.target_response`). Their covariances are added to that from views, priors and passport.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.bundle import Bundle
from calib.adjustment.levenberg_marquardt import Loss
from calib.adjustment.parameters import AdjustmentParameters
from calib.model.type_b_terms import RADII, TypeBTerm, with_effective_radius
from calib.uncertainty.budget_parts import PASSPORT, PRIORS
from calib.uncertainty.covariance import Uncertainty, coverage_factor
from calib.uncertainty.target_response import TargetResponse, target_response

Array = NDArray[np.float64]


#: Parameters whose degrees of freedom determine the coverage factor.
_FOCAL = ("fx", "fy")
#: Sources of an adjustment whose variance is known: that of passports and priors.
_CERTAIN = (PASSPORT, PRIORS)


@dataclass(frozen=True)
class Contribution:
    """What a term contributes to the covariance of the estimates."""

    term: TypeBTerm
    # (G,) float64 change of each parameter by one unit of the term; for a wavefront, its 1-sigma (without
    # sign).
    sensitivity: Array
    covariance: Array  # (G, G) float64 contribution to the covariance of the parameters
    # Whether the term has a meaning here: terms of a certificate's radius have none where the views determine
    # it.
    applies: bool = True


@dataclass(frozen=True)
class AppliedBudget:
    """An uncertainty with the type B terms of the budget."""

    uncertainty: Uncertainty
    without_terms: Uncertainty  # The uncertainty before, with the same degrees of freedom
    degrees_of_freedom: Array  # (G,) float64 effective degrees of freedom of each parameter
    # (3 n, 3 n) float64 contribution of the terms to the joint covariance of the rotation vectors, rad^2; to
    # be added to that of `without_terms`.
    rotation_covariance: Array
    contributions: tuple[Contribution, ...]
    response: TargetResponse


def apply_budget(
    bundle: Bundle,
    parameters: AdjustmentParameters,
    loss: Loss,
    estimate: Uncertainty,
    terms: Sequence[TypeBTerm],
) -> AppliedBudget:
    """Add the type B terms of the budget to the uncertainty of an adjustment.

    The terms are independent of each other and of the views, so their covariances add up (JCGM 100:2008, section 5.1).
    If a certificate gives the radius, and no term states the difference to the effective radius, the default
    `calib.model.type_b_terms.DEFAULT_EFFECTIVE_RADIUS` enters.
    """
    response = target_response(bundle, parameters, loss, estimate.names)
    return add_terms(response, estimate, terms)


def add_terms(response: TargetResponse, estimate: Uncertainty, terms: Sequence[TypeBTerm]) -> AppliedBudget:
    """Add terms to an uncertainty whose response is known.

    The coverage factor is that of the focal lengths. The standard uncertainty of a parameter with fewer degrees of
    freedom is enlarged, so that this factor covers it as its own would. Own procedure.

    estimate: Uncertainty without the terms.
    terms: The stated terms; the default of the effective radius is added as in `apply_budget`.
    """
    covariance = estimate.covariance.copy()
    turns = np.zeros((3 * len(response.views.local),) * 2)
    contributions, budget = [], dict(estimate.budget)
    for term in with_default_terms(response, terms):
        variance = term.standard_uncertainty**2
        if term.kind == "wavefront":
            shared, local = response.by_wavefront(term)
            sensitivity = np.sqrt(np.maximum(np.diag(shared), 0.0))
        else:
            sensitivity, by_turn = response.by_term(term)
            shared, local = np.outer(sensitivity, sensitivity), np.outer(by_turn, by_turn)
        applies = term.kind not in RADII or response.has_certificate
        contributions.append(Contribution(term, sensitivity, variance * shared, applies))
        covariance += variance * shared
        turns += variance * local
        if applies:
            budget[term.name] = budget.get(term.name, 0.0) + variance * np.diag(shared)
    freedom = effective_degrees_of_freedom(estimate, contributions)
    at = [i for i, name in enumerate(estimate.names) if name in _FOCAL] or range(len(freedom))
    whole = replace(estimate, effective_degrees_of_freedom=float(freedom[at].min()))
    growth = np.array([max(coverage_factor(own) / whole.coverage_factor, 1.0) for own in freedom])
    both = np.outer(growth, growth)
    before = replace(
        whole,
        covariance=both * estimate.covariance,
        budget={source: growth**2 * each for source, each in estimate.budget.items()},
    )
    total = replace(
        whole,
        covariance=both * covariance,
        budget={source: growth**2 * each for source, each in budget.items()},
    )
    grown = tuple(replace(each, covariance=both * each.covariance) for each in contributions)
    return AppliedBudget(total, before, freedom, turns, grown, response)


def with_default_terms(response: TargetResponse, terms: Sequence[TypeBTerm]) -> tuple[TypeBTerm, ...]:
    """Return the terms, with the default of the effective radius if it is needed and not stated.

    response: Response of the estimates; says whether a certificate determines the radius.
    Returns: The stated terms, and the default one.
    """
    return with_effective_radius(terms) if response.has_certificate else tuple(terms)


def radius_difference_variance(response: TargetResponse, terms: Sequence[TypeBTerm]) -> float:
    """Return how much the radius that views give may differ from that of a certificate, because of the terms.

    The terms of the target change the radius that the views give, those of the certificate its own radius. A test of a
    certificate against the views must allow for both, or it blames the certificate for a bowed target.

    response: Response of a fit in which the views determine the radius.
    terms: The stated terms; without one of the effective radius, the default enters.
    Returns: Variance of the difference, mm^2.
    """
    at, variance = response.names.index("r"), 0.0
    for term in with_effective_radius(terms):
        if term.kind in RADII:
            variance += (term.standard_uncertainty * response.r_mm) ** 2
        elif term.kind == "wavefront":
            variance += float(response.shared_by_wavefront(term)[at, at]) * term.standard_uncertainty**2
        else:
            variance += (float(response.shared_by_term(term)[at]) * term.standard_uncertainty) ** 2
    return variance


def effective_degrees_of_freedom(estimate: Uncertainty, contributions: Sequence[Contribution]) -> Array:
    """Return the effective degrees of freedom of each parameter.

    Formula of Welch and Satterthwaite (JCGM 100:2008, annex G.4.1): the squared total variance over the sum of the
    squared variances of the sources, each divided by its degrees of freedom.

    estimate: Uncertainty without the terms.
    Returns: (G,) degrees of freedom; infinite where no source has finite ones.
    """
    own = np.diag(estimate.covariance)
    total = own + sum((np.diag(each.covariance) for each in contributions), start=np.zeros(len(own)))
    known = sum(
        (estimate.budget[source] for source in _CERTAIN if source in estimate.budget), start=0.0 * own
    )
    spread = np.maximum(own - known, 0.0) ** 2 / estimate.effective_degrees_of_freedom
    for each in contributions:
        spread = spread + np.diag(each.covariance) ** 2 / each.term.degrees_of_freedom
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(spread > 0, total**2 / spread, np.inf)
