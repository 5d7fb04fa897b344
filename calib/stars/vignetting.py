"""Vignetted stars: the outermost stars of the beam, and their larger uncertainty.

At the rim of the beam the light falls off across a star, which moves its edges. The edges of all such stars move
outwards. The covariances from a star's own pixels do not show this shift, and the focal length would absorb it. The
module uses no images and no camera model.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.model.homography import apply_homography, view_homography
from calib.target import StarTarget
from calib.view import View

#: Standard uncertainty per axis that is added to a vignetted star's own, px. In simulated beams the outermost stars
#: are all shifted outwards by 0.03 px, which changes f by 2 sigma. With this uncertainty they have little weight.
VIGNETTED_SIGMA_PX = 0.2
#: Distance from the border of the frame, pitches, within which a neighbour is missing because of the border.
_BORDER_PITCHES = 0.55
_NEIGHBOURS = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)])


def vignetted_stars(view: View, target: StarTarget) -> NDArray[np.bool_]:
    """Find the outermost stars of the beam: those without a neighbour that would lie inside the frame.

    Own rule: the neighbour must be expected more than `_BORDER_PITCHES` from the frame's border, and not at the tag.
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
    """Add the variance of ``sigma_px``, per axis, to a view's vignetted stars: an independent error (own model)."""
    added = np.where(vignetted_stars(view, target), sigma_px**2, 0.0)
    return replace(view, covariances_px2=view.covariances_px2 + added[:, None, None] * np.eye(2))
