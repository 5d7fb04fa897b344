"""What the rims of the views say about their discs, linearised: information and right sides of normal equations.

A view has the unknowns centre, mean radius and Fourier coefficients of its edge (`calib.model.rim_fit`). Bright points
at the border of the frame say where the rim is not: they enter as Gaussian sites by expectation propagation (Minka,
2001). The module uses the views one by one; it knows nothing of what they have in common.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

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
    away = points - about[:2]
    rho = np.maximum(np.hypot(*away.T), 1e-9)
    u = away / rho[:, None]
    orders = np.arange(2, _ORDERS + 1)
    phi = np.arctan2(u[:, 1], u[:, 0])[:, None] * orders
    waves = np.stack([np.cos(phi), np.sin(phi)], axis=-1).reshape(len(points), UNKNOWNS - 3)
    slopes = np.stack([-orders * np.sin(phi), orders * np.cos(phi)], axis=-1).reshape(waves.shape) @ about[3:]
    n = u - (slopes / rho)[:, None] * np.column_stack([-u[:, 1], u[:, 0]])
    return np.column_stack([n, np.ones(len(points)), waves]), rho + n @ about[:2]


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
    orders = np.arange(2, _ORDERS + 1)
    for own, mean, covariance in zip(points, means, covariances, strict=True):
        away = own - mean[:2]
        rho = np.maximum(np.hypot(*away.T), 1e-9)
        u = away / rho[:, None]
        phi = np.arctan2(u[:, 1], u[:, 0])[:, None] * orders
        slopes = np.stack([-orders * np.sin(phi), orders * np.cos(phi)], axis=-1).reshape(
            len(own), UNKNOWNS - 3
        )
        bends = np.stack([orders**2 * np.cos(phi), orders**2 * np.sin(phi)], axis=-1).reshape(
            len(own), UNKNOWNS - 3
        )
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
