"""A dark square on light in a live picture: a tag that cannot be read, because it is blurred or cut by the frame.

The square says where the tag probably is; nothing identifies it. It serves to aim; no star gets an id by it.
"""

from __future__ import annotations

import math
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.stars.beam import Beam

Border = Literal["left", "right", "upper", "lower"]

#: Long side of the reduced image, cells. A module of a tag is then some cells wide.
REDUCED = 320
#: Brightness below which a cell is dark, as a share of the brightness of white print.
DARK = 0.5
#: Least and largest side, as a share of the picture's longer side, and relative to the side that is expected.
SIDES, OF_EXPECTED = (0.05, 0.5), (0.6, 1.3)
#: Least share of its rectangle that a square fills; least ratio of its sides if it is whole, and if it is cut.
FILLED, WHOLE, CUT = 0.88, 0.85, 0.4
#: Width of a tag's dark edge and of the margin around it, as a share of the side; least share that is dark and light.
EDGE, EDGE_DARK, MARGIN_LIGHT = 0.06, 0.75, 0.85
#: Least share of light inside the dark edge: a tag shows white modules there.
INSIDE_LIGHT = 0.1


class DarkSquare(NamedTuple):
    """A dark square that looks like a tag."""

    # Centre (column, row), px, of the whole square; it may lie outside the frame.
    centre_px: tuple[float, float]
    side_px: float  # Side of the whole square, px
    borders: tuple[Border, ...]


def find_dark_square(
    image: NDArray[np.generic], beam: Beam, *, side_px: float | None = None
) -> DarkSquare | None:
    """Find the largest dark square with a dark edge, light inside and light around it; None if there is none.

    Own procedure: connected dark parts of the reduced image, compared with their smallest rectangle (OpenCV's
    ``minAreaRect``, rotating calipers of Toussaint, 1983). ``side_px`` is the expected side of the tag, if it is known.
    """
    scale = max(image.shape) / REDUCED
    shape = max(1, round(image.shape[1] / scale)), max(1, round(image.shape[0] / scale))
    values = np.nan_to_num(np.asarray(image, np.float32))
    small = cv2.medianBlur(cv2.resize(values, shape, interpolation=cv2.INTER_AREA), 3)
    white = float(np.quantile(small, 0.98))
    if white <= 0.0 or beam.share <= 0.0:
        return None
    lit = cv2.resize(beam.lit, shape, interpolation=cv2.INTER_NEAREST) > 0
    dark = (small < DARK * white) & lit
    expected = side_px / scale if side_px is not None else None
    count, parts, stats, _ = cv2.connectedComponentsWithStats(dark.astype(np.uint8), connectivity=8)
    longest = stats[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].max(axis=1)
    large = [part for part in range(1, count) if longest[part] >= SIDES[0] * REDUCED]
    for part in sorted(large, key=lambda one: -int(longest[one])):
        found = _square((parts == part).astype(np.uint8), dark, expected)
        if found is not None:
            (x, y), side, borders = found
            return DarkSquare(((x + 0.5) * scale - 0.5, (y + 0.5) * scale - 0.5), side * scale, borders)
    return None


def _square(
    part: NDArray[np.uint8], dark: NDArray[np.bool_], expected: float | None
) -> tuple[tuple[float, float], float, tuple[Border, ...]] | None:
    """Return centre, side (cells) and touched borders of a dark part; None if it does not look like a tag."""
    outlines, _ = cv2.findContours(part, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    hull = cv2.convexHull(outlines[0])
    (x, y), sides, angle_deg = cv2.minAreaRect(hull)
    sides = sides[0] + 1.0, sides[1] + 1.0  # a rectangle goes through the middles of its outer cells
    borders = _borders(hull.reshape(-1, 2), part.shape)
    short, long = min(sides), max(sides)
    low, high = (share * REDUCED for share in SIDES)
    if expected is not None:
        low, high = max(low, OF_EXPECTED[0] * expected), OF_EXPECTED[1] * expected
    if not low <= long <= high or short < (CUT if borders else WHOLE) * long:
        return None
    whole = np.zeros_like(part)
    cv2.fillConvexPoly(whole, hull, 1)
    if np.count_nonzero(whole) < FILLED * sides[0] * sides[1] or not _is_tag_like(whole, dark, long):
        return None
    side = max(long, expected) if expected is not None and len(borders) > 1 else long
    out = np.array([0.0, 0.0])
    for along_deg, length in ((angle_deg, sides[0]), (angle_deg + 90.0, sides[1])):
        axis = np.array([math.cos(math.radians(along_deg)), math.sin(math.radians(along_deg))])
        for border in borders:
            towards = float(axis @ _NORMALS[border])
            if abs(towards) > 0.7:
                out += math.copysign(0.5 * (side - length), towards) * axis
    return (float(x + out[0]), float(y + out[1])), side, borders


_NORMALS: dict[Border, NDArray[np.float64]] = {
    "left": np.array([-1.0, 0.0]),
    "right": np.array([1.0, 0.0]),
    "upper": np.array([0.0, -1.0]),
    "lower": np.array([0.0, 1.0]),
}


def _borders(points: NDArray[Any], shape: tuple[int, ...]) -> tuple[Border, ...]:
    """Return the borders of the frame that points lie at, to two cells."""
    (left, upper), (right, lower) = points.min(axis=0), points.max(axis=0)
    room: dict[Border, int] = {
        "left": int(left),
        "right": int(shape[1] - 1 - right),
        "upper": int(upper),
        "lower": int(shape[0] - 1 - lower),
    }
    return tuple(border for border, cells in room.items() if cells <= 2)


def _is_tag_like(whole: NDArray[np.uint8], dark: NDArray[np.bool_], side: float) -> bool:
    """Return whether a square has a dark edge, light inside, and light around, as far as the frame shows it."""
    width = max(1, round(EDGE * side))
    kernel = np.ones((2 * width + 1, 2 * width + 1), np.uint8)
    # Outside the frame, the square goes on where it is cut: no edge is expected there.
    inner = cv2.erode(whole, kernel, borderType=cv2.BORDER_REPLICATE) > 0
    first = cv2.dilate(whole, np.ones((3, 3), np.uint8))  # a blurred edge is neither dark nor light
    around = (cv2.dilate(first, kernel) > 0) & (first == 0)
    edge = (whole > 0) & ~inner
    return bool(
        np.count_nonzero(inner)
        and np.count_nonzero(around)
        and dark[edge].mean() >= EDGE_DARK
        and 1.0 - dark[inner].mean() >= INSIDE_LIGHT
        and 1.0 - dark[around].mean() >= MARGIN_LIGHT
    )
