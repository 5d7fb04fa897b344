"""How sure the estimates are: their covariance at the optimum, and what views disagree on.

Knows residuals and normal equations. The covariance rests on what the residuals show, not on what the stars'
covariances promise: J^T J inverted, times the variance of the influence function over the square of its mean slope
(Huber's formula for M-estimators). That holds when the model does. Whether it does, the views tell: each alone would
like other shared parameters, and when they differ by more than their stars' noise allows, the covariance is that of
their pulls (`cluster_robust`), and of fewer than five that of `variance_components`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from calib.adjustment.bundle import Bundle
from calib.adjustment.levenberg_marquardt import Loss
from calib.adjustment.parameters import AdjustmentParameters
from calib.errors import DegenerateViews
from calib.model.passport import Passport
from calib.uncertainty.cluster_robust import cluster_robust_covariance
from calib.uncertainty.variance_components import VarianceComponents

Array = NDArray[np.float64]

#: Below this, the information matrix scaled to a unit diagonal is singular to working precision.
_SINGULAR = 1e-13
#: A view alone tells a direction of the shared parameters when its eigenvalue exceeds this.
_DETERMINED = 1e-6
#: Views that agree are found to disagree this rarely.
_FALSE_ALARMS = 1e-3
#: From this number of views on, their pulls at the parameters tell more than how their stars miss alike.
_SCORE_VIEWS = 5
#: From this number on, what shape the pulls' covariance is taken for matters little, and the fields take long.
_MANY_VIEWS = 16
_INCONSISTENCY = "disagreement of the views"
#: Probability that k = 2 covers for a Gaussian.
_COVERAGE = 0.9545


@dataclass(frozen=True)
class Uncertainty:
    """Covariance of the shared parameters.

    Attributes
    ----------
    names
        The parameters.
    covariance
        (G, G), in their order.
    variance_factor
        Estimated variance of a weighted residual component.
    degrees_of_freedom
        Measured components less estimated parameters.
    disagreement
        How many times the stars' noise the views' estimates differ by: the Birge ratio. 1 is agreement.
    disagree
        Whether that is more than chance allows, and the covariance was inflated.
    effective_freedom
        Degrees of freedom behind the covariance: the stars' when views agree, else the views'.
    budget
        (G,) variance of each parameter by source; the sources add up to the covariance's diagonal.
    """

    names: tuple[str, ...]
    covariance: Array
    variance_factor: float
    degrees_of_freedom: int
    birge_ratio: float = 1.0
    inconsistent: bool = False
    effective_degrees_of_freedom: float = float("inf")
    budget: Mapping[str, Array] = field(default_factory=dict)

    @property
    def coverage_factor(self) -> float:
        """The k for which value +- k sigma covers 95.45 % (Student)."""
        tail = 0.5 + 0.5 * _COVERAGE
        if np.isinf(self.effective_degrees_of_freedom):
            return float(special.ndtri(tail))
        return float(special.stdtrit(self.effective_degrees_of_freedom, tail))


def covariance_at_optimum(bundle: Bundle, parameters: AdjustmentParameters, loss: Loss) -> Uncertainty:
    """Return the covariance of the shared parameters at the optimum, were the model right.

    Raises
    ------
    DegenerateViews
        When there are no more measurements than parameters, or the views leave a parameter free.
    """
    residuals = bundle.weighted_residuals(parameters)
    lengths = np.linalg.norm(residuals, axis=1)
    equations = bundle.normal_equations(parameters, residuals)
    count = len(bundle.names) + equations.local_gradient.size
    known = len(bundle.prior.names) if bundle.prior else 0
    known += parameters.offsets.size if bundle.has_drift_prior else 0
    freedom = 2 * len(lengths) - count + known
    if freedom <= 0:
        raise DegenerateViews(
            f"{2 * len(lengths)} measurements cannot determine {count} parameters.",
            remedy="Add views, or views with more stars.",
        )
    influence = loss.weights(lengths) * lengths
    # The mean of rho's second derivative over directions in the plane: half its trace.
    slope = 0.5 * (loss.weights(lengths) + loss.second_derivatives(lengths)).mean()
    variance = float((influence**2).sum() / freedom)
    factor = variance / float(slope) ** 2
    # Priors weigh noise_variance in these equations, so that is what the inverse is to be scaled by.
    scale = bundle.noise_variance if known else factor
    covariance = scale * inverse_information(equations.reduced(), bundle.names)
    ratio, views_freedom = _birge(bundle, parameters, loss, variance)
    limit = special.fdtri(views_freedom, freedom, 1.0 - _FALSE_ALARMS) if views_freedom > 0 else np.inf
    return Uncertainty(
        bundle.names,
        covariance,
        factor,
        freedom,
        birge_ratio=float(np.sqrt(ratio)),
        inconsistent=bool(ratio > limit),
        effective_degrees_of_freedom=float(views_freedom if ratio > limit else freedom),
        budget=_budget(bundle, covariance),
    )


def propagate_passport(
    bundle: Bundle, parameters: AdjustmentParameters, known: Uncertainty, passport: Passport
) -> Uncertainty:
    """Return the uncertainty of all parameters where a passport held some of them.

    The stars count by what views disagree on, here or when the passport was made: their noise alone would let a
    model's small faults pass for knowledge.
    """
    names = (*parameters.camera.parameter_names, *parameters.collimator.parameter_names)
    whole = replace(bundle, names=names)
    information = whole.normal_equations(parameters, whole.weighted_residuals(parameters)).reduced()
    growth = max(known.birge_ratio if known.inconsistent else 1.0, passport.birge_ratio)
    noise = known.variance_factor
    stars, total = (consider_covariance(information / v, names, passport) for v in (noise, growth**2 * noise))
    alone = consider_covariance(
        information / noise, names, replace(passport, covariance=0.0 * passport.covariance)
    )
    own = np.diag(alone)
    return replace(
        known,
        names=names,
        covariance=total,
        budget={
            "stars": own,
            _INCONSISTENCY: np.diag(total) - np.diag(stars),
            "passport of the collimator": np.diag(stars) - own,
        },
    )


def consider_covariance(information: Array, names: Sequence[str], passport: Passport) -> Array:
    """Return the covariance of all parameters, those of a passport held at its values.

    With S the information, f the free and p the held parameters: a change of p moves f by -S_ff^-1 S_fp, so
    cov_ff = S_ff^-1 + (S_ff^-1 S_fp) cov_p (S_ff^-1 S_fp)^T.

    Parameters
    ----------
    information
        (G, G) what the views tell of all parameters.
    names
        The parameters.
    passport
        Its names are the held ones.

    Raises
    ------
    DegenerateViews
        When the views leave a free parameter free.
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


def rotation_covariance(bundle: Bundle, parameters: AdjustmentParameters, known: Uncertainty) -> Array:
    """Return (3 n, 3 n) the joint covariance of all views' rotations, rad^2, turns on the camera's side.

    What the stars of each view leave, and what all share through the camera and the collimator.
    """
    whole = replace(bundle, names=known.names)
    equations = whole.normal_equations(parameters, whole.weighted_residuals(parameters))
    growth = known.birge_ratio if known.inconsistent else 1.0
    inverse = np.linalg.inv(equations.local)
    answer = -(inverse @ np.swapaxes(equations.coupling, 1, 2))[:, :3].reshape(-1, len(known.names))
    joint = answer @ known.covariance @ answer.T
    for i, own in enumerate(inverse[:, :3, :3]):
        joint[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] += growth**2 * known.variance_factor * own
    return np.asarray(joint)


def _budget(bundle: Bundle, covariance: Array) -> Mapping[str, Array]:
    """Split the variances into what the stars and what the priors leave."""
    variances = np.diag(covariance)
    if bundle.prior is None:
        return {"stars": variances}
    at = [bundle.names.index(name) for name in bundle.prior.names]
    by_prior = np.einsum("gk,kl,gl->g", covariance[:, at], bundle.prior.information, covariance[:, at])
    return {"stars": variances - by_prior, "known beforehand": by_prior}


def inflate(
    known: Uncertainty,
    bundle: Bundle,
    parameters: AdjustmentParameters,
    loss: Loss,
    found: Callable[[], VarianceComponents],
) -> Uncertainty:
    """Return the uncertainty with what the views disagree on; unchanged when they agree.

    Fewer than five views are judged by how their stars miss alike. From five on, the views' pulls give each sigma
    (`calib.uncertainty.cluster_robust`), correlations kept.

    Parameters
    ----------
    known
        The uncertainty were the model right.
    bundle, state, loss
        What was fitted, its optimum, and the loss with the limit it ended with.
    found
        Measures what views disagree on (`variance_components`); asked where they disagree and are fewer than 16.
    """
    if not known.inconsistent:
        return known
    views = len(parameters.rotations)
    if views >= _MANY_VIEWS:
        return _by_scores(known, bundle, parameters, loss, None)
    shared = found()
    shaped = _with_fields(known, shared)
    return (
        shaped
        if views < _SCORE_VIEWS
        else _by_scores(shaped, bundle, parameters, loss, shared.score_covariances)
    )


def _with_fields(known: Uncertainty, shared: VarianceComponents) -> Uncertainty:
    """Return the uncertainty by the fields that neighbouring stars share."""
    budget = {"stars": np.diag(shared.star_covariance), "known beforehand": np.diag(shared.prior_covariance)}
    return replace(
        known,
        covariance=shared.covariance,
        effective_degrees_of_freedom=max(
            1.0, min(shared.effective_degrees_of_freedom, known.effective_degrees_of_freedom)
        ),
        budget={
            **{source: budget[source] for source in known.budget},
            _INCONSISTENCY: np.diag(shared.field_covariance),
        },
    )


def _by_scores(
    known: Uncertainty, bundle: Bundle, parameters: AdjustmentParameters, loss: Loss, working: Array | None
) -> Uncertainty:
    """Return the uncertainty with each sigma as the views' pulls show it, but no less than the stars leave.

    `working` (n, G, G) is what the covariance of each pull is taken for; None: what the stars' noise gives it. The
    degrees of freedom differ from parameter to parameter; their median stands for all.
    """
    residuals = bundle.weighted_residuals(parameters)
    influence = residuals * loss.weights(np.linalg.norm(residuals, axis=1))[:, None]
    equations = list(bundle.scores(parameters, influence, loss.curvature_root(residuals)))
    information, scores = (np.array(each) for each in zip(*equations, strict=True))
    working = known.variance_factor * information if working is None else working
    prior = bundle.prior_information
    shown = cluster_robust_covariance(scores, information, working, prior, bundle.noise_variance * prior)
    others = {source: variances for source, variances in known.budget.items() if source != _INCONSISTENCY}
    least = sum(others.values(), start=np.zeros(len(known.names)))
    variances = np.maximum(shown.variances, least)
    growth = np.sqrt(variances / np.diag(known.covariance))
    return replace(
        known,
        covariance=known.covariance * np.outer(growth, growth),
        effective_degrees_of_freedom=max(
            1.0, min(float(np.median(shown.degrees_of_freedom)), known.effective_degrees_of_freedom)
        ),
        budget={**others, _INCONSISTENCY: variances - least},
    )


def _birge(
    bundle: Bundle, parameters: AdjustmentParameters, loss: Loss, variance: float
) -> tuple[float, int]:
    """Return the mean square by which views pull at the shared parameters, over what noise explains.

    At the optimum the views' pulls s_i cancel. Noise gives each the covariance variance * A_i, A_i its own
    information on the shared parameters; the sum of s_i^T A_i^+ s_i has as many degrees of freedom as
    the views tell directions, less the parameters they share.
    """
    residuals = bundle.weighted_residuals(parameters)
    influence = residuals * loss.weights(np.linalg.norm(residuals, axis=1))[:, None]
    total, freedom = 0.0, -len(bundle.names) + (len(bundle.prior.names) if bundle.prior else 0)
    for information, score in bundle.scores(parameters, influence):
        scale = 1.0 / np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
        eigenvalues, vectors = np.linalg.eigh(information * np.outer(scale, scale))
        determined = eigenvalues > _DETERMINED * eigenvalues[-1]
        total += float(((vectors[:, determined].T @ (scale * score)) ** 2 / eigenvalues[determined]).sum())
        freedom += int(determined.sum())
    return (total / freedom / variance, freedom) if freedom > 0 and variance > 0 else (1.0, 0)


def inverse_information(information: Array, names: Sequence[str]) -> Array:
    """Return the covariance that information on named parameters leaves.

    Raises
    ------
    DegenerateViews
        When it leaves a parameter free; names it.
    """
    diagonal = np.diag(information)
    if not (diagonal > 0).all():
        free = names[int(np.argmin(diagonal))]
        raise DegenerateViews(f"These views do not constrain {free}.", remedy="Add views from other angles.")
    scale = 1.0 / np.sqrt(diagonal)
    eigenvalues, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    if eigenvalues[0] < _SINGULAR * eigenvalues[-1]:
        worst = np.argsort(-np.abs(vectors[:, 0]))[:2]
        free = " and ".join(names[i] for i in sorted(worst))
        raise DegenerateViews(
            f"These views cannot separate {free}.", remedy="Add views turned about other axes."
        )
    return np.asarray((vectors / eigenvalues) @ vectors.T * np.outer(scale, scale))
