"""Covariance of all parameters if a passport holds those of the collimator.

The passport's values are not estimated again; their covariance is propagated to the camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.bundle import Bundle
from calib.adjustment.loss import Loss
from calib.adjustment.parameters import AdjustmentParameters
from calib.model.budget_row import PASSPORT, POSE_FIELDS, STARS
from calib.model.passport import Passport
from calib.uncertainty.covariance import Uncertainty, inverse_information

Array = NDArray[np.float64]


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
    return replace(
        nominal,
        names=names,
        covariance=total,
        parts={STARS: alone, POSE_FIELDS: total - stars, PASSPORT: stars - alone},
    )


def _whole_information(
    bundle: Bundle, parameters: AdjustmentParameters, passport: Passport
) -> tuple[tuple[str, ...], Array]:
    """Return the names of the free and of the held parameters, and their (G, G) information."""
    names = (*bundle.names, *(name for name in passport.names if name not in bundle.names))
    whole = replace(bundle, names=names)
    return names, whole.equations(parameters, Loss("l2")).eliminated().information.sum(axis=0)


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
