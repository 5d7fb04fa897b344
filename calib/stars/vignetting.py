"""Stars at the rim of the beam: which they are, and how far they can be trusted.

There the light falls off across a star, so that its edges lie elsewhere than inside the beam, all towards the rim: a
shift that no covariance from the star's own pixels shows, and that a focal length takes up. Knows views and the
target's grid; no images, no camera model.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.model.homography import apply_homography, view_homography
from calib.target import StarTarget
from calib.view import View

#: Standard uncertainty a star at the rim gets besides its own, px. Simulated beams shift the outermost stars by
#: 0.03 px outwards, all together, which is worth 2 sigma of f; with this, they no longer decide anything.
VIGNETTED_SIGMA_PX = 0.2
#: A neighbour this near the frame's border, in pitches, is absent for that reason.
_BORDER_PITCHES = 0.55
_NEIGHBOURS = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)])


def vignetted_stars(view: View, target: StarTarget) -> NDArray[np.bool_]:
    """Find the stars that lack a neighbour although it would lie inside the frame.

    Parameters
    ----------
    view
        Stars of one pose.
    target
        The target they belong to.

    Returns
    -------
    (N,) bool
        True for the outermost stars of the beam. Stars beside the frame's border, or the tag, are none of them.

    Raises
    ------
    TooFewStars, DegenerateViews
        As `calib.model.homography.view_homography`.
    """
    mapping = view_homography(view)
    nodes = target.node_of(view.ids)
    around = nodes[:, None, :] + _NEIGHBOURS
    ids = target.id_at(around[..., 0], around[..., 1])
    absent = (ids >= 0) & ~np.isin(ids, view.ids)
    expected_px = apply_homography(mapping, (around * target.pitch_mm).reshape(-1, 2)).reshape(*around.shape)
    pitch_px = np.linalg.norm(expected_px - view.points_px[:, None, :], axis=2).min(axis=1)
    border_px = _BORDER_PITCHES * pitch_px[:, None, None]
    last = np.array(view.image_size) - 1.0
    inside = ((expected_px >= border_px) & (expected_px <= last - border_px)).all(axis=2)
    return np.asarray((absent & inside).any(axis=1))


def downweight_vignetted(view: View, target: StarTarget, sigma_px: float = VIGNETTED_SIGMA_PX) -> View:
    """Give the stars at the rim of the beam the uncertainty that their place there adds.

    Parameters
    ----------
    view, target
        As for `vignetted_stars`.
    sigma_px
        Standard uncertainty to add, per axis.

    Returns
    -------
    View
        The same stars; covariances of those at the rim are larger by ``sigma_px`` squared.
    """
    added = np.where(vignetted_stars(view, target), sigma_px**2, 0.0)
    return replace(view, covariances_px2=view.covariances_px2 + added[:, None, None] * np.eye(2))
