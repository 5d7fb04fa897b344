"""Stars for a live picture: the same search as `calib.stars.detect`, without likelihood and covariances.

The centres are those of symmetry, refined once: good to some hundredths of a pixel if the image is in focus. Stars that
cannot be identified have no ids. The module is for aiming and focusing only; no calibration uses it.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from calib.arrays import AnyArray, Array, Ints
from calib.errors import placed
from calib.events.grey_image import to_uint8
from calib.stars.candidates import MIN_STARS, Candidates, StarLabels, find_without_tag, grow_from_tag, printed
from calib.stars.centring import smooth
from calib.stars.detect import BLUR_PX, COARSE_STEP_PX, refine_candidates
from calib.stars.grid_map import LocalMap
from calib.stars.tag import TagDetection, find_tag
from calib.target import StarTarget


class QuickStars(NamedTuple):
    """Stars of a live picture."""

    ids: Ints  # (N,) int64, ids on the target; -1 if nothing identifies the stars
    # (N, 2) float64, columns and rows: of the target if the stars have ids, else of a grid with any origin.
    nodes: Array
    points_px: Array  # (N, 2) float64, px
    # Map around each star, from the target plane to the image; None without stars.
    local_map: LocalMap | None
    tag: TagDetection | None  # The target's tag; None if it cannot be read whole
    named_by: Literal["tag", "part of the tag", ""]  # What identified the stars; empty if nothing did
    blurred: bool  # Whether the stars are out of focus


def find_stars_quickly(image: AnyArray, target: StarTarget) -> QuickStars:
    """Find tag and stars of a live picture, in about half of the time of `calib.stars.detect.detect_stars`.

    Own procedure, of the steps of `calib.stars.detect`: tag, growth, one refinement by symmetry. No stars if fewer than
    `MIN_STARS` are seen, or if they are out of focus and nothing identifies them.
    Raises TargetNotFound: If the image shows another tag, or the tag more than once.
    """
    with placed("view live"):
        tag = find_tag(to_uint8(image), target)
    smoothed = smooth(np.nan_to_num(np.asarray(image, np.float32)), BLUR_PX)
    named_by: Literal["tag", "part of the tag", ""] = "tag"
    if tag is not None:
        grown, sign = grow_from_tag(smoothed, tag, target), tag.sign
        nodes = grown.nodes()
    else:
        grown, sign, labels = find_without_tag(smoothed, target, None)
        nodes, named_by = grown.nodes(), ""
        if isinstance(labels, StarLabels) and printed(target, labels.apply(nodes)).all():
            nodes, named_by = labels.apply(nodes), "part of the tag"
    nothing = np.zeros((0, 2))
    none = QuickStars(np.zeros(0, np.int64), nothing, nothing, None, tag, "", blurred=False)
    if len(nodes) < MIN_STARS:
        return none
    coarse = Candidates(nodes, grown.places())
    candidates, _, local_map, blurred = refine_candidates(smoothed, coarse, target, sign, COARSE_STEP_PX)
    # Far out of focus, the pattern shows again with its contrast reversed: shapes that are learnt there are no stars.
    if len(candidates.nodes) < MIN_STARS or (blurred and not named_by):
        return none
    nodes = candidates.nodes
    ids = target.id_at(nodes[:, 0], nodes[:, 1]) if named_by else np.full(len(nodes), -1, np.int64)
    return QuickStars(ids, nodes.astype(float), candidates.points, local_map, tag, named_by, blurred)
