"""The covariance of an adjustment split by source: stars, gimbal readings, priors, passport, inconsistency.

`calib.uncertainty.covariance` records the variance of each parameter by source. A budget also needs the covariances, to
propagate each source to a point of the image. This module reconstructs them and keeps the recorded variances.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.bundle import Bundle
from calib.adjustment.levenberg_marquardt import Loss
from calib.adjustment.parameters import AdjustmentParameters
from calib.model.aberrations import PARALLAX
from calib.model.gimbal import MOUNTING, NON_ORTHOGONALITY, SCALES, STANDING
from calib.uncertainty.common_errors import COMMON_ERRORS
from calib.uncertainty.covariance import Uncertainty, inverse_information

Array = NDArray[np.float64]

STARS = "stars"
PRIORS = "known beforehand"
PASSPORT = "passport of the collimator"
#: Sources that are shown apart although the recorded budget holds them together.
READINGS = "readings of the gimbal"
PARALLAX_BOUND = "parallax"
GIMBAL_SCALE = "scale and eccentricity of the gimbal"
GIMBAL_AXES = "mounting and axes of the gimbal"
_PRIOR_GROUPS: Mapping[str, tuple[str, ...]] = {
    PASSPORT: ("r",),
    PARALLAX_BOUND: PARALLAX,
    GIMBAL_SCALE: SCALES,
    GIMBAL_AXES: (NON_ORTHOGONALITY, *MOUNTING, *STANDING),
}


def covariance_parts(
    bundle: Bundle, parameters: AdjustmentParameters, loss: Loss, estimate: Uncertainty
) -> dict[str, Array]:
    """Split the covariance of an adjustment by source.

    Own derivation. Let C be the covariance of the free parameters for held ones, H its inverse information. A prior of
    information P contributes C P C, readings with the scores B contribute H B B^T H, and held parameters contribute
    C_fp C_pp^-1 C_pf. Each part is then scaled so that the variances by source are those of `Uncertainty.budget`.

    estimate: Uncertainty without type B terms of the budget.
    Returns: For each source the (G, G) covariance of the parameters, in the order of `Uncertainty.names`.
      Sources that contribute nothing are omitted.
    """
    names = list(estimate.names)
    held = [i for i, name in enumerate(names) if name not in bundle.names]
    common = np.zeros_like(estimate.covariance) if estimate.common is None else estimate.common
    by_passport = _by_held(estimate.covariance - common, held)
    own = estimate.covariance - common - by_passport
    priors = _by_priors(bundle, own, names)
    stars = {STARS: own - sum(priors.values(), start=np.zeros_like(own))}
    if bundle.gimbal is not None and parameters.gimbal is not None:
        readings = _by_readings(bundle, parameters, loss, estimate)
        stars = {STARS: stars[STARS] - readings, READINGS: readings}
    by_passport = by_passport + priors.pop(PASSPORT, 0.0)
    shapes = {
        STARS: stars,
        PRIORS: priors,
        PASSPORT: {PASSPORT: by_passport},
        COMMON_ERRORS: {COMMON_ERRORS: common},
    }
    parts: dict[str, Array] = {}
    for source, variances in estimate.budget.items():
        parts |= _scaled(shapes.get(source, {source: own}), np.asarray(variances))
    return {source: part for source, part in parts.items() if np.diag(part).max() > 0}


def _scaled(shapes: Mapping[str, Array], variances: Array) -> dict[str, Array]:
    """Return covariances scaled so that their variances add up to given ones; negative variances count as zero."""
    wholes = sum((np.maximum(np.diag(each), 0.0) for each in shapes.values()), start=np.zeros(len(variances)))
    scale = np.sqrt(
        np.divide(np.maximum(variances, 0.0), wholes, out=np.zeros(len(variances)), where=wholes > 0)
    )
    return {source: each * np.outer(scale, scale) for source, each in shapes.items()}


def _by_held(covariance: Array, held: Sequence[int]) -> Array:
    """Return (G, G) the part of a consider covariance that held parameters cause."""
    if not held:
        return np.zeros_like(covariance)
    own = covariance[np.ix_(held, held)]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(own), np.finfo(float).tiny))
    inverse = np.linalg.pinv(own * np.outer(scale, scale), hermitian=True) * np.outer(scale, scale)
    return np.asarray(covariance[:, held] @ inverse @ covariance[held])


def _by_priors(bundle: Bundle, own: Array, names: Sequence[str]) -> dict[str, Array]:
    """Return (G, G) covariances that priors cause: parallax, scales and axes of the gimbal, and all other priors."""
    if bundle.prior is None:
        return {}
    grouped = {name: group for group, members in _PRIOR_GROUPS.items() for name in members}
    parts: dict[str, Array] = {}
    for group in (PRIORS, *_PRIOR_GROUPS):
        at = [k for k, name in enumerate(bundle.prior.names) if grouped.get(name, PRIORS) == group]
        if at:
            columns = own[:, [list(names).index(bundle.prior.names[k]) for k in at]]
            parts[group] = columns @ bundle.prior.information[np.ix_(at, at)] @ columns.T
    return parts


def _by_readings(
    bundle: Bundle, parameters: AdjustmentParameters, loss: Loss, estimate: Uncertainty
) -> Array:
    """Return (G, G) the covariance that the scatter of the gimbal's readings causes.

    The local parameters are eliminated by the Schur complement (Triggs et al., 2000, section 6.1).
    """
    assert bundle.gimbal is not None
    assert parameters.gimbal is not None
    equations = bundle.robust_equations(parameters, loss)
    inverse = inverse_information(equations.reduced(), bundle.names)
    derivatives = bundle.gimbal.derivatives(parameters.gimbal, bundle.names)
    local = np.zeros((*derivatives.shape[:2], equations.local.shape[1]))
    local[:, :, :3] = np.eye(3)
    eliminated = np.linalg.solve(equations.local, np.swapaxes(local, 1, 2))
    scores = np.swapaxes(derivatives, 1, 2) - equations.coupling @ eliminated
    root = np.linalg.cholesky(bundle.gimbal.information(parameters.gimbal))
    weighted = bundle.noise_variance * scores @ root
    total = (weighted @ np.swapaxes(weighted, 1, 2)).sum(axis=0)
    part = np.zeros_like(estimate.covariance)
    at = [list(estimate.names).index(name) for name in bundle.names]
    part[np.ix_(at, at)] = inverse @ total @ inverse
    return part
