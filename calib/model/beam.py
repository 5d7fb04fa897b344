"""The visible disc: the part of the target that the beam of a view lights.

The centre of the disc shows the camera's position in the pupil of the collimator, because the aperture cuts the beam.
If the images of the views were searched for the rim of the beam, the discs are fitted to it (`calib.model.rim_fit`).
If only stars are known, the discs are fitted to the stars present and absent. A star that is absent inside the frame
counts as much as a star that is present. If the stars of a view do not show the rim of the disc, the discs of the other
views help: the discs of one bench are similar.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.model.homography import apply_homography, view_homography
from calib.model.rim_fit import fit_rims
from calib.view import RimPoints, View

Array = NDArray[np.float64]

#: Probability that a star is missed inside the disc, or seen outside it.
_OUTLIER_PROBABILITY = 0.01
#: Width of the logistic rim in grid pitches, coarse to fine.
_SOFTNESS = (1.0, 0.25)
#: The rim counts as visible if the 1-sigma of the disc's centre is at most this share of its radius.
_VISIBLE_RIM_SIGMA = 0.06
#: 1-sigma differences between the discs of one bench, as shares of the radius: centre x, centre y, radius. On the
#: published recordings they are 0.17, 0.17 and 0.06.
_BENCH_SCATTER = np.array([0.2, 0.2, 0.1])
#: 1-sigma of each Fourier coefficient of the edge of a beam, orders 2 to 5, as a share of the radius. With it the discs
#: of the published recordings, cut to smaller frames, agree with those of the whole frames within their sigmas.
_EDGE_SHARE = 0.025
#: Least number of rim points in one of the views for a fit to the rims.
_FEWEST_POINTS = 3
#: Stars farther than this from the grid nodes, in pitches, are not on a grid.
_OFF_GRID = 0.1
#: A star closer than this to the frame's border, in pitches, may be missing for that reason.
_BORDER_PITCHES = 1.0


@dataclass(frozen=True)
class Disc:
    """A disc on the target plane."""

    centre_mm: Array  # (2,) float64 centre, mm
    radius_mm: float  # Radius, mm
    sigma_mm: float  # 1-sigma of the centre along the worse axis, mm; infinite if the rim is out of view
    uses_other_views: bool = False  # Whether the rim is out of view and the discs of other views helped
    # (2, 2) float64, mm^2, covariance of the centre; None if the centre is unknown.
    covariance_mm2: Array | None = None
    # 1-sigma of the centre, mm, by the view's own rim and if the edge of the beam were a circle; None if it
    # is ``sigma_mm``. It tells how much of the rim is in view.
    circle_sigma_mm: float | None = None

    @property
    def rim_visible(self) -> bool:
        """Whether the view itself shows enough of the rim to locate a circle."""
        sigma_mm = self.sigma_mm if self.circle_sigma_mm is None else self.circle_sigma_mm
        return not self.uses_other_views and sigma_mm <= _VISIBLE_RIM_SIGMA * self.radius_mm

    @property
    def is_known(self) -> bool:
        """Whether the centre is known well enough for the aberrations of a collimator."""
        return self.sigma_mm <= _VISIBLE_RIM_SIGMA * self.radius_mm


def visible_discs(views: Sequence[View]) -> list[Disc]:
    """Fit the disc of each view; the discs of views that show their rim help where a rim is out of view.

    If the images of all views were searched for the rim, and one of them shows it, the discs are fitted to the points
    of the rims (`calib.model.rim_fit`). Otherwise they are fitted to the stars present and absent: the visible discs
    give a mean centre and a mean radius. The other discs are expected to scatter about them by 0.2 (centre) and 0.1
    (radius) of the radius, as a Gaussian prior. If no view shows its rim, no disc gets help. Own procedure.

    Returns: One disc for each view, in their order.
    Raises TooFewStars, DegenerateViews, InputMismatch: As `calib.model.homography.view_homography`.
    """
    rims = [view.rim for view in views if view.rim is not None]
    if len(rims) == len(views) and any(len(rim.points_mm) >= _FEWEST_POINTS for rim in rims):
        return _discs_of_rims(views, rims)
    discs = [visible_disc(view) for view in views]
    seen = np.array([[*disc.centre_mm, disc.radius_mm] for disc in discs if disc.rim_visible])
    if not len(seen):
        return discs
    middle = seen.mean(axis=0)
    expected = middle, _BENCH_SCATTER * middle[2]
    return [
        disc if disc.rim_visible else replace(visible_disc(view, expected), uses_other_views=True)
        for view, disc in zip(views, discs, strict=True)
    ]


def _discs_of_rims(views: Sequence[View], rims: Sequence[RimPoints]) -> list[Disc]:
    """Fit the discs of all views to the points of their rims."""
    looks = np.array([_look_mm(view) for view in views])
    stars = np.concatenate([view.target_mm for view in views])
    middle = stars.mean(axis=0)
    reach = float(np.linalg.norm(stars - middle, axis=1).max())
    return [
        Disc(
            fitted.centre_mm,
            fitted.radius_mm,
            float(np.sqrt(np.linalg.eigvalsh(fitted.covariance_mm2)[-1])),
            uses_other_views=fitted.own_sigma_mm > _VISIBLE_RIM_SIGMA * fitted.radius_mm,
            covariance_mm2=fitted.covariance_mm2,
            circle_sigma_mm=fitted.own_sigma_mm,
        )
        for fitted in fit_rims(rims, looks, middle, reach)
    ]


def _look_mm(view: View) -> Array:
    """Return the (2,) point of the target, mm, that lies in the middle of the image."""
    middle = (np.array(view.image_size) - 1.0) / 2.0
    back = np.asarray(np.linalg.inv(view_homography(view)), np.float64)
    return np.asarray(apply_homography(back, middle[None, :])[0])


def visible_disc(view: View, expected: tuple[Array, Array] | None = None) -> Disc:
    """Fit the disc that best separates the stars present from those absent, by maximum likelihood.

    The probability that a star is visible is a logistic function of its distance from the rim. If the stars are not on
    a grid, absent stars are unknown; the centre's sigma is then infinite. The model is logistic regression (Cox, 1958)
    with a probability of wrong observations (Copas, 1988).

    expected: (3,) expected centre and radius, mm, and (3,) their 1-sigma, mm; None if nothing is known
      beforehand.
    Returns: The fitted disc. Its covariance is that of the Fisher information, and of an edge that is not a
      circle.
    Raises TooFewStars, DegenerateViews, InputMismatch: As `calib.model.homography.view_homography`.
    """
    from scipy.optimize import (
        minimize,
    )  # loading it takes longer than a fit, and few calibrations need a disc

    h, pitch = view_homography(view), _pitch(view)
    middle = view.target_mm.mean(axis=0)
    reach = float(np.linalg.norm(view.target_mm - middle, axis=1).max())
    if pitch is None:
        return Disc(middle, reach, float("inf"))
    nodes, present = _nodes(view, h, pitch)
    best = np.array([*middle, reach]) if expected is None else expected[0]
    for softness in _SOFTNESS:
        starts = [best * [1.0, 1.0, scale] for scale in (0.9, 1.0, 1.1)]
        fits = [
            minimize(
                _negative_log_likelihood,
                start,
                (nodes, present, softness * pitch, expected),
                method="BFGS",
                jac=True,
            )
            for start in starts
        ]
        best = min(fits, key=lambda f: f.fun).x
    x, y, radius = (float(v) for v in best)
    information = _information(best, nodes, _SOFTNESS[-1] * pitch)
    if expected is not None:
        information += np.diag(expected[1] ** -2)
    eigenvalues, vectors = np.linalg.eigh(information)
    if not eigenvalues[0] > 1e-6 * eigenvalues[-1]:
        return Disc(np.array([x, y]), abs(radius), float("inf"))
    covariance = (vectors / eigenvalues) @ vectors.T
    circle_sigma = float(np.sqrt(np.diag(covariance)[:2].max()))
    covariance = covariance + _of_shape(best, nodes, _SOFTNESS[-1] * pitch, covariance)
    return Disc(
        np.array([x, y]),
        abs(radius),
        float(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1])),
        covariance_mm2=covariance[:2, :2],
        circle_sigma_mm=circle_sigma,
    )


def inside_guard_band(view: View, disc: Disc, share: float) -> NDArray[np.bool_]:
    """Tell which stars lie inside the guard band, that is, within a share of the disc's radius.

    Own rule: the distance from the disc's centre is at most the share of its radius.

    disc: The view's visible disc.
    share: Share of the disc's radius; with 1 or more, all stars are inside.
    Returns: (N,) bool, True for each star inside.
    """
    away = np.linalg.norm(view.target_mm - disc.centre_mm, axis=1)
    return np.asarray((away <= share * disc.radius_mm) | (share >= 1.0))


def _pitch(view: View) -> float | None:
    """Return the pitch of the grid of stars, mm; None if the stars are not on a grid."""
    stars = view.target_mm
    steps = np.concatenate([np.diff(np.unique(np.round(along, 6))) for along in stars.T])
    pitch = float(np.min(steps[steps > 1e-3 * np.ptp(stars)]))
    nodes = (stars - stars.min(axis=0)) / pitch
    return pitch if np.abs(nodes - np.round(nodes)).max() < _OFF_GRID else None


def _nodes(view: View, h: Array, pitch: float) -> tuple[Array, NDArray[np.bool_]]:
    """Return the grid nodes in the frame, (M, 2) mm, and which of them have a star, (M,) bool."""
    stars = view.target_mm
    first, last = stars.min(axis=0) - 6 * pitch, stars.max(axis=0) + 6.5 * pitch
    columns, rows = (np.arange(a, b, pitch) for a, b in zip(first, last, strict=True))
    nodes = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    taken = np.round((stars - first) / pitch).astype(np.int64)
    present = np.zeros(len(nodes), np.bool_)
    present[taken[:, 1] * len(columns) + taken[:, 0]] = True
    in_front = nodes @ h[2, :2] + h[2, 2] > 0
    pixels, beside = apply_homography(h, nodes), apply_homography(h, nodes + np.array([pitch, 0.0]))
    border = _BORDER_PITCHES * np.linalg.norm(beside - pixels, axis=1)[:, None]
    framed = ((pixels > border) & (pixels < np.array(view.image_size) - 1 - border)).all(axis=1)
    used = present | (framed & in_front)
    return nodes[used], present[used]


def _negative_log_likelihood(
    disc: Array,
    nodes: Array,
    present: NDArray[np.bool_],
    softness: float,
    expected: tuple[Array, Array] | None,
) -> tuple[float, Array]:
    """Return the negative log likelihood of presence, absence and the expected disc, and its (3,) gradient.

    With p = 1 / (1 + exp(-(radius - distance) / softness)), a star is present with probability q + (1 - 2 q) p: the
    contaminated logistic model of Copas (1988), where q is the probability of a wrong observation.
    """
    away = nodes - disc[:2]
    distance = np.maximum(np.linalg.norm(away, axis=1), 1e-9)
    inside = 1.0 / (1.0 + np.exp(-np.clip((disc[2] - distance) / softness, -40.0, 40.0)))
    likelihood = np.where(
        present,
        _OUTLIER_PROBABILITY + (1.0 - 2.0 * _OUTLIER_PROBABILITY) * inside,
        1.0 - _OUTLIER_PROBABILITY - (1.0 - 2.0 * _OUTLIER_PROBABILITY) * inside,
    )
    slope = (
        np.where(present, -1.0, 1.0)
        * (1.0 - 2.0 * _OUTLIER_PROBABILITY)
        * inside
        * (1.0 - inside)
        / likelihood
        / softness
    )
    gradient = np.array([*(slope[:, None] * away / distance[:, None]).sum(axis=0), slope.sum()])
    if expected is None:
        return float(-np.log(likelihood).sum()), gradient
    off = (disc - expected[0]) / expected[1]
    return float(-np.log(likelihood).sum() + 0.5 * off @ off), gradient + off / expected[1]


def _of_shape(disc: Array, nodes: Array, softness: float, covariance: Array) -> Array:
    """Return the (3, 3) covariance, mm^2, that an edge of the beam which is not a circle adds to centre and radius.

    Own derivation: the fitted disc follows an unmodelled wave of the edge by C G^T w, with the covariance C of the fit,
    the derivatives G and the weights of the stars. The waves of orders 2 to 5 are independent with the 1-sigma
    `_EDGE_SHARE`.
    """
    away = nodes - disc[:2]
    phi = np.arctan2(away[:, 1], away[:, 0])[:, None] * np.arange(2, 6)
    waves = np.concatenate([np.cos(phi), np.sin(phi)], axis=1)
    slopes, weights = _slopes_and_weights(disc, nodes, softness)
    follows = covariance @ (slopes.T @ (weights[:, None] * waves)) / softness
    return np.asarray((_EDGE_SHARE * disc[2]) ** 2 * follows @ follows.T)


def _information(disc: Array, nodes: Array, softness: float) -> Array:
    """Return the (3, 3) Fisher information of centre and radius, 1 / mm^2.

    Sum of p (1 - p) g g^T, as in logistic regression (Cox, 1958), with the derivatives g of the exponent; wrong
    observations are neglected.
    """
    slopes, weights = _slopes_and_weights(disc, nodes, softness)
    return np.asarray(slopes.T @ (slopes * weights[:, None]))


def _slopes_and_weights(disc: Array, nodes: Array, softness: float) -> tuple[Array, Array]:
    """Return (M, 3) derivatives of the exponents by centre and radius, 1 / mm, and (M,) weights p (1 - p)."""
    away = nodes - disc[:2]
    distance = np.maximum(np.linalg.norm(away, axis=1), 1e-9)
    inside = 1.0 / (1.0 + np.exp(-np.clip((disc[2] - distance) / softness, -40.0, 40.0)))
    slopes = np.column_stack([away / distance[:, None], np.ones(len(nodes))]) / softness
    return slopes, inside * (1.0 - inside)
