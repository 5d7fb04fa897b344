"""Discs of all views of one bench, fitted together to the points at which the light of each view ends.

A short arc of the rim alone says little about the centre of its disc: centre, radius and shape exchange. But the discs
of one bench are alike. How much alike, the views themselves show. The model is a linear hierarchical one (Lindley and
Smith, 1972; Gelman et al., Bayesian Data Analysis, chapter 15). For a view i and a point in direction phi, at distance
rho from the centre c_i,

    rho = R_i + sum over m = 2 to 5 of a_im cos(m phi) + b_im sin(m phi).

Over the views, the centre is c_i = c + W t_i + scatter, where t_i is the point of the target at which the camera looks:
the disc moves with the camera if the entrance pupil is not on the gimbal's axes. Radius and shape have common values
and scatters too, so that a stop that is not round, but always the same, is found from all arcs together. The three
scatters (centre, radius, shape) are unknown. The posterior is averaged over a grid of them, each weighted by its
marginal likelihood. So a bench with round rims gets small uncertainties, and a bench whose rims differ from view to
view gets large ones.

A view also shows where the rim is not: points at the border of the frame are bright. Each gives a factor
Phi((rim - point) / sigma), included by expectation propagation (Minka, 2001). Without these factors the radius would be
too small, because arcs that lie farther in are in view more often.

A view enters by the information and the right side of its normal equations, linearised in its centre, radius and
Fourier coefficients.

The module uses points on the target's plane. It uses no image and no camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np

from calib.arrays import Array, Complexes, median
from calib.view import RimPoints

#: Makes complex numbers of places: the powers of a direction are its waves, at a fraction of the time of cosines.
_PLANE = np.array([1.0, 1.0j])
#: Fourier orders of the edge's shape; order 1 is the centre.
_ORDERS = np.arange(2, 6)
UNKNOWNS = 3 + 2 * len(_ORDERS)
"""Number of unknowns of a view: centre x and y, mean radius, cosine and sine of each order of the shape, all in mm."""
#: 1-sigma of the border between bright and dark at a bright point of the frame's border, mm.
_LIT_SIGMA_MM = 0.5
#: Share of its new value that a site takes.
_DAMPING = 0.5
_HUBER = 2.5  # Scatters beyond which an offset counts less
#: Grid of the 1-sigma scatters between views, as shares of the radius: centre, radius, coefficients of the shape. Each
#: grid is even in the logarithm, from differences that do not matter to those of the published recordings.
_CENTRE_SCATTERS = (0.003, 0.01, 0.03, 0.09, 0.2)
_RADIUS_SCATTERS = (0.001, 0.004, 0.018, 0.08)
_SHAPE_SCATTERS = (0.0004, 0.0015, 0.005, 0.015, 0.04)
#: Prior weight of a scatter: its power of this exponent. A few arcs cannot exclude large scatters, and sigmas would be
#: too small on benches whose rims differ from view to view; where the rims are alike, the data decide.
_SCATTER_POWER = 1.0
#: A gimbal holds the pupil so well that the centres scatter by at most this share of the disc's radius.
_HELD = 0.017
#: Power of the likelihood of the scatters. Views that look in neighbouring directions look through the same glass, so
#: the nine views of a bench are about five independent ones.
_LIKELIHOOD_POWER = 0.5
#: Scatters of a smaller weight no longer take part after two rounds.
_LEAST_WEIGHT = 1e-6
#: Scatters of a smaller weight do not enter the average.
_LEAST_AVERAGED = 1e-4
#: Prior 1-sigma of what the views have in common: centre and radius as shares of the first guess, motion of the disc
#: in mm per mm of the camera's look, and coefficients of the shape as shares of the radius.
_CENTRE_PRIOR, _RADIUS_PRIOR, _WALK_PRIOR, _SHAPE_PRIOR = 0.6, 0.4, 0.3, 0.03
#: The rim counts as visible if the 1-sigma of the disc's centre is at most this share of its radius.
_VISIBLE_RIM_SIGMA = 0.15
#: Smallest 1-sigma of a point, mm: neighbouring points share errors of the map.
_POINT_FLOOR_MM = 0.03
#: Largest number of bright points of a view that take part.
_MOST_BRIGHT = 30
#: Rounds at most; a round that moves no centre farther than this, mm, is the last.
_ROUNDS, _SETTLED_MM = 20, 1e-3
#: The same for the fits that average over the scatters.
_FINAL_ROUNDS, _FINAL_SETTLED_MM = 10, 0.02
#: Share of a step that is taken. Whole steps run away where a short arc does not tell its shape from its centre.
_STEP = 0.5
#: Scatters, as shares of the radius, with which the fit starts: centre, radius, shape.
_FIRST_SCATTERS = (0.12, 0.05, 0.03)
#: Number of the unknowns of a view that have each of the three scatters.
_ALIKE = (2, 1, UNKNOWNS - 3)


class Evidence(NamedTuple):
    """What the points of all views say about their unknowns, linearised."""

    information: Array  # (V, P, P) Fisher information of the unknowns of each view
    product: Array  # (V, P) normal equations' right sides: information times the best unknowns


class _Sites(NamedTuple):
    """(V, K) precisions of points, and precisions times means of the gap to the rim: Gaussian sites of bright points.

    The gap at points of the rim itself has mean zero.
    """

    precision: Array
    shift: Array


class _Rays(NamedTuple):
    """The points of all views as seen from the centres of their discs."""

    distance: Array  # (V, K)
    direction: Complexes  # (V, K), of length 1; the imaginary part is along y
    waves: Array  # (V, K, P - 3) cosine and sine of each order of the edge's shape
    slopes: Array  # (V, K, P - 3) derivatives of the waves by the direction


def _rays(points: Complexes, about: Array) -> _Rays:
    """Return the rays to (V, K) points from the centres in (V, P) unknowns."""
    offset = points - (about[:, :2] @ _PLANE)[:, None]
    distance = np.maximum(np.abs(offset), 1e-9)
    direction = offset / distance
    waves = direction[:, :, None] ** _ORDERS
    return _Rays(distance, direction, waves.view(np.float64), (1j * _ORDERS * waves).view(np.float64))


def _linearised(rays: _Rays, about: Array) -> tuple[Array, Array]:
    """Return the (V, K, P) derivatives of the distances, and the (V, K) linearised ones, about (V, P) unknowns.

    With the direction u of a point from the centre, the direction t across it, and n = u - shape'(phi) t / distance,
    distance + n . centre = n . c + R + shape(phi).
    """
    slope = (rays.slopes @ about[:, 3:, None])[..., 0]
    design = np.ones((*slope.shape, UNKNOWNS))
    design[..., :2] = _along_axes(rays.direction * (1.0 - 1j * slope / rays.distance))
    design[..., 3:] = rays.waves
    return design, rays.distance + (design[..., :2] @ about[:, :2, None])[..., 0]


def _along_axes(numbers: Complexes) -> Array:
    """Return complex numbers as (..., 2) real ones."""
    return numbers[..., None].view(np.float64)


def evidence_of(design: Array, distance: Array, sites: _Sites) -> Evidence:
    """Return what points with (V, K, P) derivatives and (V, K) linearised distances, mm, say about the unknowns.

    One step of Gauss-Newton (Björck, 1996, section 9.2), not solved yet.
    """
    across = design.swapaxes(1, 2)
    product = across @ (sites.shift + sites.precision * distance)[:, :, None]
    return Evidence(across * sites.precision[:, None] @ design, product[..., 0])


def _form(left: Array, matrices: Array, right: Array) -> Array:
    """Return (V, K) bilinear forms of (V, K, P) vectors, with a (P, P) matrix for each view."""
    return np.einsum("vki,vki->vk", left @ matrices, right)


def second_order_sigmas(rays: _Rays, means: Array, covariances: Array) -> Array:
    """Return the (V, K) sigmas, mm, of the terms that the linearised distances leave out.

    Variance of a product of two Gaussian variables, as in the second-order filter (Bar-Shalom, Li and Kirubarajan,
    2001, section 10.3.2): to second order, a distance changes by s (w + k s / 2). Here s is the turn of the point's
    direction as seen from the centre, w the change of the edge's slope, and k the curvature of the edge. The unknowns
    have (V, P) means, mm, and (V, P, P) covariances.
    """
    slope, bend = (rays.slopes @ means[:, 3:, None])[..., 0], _ORDERS.repeat(2) ** 2 * means[:, 3:]
    turn = _along_axes(-1j * rays.direction / rays.distance)
    change = np.zeros((*slope.shape, UNKNOWNS))
    change[..., :2] = _along_axes(slope / rays.distance * rays.direction)
    change[..., 3:] = rays.slopes
    curvature = -(rays.waves @ bend[:, :, None])[..., 0] - rays.distance
    by_turn, by_change = _form(turn, covariances[:, :2, :2], turn), _form(change, covariances, change)
    both = _form(turn, covariances[:, :2], change)
    half = curvature * by_turn
    return np.sqrt(np.maximum(by_turn * by_change + both**2 + 0.5 * half**2 + 2.0 * half * both, 0.0))


def reweighted(rays: _Rays, means: Array, sigmas: Array, used: float) -> Array:
    """Return the (V, K) sigmas of the points, mm, enlarged to what residuals at (V, P) means show, and for outliers.

    The added noise is the robust spread of the residuals (median absolute deviation over 0.6745) beyond the points' own
    sigmas. It is enlarged for the number of unknowns. Weights of outliers are Huber's (1981).
    """
    real = np.isfinite(sigmas)
    if not real.any():
        return sigmas
    off = rays.distance - means[:, 2:3] - (rays.waves @ means[:, 3:, None])[..., 0]
    spare = max(1.0 - used / float(real.sum()), 0.2)
    spread = (median(np.abs(off[real])) / 0.6745) ** 2 / spare
    added = max(spread - median(sigmas[real]) ** 2, 0.0)
    whole = np.sqrt(sigmas**2 + added)
    return whole * np.sqrt(np.maximum(np.abs(off) / (_HUBER * whole), 1.0))


def bright_sites(sites: _Sites, gap: Array, variance: Array) -> _Sites:
    """Return better Gaussian sites for the bright points, each a factor Phi((rim - point) / sigma).

    Expectation propagation (Minka, 2001) with all sites at once; moments of the probit factor: Rasmussen
    and Williams (2006), section 3.6. The (V, L) gaps to the rim, mm, and their variances are with these sites.
    """
    # Without its own site a point may have nothing that holds it: its variance stays finite.
    alone = 1.0 / np.maximum(1.0 / variance - sites.precision, 1e-3 / variance)
    gap_alone = alone * (gap / variance - sites.shift)
    whole = alone + _LIT_SIGMA_MM**2
    z = gap_alone / np.sqrt(whole)
    from scipy.special import log_ndtr

    ratio = np.exp(-0.5 * z * z - log_ndtr(z)) / np.sqrt(2.0 * np.pi)
    matched = alone - alone**2 * ratio * (z + ratio) / whole
    matched_gap = gap_alone + alone * ratio / np.sqrt(whole)
    return _Sites(np.maximum(1.0 / matched - 1.0 / alone, 0.0), matched_gap / matched - gap_alone / alone)


@dataclass(frozen=True)
class Disc:
    """The disc of one view, on the target's plane."""

    centre_mm: Array  # (2,) float64, mm
    radius_mm: float  # Mean radius, mm
    covariance_mm2: Array  # (2, 2) float64, covariance of the centre, mm^2
    # 1-sigma of the centre along the worse axis, mm, by the points of this view alone, if the edge were a
    # circle of about the radius of the other views. It tells how much of the rim is in view.
    own_sigma_mm: float

    @property
    def rim_visible(self) -> bool:
        """Whether the view itself shows enough of the rim to locate a circle."""
        return self.own_sigma_mm <= _VISIBLE_RIM_SIGMA * self.radius_mm


@dataclass(frozen=True)
class DiscMotion:
    """How the discs of a bench move with the point at which the camera looks."""

    # (2, 2) float64, motion of the disc along x and y (rows), mm, per mm of the look along x and y (columns).
    matrix: Array
    # (4, 4) float64, covariance of the entries of the matrix, row by row. Errors that the discs have in
    # common, such as those of the radius, are included.
    covariance: Array


class _Posterior(NamedTuple):
    """Means and covariances of all unknowns, and the log marginal likelihood, for G sets of scatters.

    Covariances are those of the first R unknowns of each view.
    """

    mean: Array  # (G, V, P) of the unknowns of the views
    alone: Array  # (G, V, R, R) their covariance if the common values were known
    spread: Array  # (G, V, R, Q) how they follow the common values
    shared: Array  # (G, Q) common values
    shared_covariance: Array  # (G, Q, Q)
    log_likelihood: Array  # (G,), logarithm of the marginal likelihood, without a constant

    @property
    def covariance(self) -> Array:
        """(G, V, R, R) covariance of the first unknowns of each view."""
        return self.alone + self.spread @ self.shared_covariance[:, None] @ self.spread.swapaxes(2, 3)

    @property
    def joint_covariance(self) -> Array:
        """(G, V R, V R) covariance of the first unknowns of all views."""
        count, views, own, _ = self.alone.shape
        flat = self.spread.reshape(count, views * own, -1)
        joint = (flat @ self.shared_covariance @ flat.swapaxes(1, 2)).reshape(count, views, own, views, own)
        each = np.arange(views)
        joint[:, each, :, each] += self.alone.swapaxes(0, 1)
        return joint.reshape(count, views * own, views * own)


class _Common(NamedTuple):
    """What the views have in common: (V, P, Q) designs from Q common values to unknowns; (Q,) prior means, sigmas."""

    designs: Array
    mean: Array
    sigmas: Array


@dataclass(frozen=True)
class Discs:
    """The discs of all views, in their order, and what they have in common.

    A line through the discs would take their errors as independent. They are not: if the radius is too large, the discs
    of all views that show the right rim lie too far left, and those of all views that show the left rim too far right.
    """

    of_views: list[Disc]
    covariance_mm2: Array  # (2 V, 2 V) float64, covariance of the centres of all views, mm^2
    motion: DiscMotion  # With the look of the camera; its prior is zero with a 1-sigma of 0.3 for each entry
    # 2 log of the likelihood ratio: the centres scatter about that motion more than on a gimbal, or not.
    wander: float = 0.0


def fit_rims(rims: Sequence[RimPoints], looks_mm: Array, stars_mm: Array) -> Discs:
    """Fit the discs of all views together; the head of the module gives model and sources.

    The points enter with weights of Huber (1981). ``looks_mm`` are the (V, 2) points of the target at which the camera
    looks. The (N, 2) stars of all views, mm, give a place well inside the beam and a first guess of the radius.
    """
    middle_mm = stars_mm.mean(axis=0)
    reach_mm = float(np.linalg.norm(stars_mm - middle_mm, axis=1).max())
    common = _common(looks_mm - middle_mm, reach_mm)
    points = [rim.points_mm - middle_mm for rim in rims]
    bright = [rim.lit_mm[:: 1 + len(rim.lit_mm) // _MOST_BRIGHT] - middle_mm for rim in rims]
    seen = np.hstack([_padded(points, 0.0), _padded(bright, 0.0)]) @ _PLANE
    sigmas = _padded([np.hypot(rim.sigmas_mm, _POINT_FLOOR_MM) for rim in rims], np.inf)
    lit = _padded([np.ones(len(own)) for own in bright], 0.0)
    shares = [_FIRST_SCATTERS, *product(_CENTRE_SCATTERS, _RADIUS_SCATTERS, _SHAPE_SCATTERS)]
    scatters = reach_mm * np.repeat(shares, _ALIKE, axis=1)
    sites, means = _start(seen, sigmas, lit, scatters[:1], common)
    grid = scatters[1:]
    for round_ in range(_FINAL_ROUNDS):
        design, distance = _linearised(_rays(seen, means), means)
        tried, every = grid, _posteriors(evidence_of(design, distance, sites), grid, common, 2)
        weights = _weights(every.log_likelihood, grid)
        kept = weights > _LEAST_AVERAGED
        posterior, share = _Posterior(*(part[kept] for part in every)), weights[kept] / weights[kept].sum()
        step = np.tensordot(share, posterior.mean, axes=1) - means
        if np.abs(step[:, :2]).max() < _FINAL_SETTLED_MM:
            break
        means = means + _STEP * step
        if round_ > 0:
            grid, weights = grid[weights > _LEAST_WEIGHT], weights[weights > _LEAST_WEIGHT]
    sites.precision[:, sigmas.shape[1] :] = 0.0  # Bright points do not show the rim
    own = _own_sigmas(evidence_of(design, distance, sites).information, grid[:, 2], weights, reach_mm)
    discs = _discs(rims, posterior, share, own, middle_mm)
    return replace(discs, wander=_wander(every.log_likelihood, tried / reach_mm))


def _discs(
    rims: Sequence[RimPoints], posterior: _Posterior, share: Array, own: Array, middle_mm: Array
) -> Discs:
    """Return the discs from posteriors with (G,) shares, and from the (V,) sigmas of centres by each view alone."""
    shared, shared_covariance = _mixed(share, posterior.shared, posterior.shared_covariance)
    motion = DiscMotion(shared[2:6].reshape(2, 2), shared_covariance[2:6, 2:6])
    means = posterior.mean[..., :2].reshape(len(share), -1)
    centres, covariance = _mixed(share, means, posterior.joint_covariance)
    covariance += np.diag(np.repeat([rim.level_sigma_mm**2 for rim in rims], 2))
    blocks = [covariance[i : i + 2, i : i + 2] for i in range(0, len(covariance), 2)]
    radii = np.abs(share @ posterior.mean[..., 2]).tolist()
    columns = (centres.reshape(-1, 2) + middle_mm, radii, blocks, own.tolist())
    return Discs([Disc(*disc) for disc in zip(*columns, strict=True)], covariance, motion)


def _padded(parts: Sequence[Array], fill: float) -> Array:
    """Return (K, ...) arrays, one for each view, as one (V, K, ...) array, filled behind the end of short ones."""
    whole = np.full((len(parts), max(map(len, parts)), *parts[0].shape[1:]), fill)
    for own, part in zip(whole, parts, strict=True):
        own[: len(part)] = part
    return whole


def _start(
    seen: Complexes, sigmas: Array, lit: Array, scatters: Array, common: _Common
) -> tuple[_Sites, Array]:
    """Fit with large (1, P) scatters between views: return what each point adds, and the (V, P) unknowns.

    What the linearised distances leave out counts as noise, because the first unknowns may be far off. ``seen`` holds
    the K points of the rim of each view, then its L bright points. ``sigmas`` (V, K) are infinite, and ``lit`` (V, L)
    is 0 instead of 1, where a view has fewer points.
    """
    edge, bright = slice(sigmas.shape[1]), slice(sigmas.shape[1], None)
    means = common.designs @ common.mean
    sites = _Sites(np.zeros(seen.shape), np.zeros(seen.shape))
    weights, neglected, rays = sigmas, np.zeros_like(sigmas), _rays(seen, means)
    for round_ in range(_ROUNDS):
        design, distance = _linearised(rays, means)
        sites.precision[:, edge] = 1.0 / (weights**2 + neglected**2)
        posterior = _posteriors(evidence_of(design, distance, sites), scatters, common, UNKNOWNS)
        mean, covariance = posterior.mean[0], posterior.covariance[0]
        variance = _form(design, covariance, design)
        if round_ > 0:
            used = float(np.sum(sites.precision[:, edge] * variance[:, edge]))
            weights = reweighted(_rays(seen[:, edge], mean), mean, sigmas, used)
        gap = (design @ mean[:, :, None])[..., 0] - distance
        old = _Sites(*(part[:, bright] for part in sites))
        for part, new in zip(old, bright_sites(old, gap[:, bright], variance[:, bright]), strict=True):
            part[:] = (1.0 - _DAMPING) * part + _DAMPING * lit * new
        step = mean - means
        means = means + (_STEP if round_ > 0 else 1.0) * step
        rays = _rays(seen, means)
        neglected = second_order_sigmas(rays, means, covariance)[:, edge]
        if np.abs(step[:, :2]).max() < _SETTLED_MM and round_ > 1:
            break
    sites.precision[:, edge] = weights**-2.0
    return sites, means


def _common(looks_mm: Array, reach_mm: float) -> _Common:
    """Return how unknowns follow from the common values: centre, motion of the centre, radius, shape."""
    views, shapes = len(looks_mm), UNKNOWNS - 3
    designs = np.zeros((views, UNKNOWNS, 7 + shapes))
    designs[:, 0, 0] = designs[:, 1, 1] = 1.0
    designs[:, 0, 2:4] = designs[:, 1, 4:6] = looks_mm
    designs[:, 2:, 6:] = np.eye(1 + shapes)
    priors = [_CENTRE_PRIOR * reach_mm, _WALK_PRIOR, _RADIUS_PRIOR * reach_mm, _SHAPE_PRIOR * reach_mm]
    mean = np.zeros(7 + shapes)
    mean[6] = reach_mm
    return _Common(designs, mean, np.repeat(priors, (2, 4, 1, shapes)))


def _posteriors(evidence: Evidence, scatters: Array, common: _Common, own: int) -> _Posterior:
    """Return the posteriors for (G, P) scatters, and the covariances of the first ``own`` unknowns of each view.

    Linear Gaussian model of Lindley and Smith (1972): with information J, product z, scatter S and A = J + S^-1, the
    information about the mean of a view's unknowns is S^-1 - S^-1 A^-1 S^-1. It is calculated as S^-1 A^-1 J, which is
    the same without a difference of large numbers, and with a root of A^-1: products with A^-1 itself err much more.
    """
    loose, designs = scatters[:, None] ** -2.0, common.designs
    root, log_det = _roots(evidence.information + loose[..., None] * np.eye(UNKNOWNS))
    right = root @ np.concatenate([evidence.information @ designs, evidence.product[:, :, None]], axis=2)
    left = (root * loose[:, :, None]) @ designs
    flat = left.reshape(len(scatters), -1, designs.shape[2])
    sums = flat.swapaxes(1, 2) @ right.reshape(*flat.shape[:2], -1)
    shared_root, shared_log_det = _roots(sums[:, :, :-1] + np.diag(common.sigmas**-2.0))
    covariance = shared_root.swapaxes(1, 2) @ shared_root
    g = sums[:, :, -1] + common.mean * common.sigmas**-2.0
    shared, back = (covariance @ g[:, :, None])[..., 0], root.swapaxes(2, 3)
    mean = (back @ (right[..., -1:] + (flat @ shared[:, :, None]).reshape(*root.shape[:3], 1)))[..., 0]
    log_dets = len(designs) * np.log(loose).sum(axis=(1, 2)) - log_det.sum(axis=1) - shared_log_det
    fit = np.sum(right[..., -1] ** 2, axis=(1, 2))
    likelihood = 0.5 * (log_dets + fit + np.sum(g * shared, axis=1))
    alone = back[:, :, :own] @ root[..., :own]
    return _Posterior(mean, alone, back[:, :, :own] @ left, shared, covariance, likelihood)


def _roots(matrices: Array) -> tuple[Array, Array]:
    """Return R with R^T R = A^-1 for (..., P, P) positive definite matrices A, and the (...) logarithms of det A."""
    lower = np.linalg.cholesky(matrices)
    return np.linalg.inv(lower), 2.0 * np.log(np.diagonal(lower, axis1=-2, axis2=-1)).sum(axis=-1)


def _weights(log_likelihood: Array, scatters: Array) -> Array:
    """Return the (G,) weights of scatters, (G, P), from the logarithms of their likelihoods.

    The likelihood enters by a power below 1 (SafeBayes; Grünwald and van Ommen, 2017): views are not independent.
    """
    preference = _SCATTER_POWER * np.log(scatters[:, [0, 2, 3]]).sum(axis=1)
    logs = _LIKELIHOOD_POWER * log_likelihood + preference
    weights = np.exp(logs - logs.max())
    return weights / weights.sum()


def _wander(log_likelihood: Array, shares: Array) -> float:
    """Return 2 log of the likelihood ratio: no gimbal holds the pupil, or one does.

    Scatters of the centre of one kind are equally probable. Those of radius and shape are averaged. shares: (G, P)
    scatters over the disc's radius.
    """
    logs = log_likelihood + _SCATTER_POWER * np.log(shares[:, [2, 3]]).sum(axis=1)
    small = shares[:, 0] < _HELD
    gimbal, hand = (np.logaddexp.reduce(logs[own], initial=-np.inf) for own in (small, ~small))
    count = sum(scatter < _HELD for scatter in _CENTRE_SCATTERS)
    return float(2.0 * (hand - gimbal - np.log((len(_CENTRE_SCATTERS) - count) / count)))


def _mixed(weights: Array, means: Array, covariances: Array) -> tuple[Array, Array]:
    """Return (..., P) means and (..., P, P) covariances of a mixture, from those of its parts, by their first axis.

    Law of total covariance: the mean of the covariances, plus the covariance of the means.
    """
    mean = np.tensordot(weights, means, axes=1)
    off = means - mean
    within = np.tensordot(weights, covariances, axes=1)
    return mean, within + np.einsum("w,w...i,w...j->...ij", weights, off, off)


def _own_sigmas(information: Array, radius_scatters: Array, weights: Array, reach_mm: float) -> Array:
    """Return the (V,) sigmas, mm, of centres by each view alone, from (G,) radius scatters and their weights.

    Own: the larger variance of the centre in (J + L)^-1, with the information J of the view and the loose priors L of a
    circle; its mean over the scatters.
    """
    loose = np.full(UNKNOWNS, (_SHAPE_SCATTERS[0] * reach_mm) ** -2.0)
    loose[:2] = (2.0 * reach_mm) ** -2.0
    variance = np.zeros(len(information))
    for scatter in np.unique(radius_scatters):
        loose[2] = scatter**-2.0
        covariance = np.linalg.inv(information + np.diag(loose))
        largest = np.linalg.eigvalsh(covariance[:, :2, :2])[:, -1]
        variance += weights[radius_scatters == scatter].sum() * largest
    return np.sqrt(variance / weights.sum())
