"""The noise of the stars of views, without any model of camera or collimator."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.model.homography import apply_homography, neighbours_of, rough_homography
from calib.model.local_consistency import local_sigma_px
from calib.view import View


def noise_px(view: View) -> float:
    """Return the noise of a view as its neighbouring stars show it.

    Own estimate, that of `calib.model.local_consistency.local_sigma_px`.

    view: A view without gross errors.
    Returns: 1-sigma per axis, px; NaN for fewer than 8 stars.
    Raises TooFewStars, DegenerateViews: If the stars do not determine a homography.
    """
    return view.remembered("noise", _noise_px)


def _noise_px(view: View) -> float:
    """Return the noise of a view, as `noise_px`."""
    mapped = apply_homography(rough_homography(view), view.target_mm)
    return local_sigma_px(view.target_mm, mapped, view.points_px, neighbours_of(view))


def typical_noise_px(views: Sequence[View]) -> float:
    """Return the median noise of views as their neighbouring stars show it.

    views: Views without gross errors.
    Returns: 1-sigma per axis, px; NaN if all views have fewer than 8 stars.
    """
    known = [sigma for sigma in map(noise_px, views) if np.isfinite(sigma)]
    return float(np.median(known)) if known else float("nan")
