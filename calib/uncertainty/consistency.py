"""Test whether views contradict the passport of a collimator.

The views are adjusted again without the passport's centre, but with its aberrations. If they determine the centre
themselves, it is compared with the passport's, with both uncertainties.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from calib.adjustment.bundle import Bundle
from calib.adjustment.levenberg_marquardt import Loss, refine
from calib.adjustment.parameters import AdjustmentParameters
from calib.errors import DegenerateViews, PassportContradicted
from calib.model.collimator import CENTRE
from calib.model.passport import Passport
from calib.model.prior import joined
from calib.model.type_b_terms import TypeBTerm
from calib.uncertainty.common_errors import add_common_errors, common_errors
from calib.uncertainty.covariance import covariance_at_optimum
from calib.uncertainty.target_response import target_response
from calib.uncertainty.type_b import radius_difference_variance

#: Probability that a correct passport is refused.
_FALSE_ALARMS = 1e-4
_REMEDY = "Check that the passport belongs to this collimator and nothing moved, or calibrate without it."
_BIASED = "Use the model auto: errors of the collimator bias the spherical model."


def check_passport(
    bundle: Bundle,
    parameters: AdjustmentParameters,
    loss: Loss,
    passport: Passport,
    terms: Sequence[TypeBTerm] = (),
    parallax_sigma: float = 0.0,
) -> None:
    """Refuse a passport whose centre contradicts the views, by a chi-square test.

    A single view, or views that do not determine the centre, cannot contradict it. Let d be the centre found minus the
    passport's, with independent covariances V and P. Then d^T (V + P)^-1 d has a chi-square distribution if the errors
    are normal (Rao, 1973). Views that are inconsistent may hold a parallax, which changes r and the focal length by one
    share and leaves no residuals. Errors that all views share may move r far, because few directions of the stars
    determine it. Against a certificate, V therefore includes both.

    terms: Type B terms; what they may change adds to the uncertainty of a certificate's radius.
    parallax_sigma: 1-sigma of a parallax that nobody bounds, as a share of r. It counts only for views that
      are inconsistent.
    Raises PassportContradicted: If the chi-square of the difference has a probability below 1 in 10000; gives
      both values, their uncertainties and the chi-square.
    """
    spread = float((bundle.weighted_residuals(parameters) ** 2).mean())
    names = (*bundle.names, *passport.names)
    prior = joined(bundle.prior, passport.prior(passport.terms))
    free = replace(bundle, names=names, prior=prior, noise_variance=spread)
    refined = refine(free, parameters, loss)
    if len(parameters.rotations) < 2 or not refined.converged:
        return
    try:
        estimate = covariance_at_optimum(free, refined.parameters, loss)
    except DegenerateViews:
        return
    asked = [name for name in passport.names if name in CENTRE]
    at = [names.index(name) for name in asked]
    growth = max(estimate.birge_ratio if estimate.inconsistent else 1.0, passport.birge_ratio)
    found, covariance = refined.parameters.values(asked), growth**2 * estimate.covariance[np.ix_(at, at)]
    stated, own = np.array([passport.values_by_name[name] for name in asked]), passport.covariance_of(asked)
    off, together = found - stated, covariance + own
    from scipy import special

    limit = float(special.chdtri(len(asked), _FALSE_ALARMS))
    chi_square = float(off @ np.linalg.solve(together, off))
    if chi_square <= limit:  # what follows only adds uncertainty
        return
    if passport.is_certificate:
        response = target_response(free, refined.parameters, loss, names)
        together = together + radius_difference_variance(response, terms)
        if estimate.inconsistent:
            together = together + (parallax_sigma * stated[0]) ** 2
            errors = partial(common_errors, free, refined.parameters, loss)
            common = add_common_errors(estimate, free, errors).common
            together = together if common is None else together + common[np.ix_(at, at)]
    chi_square = float(off @ np.linalg.solve(together, off))
    if chi_square > limit:
        worst = int(np.argmax(np.abs(off) / np.sqrt(np.diag(together))))
        raise PassportContradicted(
            f"The passport gives {asked[worst]} = {stated[worst]:.2f} +- {np.sqrt(own[worst, worst]):.2f} mm; these "
            f"views give {found[worst]:.2f} +- {np.sqrt((together - own)[worst, worst]):.2f} mm "
            f"(chi-square {chi_square:.0f} with {len(asked)} degrees of freedom).",
            where="collimator passport",
            remedy=_REMEDY if parameters.collimator.aberrations else f"{_BIASED} {_REMEDY}",
        )
