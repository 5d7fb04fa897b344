"""The focus of a live picture as one number, from out of focus to sharp: the edge width.

Near focus, it is the width of the stars' edges. Farther out, it follows from the blur circle that the print around the
tag shows. If neither stars nor a tag are found, it is unknown. The module computes with arrays.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from calib.model.homography import fit_homography
from calib.stars.focus import blur_circle, edge_widths_px
from calib.stars.quick import QuickStars
from calib.target import StarTarget

_REGIONS: Final = ((0.5, 0.5), (0.17, 0.2), (0.83, 0.2), (0.17, 0.8), (0.83, 0.8))
"""Middle of each region whose edges give one width, as shares of width and height."""
_HALF_SIZE: Final = (0.25, 0.3)  # Of a region, as shares of width and height
_STARS_A_REGION: Final = 9  # The nearest to its middle; their edges give one width
_CIRCLE_FROM_PX: Final = 1.2
"""Edge width below which the blur circle is far from one that counts, px."""
_CIRCLES_PX: Final = (6.0, 6.5)
"""Blur circles from which it counts, and counts fully, where it shows more blur than the stars' edges: these may look
sharp from 9 px on, and bright light gives a sharp lens a circle of 5.8 px. A step would look like a turn."""
_SIGMA_OF_CIRCLE: Final = 0.25
"""Standard deviation of the points of a uniform disc along one axis, as a share of the diameter."""
_NEAR_TAG: Final = 40  # Stars about the tag: enough for a median, near enough for one edge width


def edge_width_px(image: NDArray[np.float32], stars: QuickStars | None, target: StarTarget) -> float | None:
    """Return the standard deviation of the edges' blur, px; None if neither stars nor a tag were found."""
    if stars is None:
        return None
    known = [width for width in _region_widths(image, stars, target) if width is not None]
    width = float(np.median(known)) if known else None
    if width is not None and width <= _CIRCLE_FROM_PX:
        return width
    circle = _circle(image, stars, target)
    if circle is None:
        return width
    by_circle = _SIGMA_OF_CIRCLE * circle
    if width is None:
        return by_circle
    weight = float(np.interp(circle, _CIRCLES_PX, (0.0, 1.0)))
    return width + weight * max(0.0, by_circle - width)


def _region_widths(
    image: NDArray[np.float32], stars: QuickStars, target: StarTarget
) -> Sequence[float | None]:
    """Return the edge width of each region, from the stars nearest to its middle."""
    if stars.local_map is None:
        return []
    size = np.array([image.shape[1], image.shape[0]], float)
    groups = []
    for middle in _REGIONS:
        off = (stars.points_px - np.array(middle) * size) / size
        inside = np.flatnonzero((np.abs(off) <= np.array(_HALF_SIZE)).all(axis=1))
        order = np.argsort(np.linalg.norm((off * size)[inside], axis=1), kind="stable")
        groups.append(inside[order[:_STARS_A_REGION]].astype(np.int64))
    return edge_widths_px(image, stars.points_px, stars.local_map, target, groups)


def _circle(image: NDArray[np.float32], stars: QuickStars, target: StarTarget) -> float | None:
    """Return the blur circle around the tag, px; None if the tag is not in view."""
    if stars.named_by and len(stars.points_px):
        # Stars give the place of the print better than the tag: bright light does not move them.
        off = stars.nodes - np.array(target.tag_centre_mm) / target.pitch_mm
        near = np.argsort(np.linalg.norm(off, axis=1))[:_NEAR_TAG]
        circle = blur_circle(
            image, fit_homography(stars.nodes[near], stars.points_px[near]), target, enlarged=(1.0,)
        )
    elif stars.tag is not None:
        circle = blur_circle(image, stars.tag.homography, target)
    else:
        return None
    return circle.diameter_px if circle is not None else None
