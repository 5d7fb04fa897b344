"""The noise of the stars of a view, without any model of camera or collimator."""

from __future__ import annotations

from calib.model.homography import apply_homography, view_homography
from calib.model.local_consistency import local_sigma_px
from calib.view import View


def noise_px(view: View) -> float:
    """Return the noise of a view as its neighbouring stars show it, without any model of camera or collimator.

    Own estimate, that of `calib.model.local_consistency.local_sigma_px`.

    Parameters
    ----------
    view
        A view without gross errors.

    Returns
    -------
    float
        1-sigma per axis, px; NaN for fewer than 8 stars.
    """
    mapped = apply_homography(view_homography(view), view.target_mm)
    return local_sigma_px(view.target_mm, mapped, view.points_px)
