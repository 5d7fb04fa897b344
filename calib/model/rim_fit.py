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
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np

from calib.arrays import Array
from calib.view import RimPoints

#: Highest Fourier order of the edge's shape; order 1 is the centre.
_ORDERS = 5
UNKNOWNS = 3 + 2 * (_ORDERS - 1)
"""Number of unknowns of a view: centre x and y, mean radius, cosine and sine of each order of the shape, all in mm."""
#: 1-sigma of the border between bright and dark at a bright point of the frame's border, mm.
_LIT_SIGMA_MM = 0.5
#: Share of its new value that a site takes.
_DAMPING = 0.5
_HUBER = 2.5


class Evidence(NamedTuple):
    """What the rim points of all views say about their unknowns, linearised."""

    information: Array  # (V, P, P) Fisher information of the unknowns of each view
    product: Array  # (V, P) normal equations' right sides: information times the best unknowns


class Sites(NamedTuple):
    """Gaussian sites of the bright points of a view, (L,) precisions and (L,) precisions times means, of the gap."""

    precision: Array
    shift: Array


def _linearised(points: Array, about: Array) -> tuple[Array, Array]:
    """Return the (K, P) derivatives of the points' distances, and the (K,) linearised distances, about (P,) unknowns.

    With the direction u of a point from the centre, the direction t across it, and n = u - shape'(phi) t / distance,
    distance + n . centre = n . c + R + shape(phi).
    """
    rho, u, waves, slopes, _ = _waves(points, about)
    n = u - (slopes @ about[3:] / rho)[:, None] * np.column_stack([-u[:, 1], u[:, 0]])
    return np.column_stack([n, np.ones(len(points)), waves]), rho + n @ about[:2]


def _waves(points: Array, about: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Return the (K,) distances and (K, 2) directions of points from a centre, and the waves of the edge's shape there.

    The last three are the (K, P - 3) waves, and their first derivatives by the direction and minus the second ones.
    """
    away = points - about[:2]
    rho = np.maximum(np.hypot(*away.T), 1e-9)
    u = away / rho[:, None]
    orders = np.arange(2, _ORDERS + 1)
    phi = np.arctan2(u[:, 1], u[:, 0])[:, None] * orders
    cosine, sine = np.cos(phi), np.sin(phi)
    pairs = (cosine, sine), (-orders * sine, orders * cosine), (orders**2 * cosine, orders**2 * sine)
    waves, slopes, bends = (np.stack(pair, axis=-1).reshape(len(points), UNKNOWNS - 3) for pair in pairs)
    return rho, u, waves, slopes, bends


def evidence_of(points: Sequence[Array], sigmas: Sequence[Array], means: Array) -> Evidence:
    """Return what (K, 2) points and (K,) sigmas, mm, of each view say about its unknowns, linearised at (V, P) means.

    One step of Gauss-Newton (Björck, 1996, section 9.2), not solved yet.
    """
    information = np.zeros((len(points), UNKNOWNS, UNKNOWNS))
    product = np.zeros((len(points), UNKNOWNS))
    for i, (own, sigma, about) in enumerate(zip(points, sigmas, means, strict=True)):
        design, distance = _linearised(own, about)
        weighted = design / sigma[:, None] ** 2
        information[i], product[i] = weighted.T @ design, weighted.T @ distance
    return Evidence(information, product)


def second_order_sigmas(points: Sequence[Array], means: Array, covariances: Array) -> list[Array]:
    """Return the (K,) sigmas, mm, for each view, of the terms that the linearised distances leave out.

    Variance of a product of two Gaussian variables, as in the second-order filter (Bar-Shalom, Li and Kirubarajan,
    2001, section 10.3.2): to second order, a distance changes by s (w + k s / 2). Here s is the turn of the point's
    direction as seen from the centre, w the change of the edge's slope, and k the curvature of the edge. The unknowns
    have (V, P) means, mm, and (V, P, P) covariances.
    """
    found = []
    for own, mean, covariance in zip(points, means, covariances, strict=True):
        rho, u, _, slopes, bends = _waves(own, mean)
        turn, change = np.zeros((2, len(own), UNKNOWNS))
        turn[:, :2] = np.column_stack([u[:, 1], -u[:, 0]]) / rho[:, None]
        change[:, :2] = (slopes @ mean[3:] / rho)[:, None] * u
        change[:, 3:] = slopes
        curvature = -bends @ mean[3:] - rho
        by_turn, by_change, both = (
            np.einsum("ki,ij,kj->k", a, covariance, b)
            for a, b in ((turn, turn), (change, change), (turn, change))
        )
        variance = (
            by_turn * by_change
            + both**2
            + 0.5 * (curvature * by_turn) ** 2
            + 2.0 * curvature * by_turn * both
        )
        found.append(np.sqrt(np.maximum(variance, 0.0)))
    return found


def reweighted(
    points: Sequence[Array], sigmas: Sequence[Array], evidence: Evidence, means: Array, covariances: Array
) -> list[Array]:
    """Return the (K,) sigmas of each view's points, mm, enlarged to what the residuals show, and for outliers.

    The added noise is the robust spread of the residuals (median absolute deviation over 0.6745) that the points' own
    sigmas do not explain, enlarged for the fitted unknowns. Weights of outliers are Huber's (1981). ``evidence`` is
    what the points said with their last sigmas; the unknowns found have (V, P) means, mm, and (V, P, P) covariances.
    """
    off = []
    for own, mean in zip(points, means, strict=True):
        design, distance = _linearised(own, mean)
        off.append(distance - design @ mean)
    every = np.concatenate(off)
    if not len(every):
        return list(sigmas)
    used = float(np.einsum("vij,vji->", evidence.information, covariances))
    spare = max(1.0 - used / len(every), 0.2)
    spread = (float(np.median(np.abs(every))) / 0.6745) ** 2 / spare
    added = max(spread - float(np.median(np.concatenate(sigmas))) ** 2, 0.0)
    out = []
    for own, sigma in zip(off, sigmas, strict=True):
        whole = np.sqrt(sigma**2 + added)
        out.append(whole * np.sqrt(np.maximum(np.abs(own) / (_HUBER * whole), 1.0)))
    return out


def with_sites(evidence: Evidence, bright: Sequence[Array], sites: Sequence[Sites], means: Array) -> Evidence:
    """Add what each view's (L, 2) bright points, mm, at the frame's border say: product of Gaussians (Minka, 2001)."""
    information, product = evidence.information.copy(), evidence.product.copy()
    for i, (own, site, about) in enumerate(zip(bright, sites, means, strict=True)):
        design, distance = _linearised(own, about)
        information[i] += (design.T * site.precision) @ design
        product[i] += design.T @ (site.shift + site.precision * distance)
    return Evidence(information, product)


def bright_sites(bright: Array, sites: Sites, mean: Array, covariance: Array, about: Array) -> Sites:
    """Return better Gaussian sites for (L, 2) bright points, mm, each a factor Phi((rim - point) / sigma), damped.

    Expectation propagation (Minka, 2001) with all sites at once and damping; moments of the probit factor: Rasmussen
    and Williams (2006), section 3.6. The (P,) mean is with these sites; distances are linearised at ``about``.
    """
    design, distance = _linearised(bright, about)
    gap = design @ mean - distance
    variance = np.einsum("ki,ij,kj->k", design, covariance, design)
    alone = 1.0 / np.maximum(1.0 / variance - sites.precision, 1e-3 / variance)
    gap_alone = alone * (gap / variance - sites.shift)
    whole = alone + _LIT_SIGMA_MM**2
    z = gap_alone / np.sqrt(whole)
    from scipy.special import log_ndtr

    ratio = np.exp(-0.5 * z * z - log_ndtr(z)) / np.sqrt(2.0 * np.pi)
    matched = alone - alone**2 * ratio * (z + ratio) / whole
    matched_gap = gap_alone + alone * ratio / np.sqrt(whole)
    precision = np.maximum(1.0 / matched - 1.0 / alone, 0.0)
    shift = matched_gap / matched - gap_alone / alone
    return Sites(
        sites.precision + _DAMPING * (precision - sites.precision),
        sites.shift + _DAMPING * (shift - sites.shift),
    )


#: Grid of the 1-sigma scatters between views, as shares of the radius: centre, radius, coefficients of the shape. Each
#: grid is even in the logarithm, from differences that do not matter to those of the published recordings.
_CENTRE_SCATTERS = (0.003, 0.01, 0.03, 0.09, 0.2)
_RADIUS_SCATTERS = (0.001, 0.004, 0.018, 0.08)
_SHAPE_SCATTERS = (0.0004, 0.0015, 0.005, 0.015, 0.04)
#: Prior weight of a scatter: its power of this exponent. A few arcs cannot exclude large scatters, and sigmas would be
#: too small on benches whose rims differ from view to view; where the rims are alike, the data decide.
_SCATTER_POWER = 1.0
#: So many matrices, one for each view and scatter, are handled at once.
_MOST_MATRICES = 4000
#: Power of the likelihood of the scatters. Views that look in neighbouring directions look through the same glass, so
#: the nine views of a bench are about five independent ones.
_LIKELIHOOD_POWER = 0.5
#: Scatters of a smaller weight no longer take part after two rounds.
_LEAST_WEIGHT = 1e-6
#: Prior 1-sigma of what the views have in common: centre and radius as shares of the first guess, motion of the disc
#: in mm per mm of the camera's look, and coefficients of the shape as shares of the radius.
_CENTRE_PRIOR, _RADIUS_PRIOR, _WALK_PRIOR, _SHAPE_PRIOR = 0.6, 0.4, 0.3, 0.03
#: The rim counts as visible if the 1-sigma of the disc's centre is at most this share of its radius.
_VISIBLE_RIM_SIGMA = 0.15
#: Smallest 1-sigma of a point, mm: neighbouring points share errors of the map.
_POINT_FLOOR_MM = 0.03
#: Largest number of bright points of a view that take part.
_MOST_BRIGHT = 30
_ROUNDS, _SETTLED_MM = 20, 1e-3
#: The same for the fits that average over the scatters.
_FINAL_ROUNDS, _FINAL_SETTLED_MM = 10, 0.02
#: Share of a step that is taken. Whole steps run away where a short arc does not tell its shape from its centre.
_STEP = 0.5
#: Scatters, as shares of the radius, with which the fit starts: centre, radius, shape.
_FIRST_SCATTERS = (0.12, 0.05, 0.03)


@dataclass(frozen=True)
class Disc:
    """The disc of one view, on the target's plane."""

    centre_mm: Array  # (2,) float64, mm
    radius_mm: float  # Mean radius, mm
    covariance_mm2: Array  # (2, 2) float64, covariance of the centre, mm^2
    # 1-sigma of the centre along the worse axis, mm, by the points of this view alone, if the edge were a
    # circle of about the radius of the other views. It tells how much of the rim is in view.
    own_sigma_mm: float
    expected_mm: Array  # (2,) float64, mm, centre by the motion that all discs have in common

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
    """Means and covariances of all unknowns, and the log marginal likelihood; each with an axis more for many."""

    # mean, covariance: (V, P) and (V, P, P), of the unknowns of the views.
    mean: Array
    covariance: Array
    # shared, shared_covariance: (Q,) and (Q, Q), of the common values.
    shared: Array
    shared_covariance: Array
    centres: Array  # (2 V, 2 V) covariance of the centres of all views
    log_likelihood: Array  # (), logarithm of the marginal likelihood, without a constant


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
    sigmas = [np.hypot(rim.sigmas_mm, _POINT_FLOOR_MM) for rim in rims]
    weights, sites, means = _start(points, bright, sigmas, reach_mm, common)
    grid = np.array(
        [
            _scatters(reach_mm, *shares)
            for shares in product(_CENTRE_SCATTERS, _RADIUS_SCATTERS, _SHAPE_SCATTERS)
        ]
    )
    for round_ in range(_FINAL_ROUNDS):
        evidence = evidence_of(points, weights, means)
        whole = with_sites(evidence, bright, sites, means)
        found, shares = _averaged(whole, common, grid)
        step = found.mean - means
        means = means + _STEP * step
        if np.abs(step[:, :2]).max() < _FINAL_SETTLED_MM:
            break
        if round_ > 0:
            grid, shares = grid[shares > _LEAST_WEIGHT], shares[shares > _LEAST_WEIGHT]
    own = _own_sigmas(evidence, grid[:, 2], shares, reach_mm)
    discs, every = [], found.centres.copy()
    expected = common.designs[:, :2] @ found.shared + middle_mm
    for i, rim in enumerate(rims):
        own_places = slice(2 * i, 2 * i + 2)
        every[own_places, own_places] += rim.level_sigma_mm**2 * np.eye(2)
        covariance = every[own_places, own_places]
        centre, radius = found.mean[i, :2] + middle_mm, abs(float(found.mean[i, 2]))
        discs.append(Disc(centre, radius, covariance, float(own[i]), expected[i]))
    motion = slice(2, 6)
    moved = DiscMotion(found.shared[motion].reshape(2, 2), found.shared_covariance[motion, motion])
    return Discs(discs, every, moved)


def _start(
    points: Sequence[Array],
    bright: Sequence[Array],
    sigmas: Sequence[Array],
    reach_mm: float,
    common: _Common,
) -> tuple[list[Array], list[Sites], Array]:
    """Fit with large scatters between views: return sigmas of the points, sites of the bright points, and unknowns.

    What the linearised distances leave out counts as noise, because the first unknowns may be far off.
    """
    sites = [Sites(np.zeros(len(own)), np.zeros(len(own))) for own in bright]
    means = np.zeros((len(points), UNKNOWNS))
    means[:, 2] = reach_mm
    weights, scatters = list(sigmas), _scatters(reach_mm, *_FIRST_SCATTERS)
    neglected = [np.zeros(len(own)) for own in points]
    for round_ in range(_ROUNDS):
        evidence = evidence_of(points, [*map(np.hypot, weights, neglected)], means)
        found = _posterior(with_sites(evidence, bright, sites, means), scatters, common)
        views = zip(bright, sites, found.mean, found.covariance, means, strict=True)
        sites = [bright_sites(*one) for one in views]
        step = found.mean - means
        means = means + (_STEP if round_ > 0 else 1.0) * step
        if round_ > 0:
            weights = reweighted(points, sigmas, evidence, found.mean, found.covariance)
        neglected = second_order_sigmas(points, means, found.covariance)
        if np.abs(step[:, :2]).max() < _SETTLED_MM and round_ > 1:
            break
    return weights, sites, means


def _common(looks_mm: Array, reach_mm: float) -> _Common:
    """Return how unknowns follow from the common values: centre, motion of the centre, radius, shape."""
    views, shapes = len(looks_mm), UNKNOWNS - 3
    designs = np.zeros((views, UNKNOWNS, 7 + shapes))
    designs[:, 0, 0] = designs[:, 1, 1] = 1.0
    designs[:, 0, 2:4] = designs[:, 1, 4:6] = looks_mm
    designs[:, 2:, 6:] = np.eye(1 + shapes)
    sigmas = np.concatenate(
        [
            np.full(2, _CENTRE_PRIOR * reach_mm),
            np.full(4, _WALK_PRIOR),
            [_RADIUS_PRIOR * reach_mm],
            np.full(shapes, _SHAPE_PRIOR * reach_mm),
        ]
    )
    mean = np.zeros(7 + shapes)
    mean[6] = reach_mm
    return _Common(designs, mean, sigmas)


def _scatters(reach_mm: float, centre: float, radius: float, shape: float) -> Array:
    """Return the (P,) 1-sigma scatters of the unknowns between views, mm, from shares of the radius."""
    return reach_mm * np.array([centre, centre, radius, *[shape] * (UNKNOWNS - 3)])


def _posteriors(evidence: Evidence, scatters: Array, common: _Common) -> _Posterior:
    """Return the posteriors of all unknowns for (G, P) scatters, averaged over the common values.

    Every array has an axis for the scatters first. Linear Gaussian model of Lindley and Smith (1972): with information
    J, product z, scatter S and A = J + S^-1, the information about the mean of a view's unknowns is
    S^-1 - S^-1 A^-1 S^-1. It is calculated as J A^-1 S^-1, which is the same without a difference of large numbers.
    """
    loose, designs = scatters**-2.0, common.designs
    views, unknowns, shared_count = designs.shape
    flat = designs.reshape(views * unknowns, shared_count)
    diagonal = loose[:, None, :, None] * np.eye(unknowns)
    inverse = np.linalg.inv(evidence.information + diagonal)
    gain = inverse * loose[:, None, None, :]
    spread = gain @ designs
    about_designs = evidence.information @ spread
    own = (inverse @ evidence.product[:, :, None])[..., 0]
    toward = (loose[:, None, :] * own).reshape(len(scatters), -1)
    h = flat.T @ about_designs.reshape(len(scatters), *flat.shape) + np.diag(common.sigmas**-2.0)
    g = toward @ flat + common.mean * common.sigmas**-2.0
    covariance = np.asarray(np.linalg.inv(h), np.float64)
    shared = (covariance @ g[:, :, None])[..., 0]
    mean = own + (spread @ shared[:, None, :, None])[..., 0]
    whole = inverse + spread @ covariance[:, None] @ spread.swapaxes(2, 3)
    ahead = spread[:, :, :2].reshape(len(scatters), 2 * views, -1)
    centres = ahead @ covariance @ ahead.swapaxes(1, 2)
    for view in range(views):
        centres[:, 2 * view : 2 * view + 2, 2 * view : 2 * view + 2] += inverse[:, view, :2, :2]
    log_det = np.linalg.slogdet(inverse)[1].sum(axis=1) - 2.0 * views * np.log(scatters).sum(axis=1)
    fit = np.einsum("vi,gvi->g", evidence.product, own)
    likelihood = 0.5 * (log_det + fit + np.sum(g * shared, axis=1) - np.linalg.slogdet(h)[1])
    return _Posterior(mean, whole, shared, covariance, centres, likelihood)


def _posterior(evidence: Evidence, scatters: Array, common: _Common) -> _Posterior:
    """Return the posterior for one set of (P,) scatters."""
    found = _posteriors(evidence, scatters[None], common)
    return _Posterior(*(part[0] for part in found))


def _in_pieces(evidence: Evidence, scatters: Array, common: _Common) -> _Posterior:
    """Return `_posteriors`, calculated in pieces that bound the memory for many views."""
    size = max(1, _MOST_MATRICES // len(evidence.product))
    pieces = [_posteriors(evidence, scatters[at : at + size], common) for at in range(0, len(scatters), size)]
    return _Posterior(*(np.concatenate(parts) for parts in zip(*pieces, strict=True)))


def _averaged(evidence: Evidence, common: _Common, scatters: Array) -> tuple[_Posterior, Array]:
    """Return the posterior averaged over (G, P) scatters, and the (G,) weight of each.

    The likelihood enters by a power below 1 (SafeBayes; Grünwald and van Ommen, 2017): views are not independent.
    """
    every = _in_pieces(evidence, scatters, common)
    preference = _SCATTER_POWER * np.log(scatters[:, [0, 2, 3]]).sum(axis=1)
    logs = _LIKELIHOOD_POWER * every.log_likelihood + preference
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    kept = weights > 1e-4
    share = weights[kept] / weights[kept].sum()
    mean, covariance = _mixed(share, every.mean[kept], every.covariance[kept])
    shared, shared_covariance = _mixed(share, every.shared[kept], every.shared_covariance[kept])
    middles = every.mean[kept][:, :, :2].reshape(int(kept.sum()), -1)
    centres = _mixed(share, middles, every.centres[kept])[1]
    return _Posterior(mean, covariance, shared, shared_covariance, centres, logs.max()), weights


def _mixed(weights: Array, means: Array, covariances: Array) -> tuple[Array, Array]:
    """Return (..., P) means and (..., P, P) covariances of a mixture, from those of its parts, by their first axis."""
    mean = np.tensordot(weights, means, axes=1)
    off = means - mean
    within = np.tensordot(weights, covariances, axes=1)
    return mean, within + np.einsum("w,w...i,w...j->...ij", weights, off, off)


def _own_sigmas(evidence: Evidence, radius_scatters: Array, weights: Array, reach_mm: float) -> Array:
    """Return the (V,) sigmas, mm, of centres by each view alone, from (G,) radius scatters and their weights."""
    loose = np.full(UNKNOWNS, (_SHAPE_SCATTERS[0] * reach_mm) ** -2.0)
    loose[:2] = (2.0 * reach_mm) ** -2.0
    variance = np.zeros(len(evidence.product))
    for scatter in np.unique(radius_scatters):
        loose[2] = scatter**-2.0
        covariance = np.linalg.inv(evidence.information + np.diag(loose))
        largest = np.linalg.eigvalsh(covariance[:, :2, :2])[:, -1]
        variance += weights[radius_scatters == scatter].sum() * largest
    return np.sqrt(variance / weights.sum())
