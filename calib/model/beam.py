"""The visible disc: the part of the target that the beam of a view lights.

The centre of the disc shows the camera's position in the pupil of the collimator, because the aperture cuts the beam.
The discs of one bench are alike, so those of all views are fitted together (`calib.model.rim_fit`): to the rims that
the images show, or between stars seen and not seen (`calib.model.star_rim`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calib.model.homography import apply_homography, view_homography
from calib.model.rim_fit import Disc, Discs, fit_rims
from calib.model.star_rim import rims_of_stars
from calib.view import View

Array = NDArray[np.float64]

#: Least number of rim points for a fit.
_FEWEST_POINTS = 3


def visible_discs(views: Sequence[View]) -> list[Disc]:
    """Return the disc of each view, as `discs_of`; none if the rim is nowhere in view."""
    found = discs_of(views)
    return found.of_views if found else []


def discs_of(views: Sequence[View]) -> Discs | None:
    """Fit the discs of views of different poses.

    If the images of all views were searched for the rim, and one of them shows it, the discs are fitted to the rims
    found; otherwise to the stars.

    Returns: None if the rim is nowhere in view.
    Raises TooFewStars, DegenerateViews, InputMismatch: As `calib.model.homography.view_homography`.
    """
    rims = [view.rim for view in views if view.rim is not None]
    if len(rims) < len(views) or all(len(rim.points_mm) < _FEWEST_POINTS for rim in rims):
        rims = rims_of_stars(views)
    if sum(len(rim.points_mm) for rim in rims) < _FEWEST_POINTS:
        return None
    looks = np.array([_look_mm(view) for view in views])
    stars = np.concatenate([view.target_mm for view in views])
    middle = stars.mean(axis=0)
    reach = float(np.linalg.norm(stars - middle, axis=1).max())
    found = fit_rims(rims, looks, middle, reach)
    return found if any(disc.rim_visible for disc in found.of_views) else None


def _look_mm(view: View) -> Array:
    """Return the (2,) point of the target, mm, that lies in the middle of the image."""
    middle = (np.array(view.image_size) - 1.0) / 2.0
    back = np.asarray(np.linalg.inv(view_homography(view)), np.float64)
    return np.asarray(apply_homography(back, middle[None, :])[0])


def inside_guard_band(view: View, disc: Disc, share: float) -> NDArray[np.bool_]:
    """Tell which stars lie inside the guard band, that is, within a share of the disc's radius.

    Own rule: the distance from the disc's centre is at most the share of its radius.

    disc: The view's visible disc.
    share: Share of the disc's radius; with 1 or more, all stars are inside.
    Returns: (N,) bool, True for each star inside.
    """
    away = np.linalg.norm(view.target_mm - disc.centre_mm, axis=1)
    return np.asarray((away <= share * disc.radius_mm) | (share >= 1.0))
