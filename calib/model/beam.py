"""The visible disc: which part of the target a view's beam lights, found from the stars that are there.

Knows which stars a view has and lacks. The disc's centre tells where in the collimator's pupil the camera stands:
its aperture, seen from there, cuts the beam. A star absent inside the frame counts as much as one present. Where a
view's own stars do not tell, those of the others do: the discs of one bench resemble each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from calib.model.homography import apply_homography, view_homography
from calib.view import View

Array = NDArray[np.float64]

#: A star may be missed, or seen beyond the rim, for reasons of its own this often.
_ODD = 0.01
#: Softness of the rim in pitches, coarse to fine.
_SOFTNESS = (1.0, 0.25)
#: A disc's centre known to this share of its radius tells the place in the pupil; else the rim is out of sight.
_SEEN_SIGMA = 0.06
#: How much the discs of one bench differ, as shares of the radius: their centres, per axis, and their radii. On the
#: published recordings 0.17 and 0.06.
_ALIKE = np.array([0.2, 0.2, 0.1])
#: Stars this far from the nodes, in pitches, stand on no grid.
_OFF_GRID = 0.1
#: Stars so near the frame's border, in pitches, are absent for that reason.
_BORDER_PITCHES = 1.0


@dataclass(frozen=True)
class Disc:
    """A disc on the target plane.

    Attributes
    ----------
    centre_mm
        (2,) its centre.
    radius_mm
        Its radius.
    sigma_mm
        1-sigma of the centre, the worse axis; infinite where the rim is out of sight.
    borrowed
        Whether the rim is out of sight and other views' discs helped.
    """

    centre_mm: Array
    radius_mm: float
    sigma_mm: float
    uses_other_views: bool = False

    @property
    def rim_visible(self) -> bool:
        """Whether the view's own stars show where the disc lies."""
        return not self.uses_other_views and self.sigma_mm <= _SEEN_SIGMA * self.radius_mm


def visible_discs(views: Sequence[View]) -> list[Disc]:
    """Fit each view's disc; where its rim is out of sight, with the help of the discs of views that show theirs.

    Those have a mean centre and a mean radius, about which the others are expected to scatter by 0.2 and 0.1 of the
    radius (a Gaussian); what is visible of a rim moves a disc away from there. Where no view shows its rim, or stars
    stand on no grid, sigmas stay as they are.

    Raises
    ------
    TooFewStars, DegenerateViews, InputMismatch
        As `calib.model.homography.view_homography`.
    """
    discs = [visible_disc(view) for view in views]
    seen = np.array([[*disc.centre_mm, disc.radius_mm] for disc in discs if disc.rim_visible])
    if not len(seen):
        return discs
    middle = seen.mean(axis=0)
    alike = middle, _ALIKE * middle[2]
    return [
        disc if disc.rim_visible else replace(visible_disc(view, alike), uses_other_views=True)
        for view, disc in zip(views, discs, strict=True)
    ]


def visible_disc(view: View, alike: tuple[Array, Array] | None = None) -> Disc:
    """Fit the disc that best parts the stars present from those absent (a logistic model of the rim).

    Stars that stand on no grid tell nothing of those absent: then the centre's sigma is infinite.

    Parameters
    ----------
    view
        Stars of one pose.
    alike
        (3,) centre and radius, mm, expected beforehand, and (3,) their 1-sigma; None: nothing is.

    Raises
    ------
    TooFewStars, DegenerateViews, InputMismatch
        As `calib.model.homography.view_homography`.
    """
    h, pitch = view_homography(view), _pitch(view)
    middle = view.target_mm.mean(axis=0)
    reach = float(np.linalg.norm(view.target_mm - middle, axis=1).max())
    if pitch is None:
        return Disc(middle, reach, float("inf"))
    nodes, present = _nodes(view, h, pitch)
    best = np.array([*middle, reach]) if alike is None else alike[0]
    for softness in _SOFTNESS:
        starts = [best * [1.0, 1.0, scale] for scale in (0.9, 1.0, 1.1)]
        fits = [
            minimize(_misfit, start, (nodes, present, softness * pitch, alike), method="BFGS", jac=True)
            for start in starts
        ]
        best = min(fits, key=lambda f: f.fun).x
    x, y, radius = (float(v) for v in best)
    information = _information(best, nodes, _SOFTNESS[-1] * pitch)
    if alike is not None:
        information += np.diag(alike[1] ** -2)
    eigenvalues, vectors = np.linalg.eigh(information)
    sigma = np.inf
    if eigenvalues[0] > 1e-6 * eigenvalues[-1]:
        sigma = float(np.sqrt(np.diag((vectors / eigenvalues) @ vectors.T)[:2].max()))
    return Disc(np.array([x, y]), abs(radius), sigma)


def without_guard_band(view: View, disc: Disc, share: float) -> View:
    """Return the view's stars within a share of the disc's radius: the guard band taken off."""
    if share >= 1.0:
        return view
    kept = inside_guard_band(view, disc, share)
    return View(
        view.name,
        view.image_size,
        view.ids[kept],
        view.points_px[kept],
        view.target_mm[kept],
        view.covariances_px2[kept],
    )


def inside_guard_band(view: View, disc: Disc, share: float) -> NDArray[np.bool_]:
    """Tell, star by star, which lie within a share of the disc's radius; all do within a share of 1."""
    away = np.linalg.norm(view.target_mm - disc.centre_mm, axis=1)
    return np.asarray((away <= share * disc.radius_mm) | (share >= 1.0))


def _pitch(view: View) -> float | None:
    """Return the pitch of the grid that the stars stand on, mm; None when they stand on none."""
    stars = view.target_mm
    steps = np.concatenate([np.diff(np.unique(np.round(along, 6))) for along in stars.T])
    pitch = float(np.min(steps[steps > 1e-3 * np.ptp(stars)]))
    nodes = (stars - stars.min(axis=0)) / pitch
    return pitch if np.abs(nodes - np.round(nodes)).max() < _OFF_GRID else None


def _nodes(view: View, h: Array, pitch: float) -> tuple[Array, NDArray[np.bool_]]:
    """Return the grid's nodes that lie in the frame, and which of them carry a star found."""
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


def _misfit(
    disc: Array,
    nodes: Array,
    present: NDArray[np.bool_],
    softness: float,
    alike: tuple[Array, Array] | None,
) -> tuple[float, Array]:
    """Return minus the log likelihood of presence and absence, and of what was expected; and its gradient."""
    away = nodes - disc[:2]
    distance = np.maximum(np.linalg.norm(away, axis=1), 1e-9)
    inside = 1.0 / (1.0 + np.exp(-np.clip((disc[2] - distance) / softness, -40.0, 40.0)))
    likely = np.where(present, _ODD + (1.0 - 2.0 * _ODD) * inside, 1.0 - _ODD - (1.0 - 2.0 * _ODD) * inside)
    slope = np.where(present, -1.0, 1.0) * (1.0 - 2.0 * _ODD) * inside * (1.0 - inside) / likely / softness
    gradient = np.array([*(slope[:, None] * away / distance[:, None]).sum(axis=0), slope.sum()])
    if alike is None:
        return float(-np.log(likely).sum()), gradient
    off = (disc - alike[0]) / alike[1]
    return float(-np.log(likely).sum() + 0.5 * off @ off), gradient + off / alike[1]


def _information(disc: Array, nodes: Array, softness: float) -> Array:
    """Return the Fisher information of centre and radius."""
    away = nodes - disc[:2]
    distance = np.maximum(np.linalg.norm(away, axis=1), 1e-9)
    inside = 1.0 / (1.0 + np.exp(-np.clip((disc[2] - distance) / softness, -40.0, 40.0)))
    slopes = np.column_stack([away / distance[:, None], np.ones(len(nodes))]) / softness
    return np.asarray(slopes.T @ (slopes * (inside * (1.0 - inside))[:, None]))
