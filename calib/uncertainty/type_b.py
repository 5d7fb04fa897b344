"""Propagation of type B terms to the parameters of an adjustment.

A term displaces the stars on the target, or changes a radius that a certificate holds. The displaced stars move the
image points by du, and the estimated parameters follow by H^-1 J^T W du, with the rotations of the views eliminated.
This linear response holds for every model: a radial term that is estimated takes up most of a bow, for example. The
sensitivities are therefore those of this calibration, with its views, its priors and its passport.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.bundle import Bundle
from calib.adjustment.levenberg_marquardt import Loss
from calib.adjustment.parameters import AdjustmentParameters
from calib.model.type_b_terms import RADII, SCALES, TypeBTerm
from calib.uncertainty.covariance import Uncertainty

Array = NDArray[np.float64]

#: Relative standard uncertainty of the effective radius if it is not stated: 2 px of 3345 px. Simulated collimators
#: that are like real ones showed differences of 0 to 2.7 px.
DEFAULT_EFFECTIVE_RADIUS = 6e-4
_MICRO = 1e-6


@dataclass(frozen=True)
class TargetResponse:
    """Response of the estimates to displacements of the target, and to a held radius.

    Attributes
    ----------
    names
        Names of the G parameters.
    stars_mm
        (M, 2) float64 nominal positions of the stars that the views show, mm.
    axis_mm, r_mm
        Foot of the collimator's axis on the target, and its radius, mm.
    shared
        (G, 3, M) float64 change of each parameter by the displacement of a star along X, Y and Z, per mm.
    turns
        (3 n, 3, M) float64 change of the rotation vectors of n views on the camera's side, rad / mm.
    shared_by_radius, turns_by_radius
        (G,) and (3 n,) float64 changes by a relative change of 1 of the radius of a certificate; zero if no certificate
        determines the radius.
    has_certificate
        Whether a certificate determines the radius.
    """

    names: tuple[str, ...]
    stars_mm: Array
    axis_mm: tuple[float, float]
    r_mm: float
    shared: Array
    turns: Array
    shared_by_radius: Array
    turns_by_radius: Array
    has_certificate: bool

    def by_term(self, term: TypeBTerm) -> tuple[Array, Array]:
        """Return the response to a term by one unit of its value.

        Parameters
        ----------
        term
            A term that is not random from star to star: any kind but ``wavefront``.

        Returns
        -------
        tuple of Array
            (G,) changes of the parameters and (3 n,) changes of the rotation vectors, rad, per unit of the term.
        """
        if term.kind in RADII:
            return self.shared_by_radius, self.turns_by_radius
        displaced = self._displacements(term)
        return np.einsum("gkm,mk->g", self.shared, displaced), np.einsum("gkm,mk->g", self.turns, displaced)

    def _displacements(self, term: TypeBTerm) -> Array:
        """Return (M, 3) displacements of the stars, mm, by one unit of a term.

        A scale displaces a star along its position vector. A bow is a paraboloid about the collimator's axis; that of
        another axis differs by a shift and a tilt of the target only.
        """
        displaced = np.zeros((len(self.stars_mm), 3))
        if term.kind in SCALES:
            displaced[:, :2] = self.stars_mm
        elif term.kind == "print_bow" and term.radius_mm is not None:
            displaced[:, 2] = ((self.stars_mm - self.axis_mm) ** 2).sum(axis=1) / term.radius_mm**2
        return displaced

    def by_wavefront(self, term: TypeBTerm) -> tuple[Array, Array]:
        """Return the covariance of the estimates by random slopes of the wavefront of 1 urad RMS.

        Own model. The wavefront is a Gaussian random field over the beam with a Gaussian correlation function, so its
        slopes are a random field without curl, alike over the correlation length. A slope s displaces a star by r s on
        the target, in all views alike. The RMS is that over the stars after subtraction of the mean slope.

        Parameters
        ----------
        term
            A term of the kind ``wavefront``.

        Returns
        -------
        tuple of Array
            (G, G) covariance of the parameters and (3 n, 3 n) of the rotation vectors, rad^2, per urad^2.
        """
        length = term.correlation_mm or 0.5 * self.star_radius_mm
        away = (self.stars_mm[:, None] - self.stars_mm) / length
        alike = np.exp(-0.5 * (away**2).sum(axis=2))
        blocks = [[((a == b) - away[:, :, a] * away[:, :, b]) * alike for b in (0, 1)] for a in (0, 1)]
        count = len(self.stars_mm)
        mean_square = sum(np.trace(own[i]) / count - own[i].mean() for i, own in enumerate(blocks))
        # One star alone has no slope besides the mean.
        scale = (_MICRO * self.r_mm) ** 2 / mean_square if mean_square > 0 else 0.0
        answers = []
        for each in (self.shared, self.turns):
            pairs = ((each[:, a] @ blocks[a][b] @ each[:, b].T) for a in (0, 1) for b in (0, 1))
            answers.append(scale * np.asarray(sum(pairs)))
        return answers[0], answers[1]

    @property
    def star_radius_mm(self) -> float:
        """Largest distance of a star from the middle of all stars, mm."""
        return float(np.linalg.norm(self.stars_mm - self.stars_mm.mean(axis=0), axis=1).max())


def target_response(
    bundle: Bundle, parameters: AdjustmentParameters, loss: Loss, names: Sequence[str]
) -> TargetResponse:
    """Return the response of the estimates to displacements of the target, at the optimum.

    Linear propagation (JCGM 100:2008, section 5.1.3) through the normal equations, with local parameters eliminated by
    the Schur complement (Triggs et al., 2000, section 6.1). Parameters that a passport holds do not respond.

    Parameters
    ----------
    bundle
        Bundle that was adjusted.
    parameters
        Its optimum.
    loss
        Loss with the limit that the adjustment ended with.
    names
        Names of the parameters of which the response is wanted: the free ones of the bundle, and those held.

    Returns
    -------
    TargetResponse
        The response; that of a held parameter is zero, except to its own change.
    """
    obs = bundle.observations
    residuals = bundle.weighted_residuals(parameters)
    root = loss.curvature_root(residuals)
    equations = bundle.normal_equations(parameters, residuals, root)
    weight = obs.whitening if root is None else root @ obs.whitening
    square = np.swapaxes(weight, 1, 2) @ weight
    stars, index = np.unique(obs.target[:, :2], axis=0, return_inverse=True)
    index = index.reshape(-1)
    count, views = len(bundle.names), len(obs.slices)
    shared = np.zeros((count, 3, len(stars)))
    local = np.zeros((views, equations.local.shape[1], 3, len(stars)))
    # A displacement of a star moves its image as the centre does, with the opposite sign; the centre has Z = -r.
    moving = replace(bundle, names=("x", "y", "r"), prior=None, free_centres=False)
    derivatives = zip(obs.slices, bundle.jacobians(parameters), moving.jacobians(parameters), strict=True)
    for i, (rows, jacobian, moves) in enumerate(derivatives):
        along = moves[:3] * np.array([-1.0, -1.0, 1.0])[:, None, None]
        weighted = np.einsum("mij,kjm->kim", square[rows], along)
        gradients = np.einsum("gim,kim->gkm", jacobian, weighted)
        local[i][:, :, index[rows]] = gradients[count:]
        eliminated = np.linalg.solve(equations.local[i], gradients[count:].reshape(len(jacobian) - count, -1))
        shared[:, :, index[rows]] += gradients[:count] - (equations.coupling[i] @ eliminated).reshape(
            count, 3, -1
        )
    information = equations.reduced()
    free = _solved(information, shared.reshape(count, -1)).reshape(shared.shape)
    turns = _turns(equations.local, equations.coupling, local, free)
    r = parameters.collimator.r
    by_radius, has_certificate = _radius_gradient(bundle, names, free, information, r)
    own = np.zeros(len(names))
    if has_certificate and "r" not in bundle.names:
        own[list(names).index("r")] = r
    # A radius with a prior moves the rotations only through the other parameters.
    turns_by_radius = -r * turns[:, 2].sum(axis=1)
    if "r" in bundle.names:
        still = np.zeros((*local.shape[:2], 1, 1))
        turns_by_radius = _turns(equations.local, equations.coupling, still, by_radius[:, None, None])[
            :, 0, 0
        ]
    return TargetResponse(
        tuple(names),
        stars,
        (parameters.collimator.x, parameters.collimator.y),
        r,
        _spread(free, bundle.names, names),
        turns,
        own + _spread(by_radius, bundle.names, names),
        turns_by_radius if has_certificate else np.zeros(len(turns)),
        has_certificate,
    )


def _radius_gradient(
    bundle: Bundle, names: Sequence[str], free: Array, information: Array, r: float
) -> tuple[Array, bool]:
    """Return the change (G,) of the free parameters by a relative change of the certificate's radius.

    A held radius that grows acts as a target that moves towards the camera. A radius with a prior follows the mean of
    the prior. The second entry is whether there is a certificate: a passport that holds or gives the radius alone.
    """
    held = [name for name in names if name not in bundle.names]
    if held == ["r"]:
        return -r * free[:, 2].sum(axis=1), True
    prior = bundle.prior
    if "r" in bundle.names and prior is not None and "r" in prior.names:
        at = [bundle.names.index(name) for name in prior.names]
        gradient = np.zeros((len(bundle.names), 1))
        gradient[at, 0] = bundle.noise_variance * prior.information[:, prior.names.index("r")] * r
        return _solved(information, gradient)[:, 0], True
    return np.zeros(len(bundle.names)), False


def _turns(local: Array, coupling: Array, gradients: Array, shared: Array) -> Array:
    """Return (3 n, 3, M) the response of the rotations, by back-substitution (Triggs et al., 2000, section 6.1)."""
    right = gradients - np.einsum("ngl,gkm->nlkm", coupling, shared)
    answer = np.linalg.solve(local, right.reshape(*right.shape[:2], -1)).reshape(right.shape)
    return np.asarray(answer[:, :3].reshape(-1, *right.shape[2:]))


def _solved(information: Array, right: Array) -> Array:
    """Solve the normal equations for the columns of `right`, scaled to a unit diagonal (van der Sluis, 1969)."""
    scale = 1.0 / np.sqrt(np.diag(information))
    return np.asarray(
        scale[:, None] * np.linalg.solve(information * np.outer(scale, scale), scale[:, None] * right)
    )


def _spread(values: Array, own: Sequence[str], names: Sequence[str]) -> Array:
    """Return values of some parameters in the order of all names; zeros for the others."""
    spread = np.zeros((len(names), *values.shape[1:]))
    for name, value in zip(own, values, strict=True):
        if name in names:
            spread[list(names).index(name)] = value
    return spread


@dataclass(frozen=True)
class Contribution:
    """What a term contributes to the covariance of the estimates.

    Attributes
    ----------
    term
        The term.
    sensitivity
        (G,) float64 change of each parameter by one unit of the term; for a wavefront, its 1-sigma (without sign).
    covariance
        (G, G) float64 contribution to the covariance of the parameters.
    applies
        Whether the term has a meaning here: terms of a certificate's radius have none where the views determine it.
    """

    term: TypeBTerm
    sensitivity: Array
    covariance: Array
    applies: bool = True


@dataclass(frozen=True)
class AppliedBudget:
    """An uncertainty with the type B terms of the budget.

    Attributes
    ----------
    uncertainty
        The uncertainty with the terms: covariance, budget and effective degrees of freedom. The latter are those of the
        parameter that has the fewest.
    without_terms
        The uncertainty before.
    degrees_of_freedom
        (G,) float64 effective degrees of freedom of each parameter.
    rotation_covariance
        (3 n, 3 n) float64 contribution of the terms to the joint covariance of the rotation vectors, rad^2; to be added
        to that of `without_terms`.
    contributions
        What each term contributes.
    response
        The response of the estimates.
    """

    uncertainty: Uncertainty
    without_terms: Uncertainty
    degrees_of_freedom: Array
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
    `DEFAULT_EFFECTIVE_RADIUS` enters.

    Parameters
    ----------
    bundle
        Bundle that was adjusted; corrections of the terms are contained in its data.
    parameters
        Its optimum.
    loss
        Loss with the limit that the adjustment ended with.
    estimate
        Uncertainty from views, priors and passport.
    terms
        The stated terms.

    Returns
    -------
    AppliedBudget
        The new uncertainty, and the contribution of each term.
    """
    response = target_response(bundle, parameters, loss, estimate.names)
    return add_terms(response, estimate, terms)


def add_terms(response: TargetResponse, estimate: Uncertainty, terms: Sequence[TypeBTerm]) -> AppliedBudget:
    """Add terms to an uncertainty whose response is known.

    Parameters
    ----------
    response
        Response of the estimates, for the names of the uncertainty.
    estimate
        Uncertainty without the terms.
    terms
        The stated terms; the default of the effective radius is added as in `apply_budget`.

    Returns
    -------
    AppliedBudget
        The new uncertainty, and the contribution of each term.
    """
    covariance = estimate.covariance.copy()
    turns = np.zeros((len(response.turns), len(response.turns)))
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
    total = replace(
        estimate,
        covariance=covariance,
        budget=budget,
        effective_degrees_of_freedom=float(freedom.min()),
    )
    return AppliedBudget(total, estimate, freedom, turns, tuple(contributions), response)


def with_default_terms(response: TargetResponse, terms: Sequence[TypeBTerm]) -> tuple[TypeBTerm, ...]:
    """Return the terms, with the default of the effective radius if it is needed and not stated.

    Parameters
    ----------
    response
        Response of the estimates; says whether a certificate determines the radius.
    terms
        The stated terms.

    Returns
    -------
    tuple of TypeBTerm
        The stated terms, and the default one.
    """
    if not response.has_certificate or any(term.kind == "effective_radius" for term in terms):
        return tuple(terms)
    default = TypeBTerm(
        "effective radius",
        "effective_radius",
        DEFAULT_EFFECTIVE_RADIUS,
        "default of Starbench; not stated",
    )
    return (*terms, default)


def effective_degrees_of_freedom(estimate: Uncertainty, contributions: Sequence[Contribution]) -> Array:
    """Return the effective degrees of freedom of each parameter.

    Formula of Welch and Satterthwaite (JCGM 100:2008, annex G.4.1): the squared total variance over the sum of the
    squared variances of the sources, each divided by its degrees of freedom.

    Parameters
    ----------
    estimate
        Uncertainty without the terms.
    contributions
        Contributions of the terms.

    Returns
    -------
    Array
        (G,) degrees of freedom; infinite where no source has finite ones.
    """
    own = np.diag(estimate.covariance)
    total = own + sum((np.diag(each.covariance) for each in contributions), start=np.zeros(len(own)))
    spread = own**2 / estimate.effective_degrees_of_freedom
    for each in contributions:
        spread = spread + np.diag(each.covariance) ** 2 / each.term.degrees_of_freedom
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(spread > 0, total**2 / spread, np.inf)
