"""The target's AprilTag in an image: its corners, the orientation of the target, and the contrast.

OpenCV's ArUco detector (Garrido-Jurado et al. 2014) finds and decodes the AprilTags (Olson 2011) of the target's
family. A dark square on light says where a tag probably is that cannot be read; it serves to aim, and no star gets an
id by it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.arrays import AnyArray, Array, Array32, Bools, Bytes
from calib.errors import TargetNotFound
from calib.model.homography import fit_homography
from calib.stars.beam import Beam, reduced
from calib.target import StarTarget

#: Least correlation of a tag's modules with the print, of either sign.
MIN_CORRELATION = 0.5
#: Least width and height of a reduced picture, px.
MIN_PICTURE_PX = 170
#: Least perimeter of a tag, as a share of the picture's longer side. The many corners of stars are smaller.
MIN_PERIMETER = 0.12
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

_NORMALS: dict[Border, Array] = {
    "left": np.array([-1.0, 0.0]),
    "right": np.array([1.0, 0.0]),
    "upper": np.array([0.0, -1.0]),
    "lower": np.array([0.0, 1.0]),
}


@dataclass(frozen=True)
class TagDetection:
    """The target's tag in an image."""

    # (3, 3) float64, from [column row 1] of the target's grid of nodes to [u v 1] px, from the four corners.
    homography: Array
    # (4, 2) float64, px, corners of the tag's border in the order of the print (upper left, upper right,
    # ...).
    corners_px: Array
    sign: float  # +1 if white is bright in the image, -1 if it is dark
    correlation: float  # Correlation of the modules with the print, 0 to 1


def find_tag(picture: Bytes, target: StarTarget, *, reduced_only: bool = False) -> TagDetection | None:
    """Find the target's tag, at any roll and with either contrast; None if the picture shows no tag.

    The picture is one of `calib.events.grey_image.to_uint8`. The detector (Garrido-Jurado et al., 2014; tags: Olson,
    2011) gets it reduced, blurred, unchanged and median filtered, until it finds the tag. With ``reduced_only`` it gets
    only the reduced pictures, which takes a fifth of the time, if the image is large enough for any; other tags in them
    are then no reason to refuse the image.
    Raises TargetNotFound: If the image shows the tag more than once, or only another tag.
    """
    others: set[int] = set()
    reduced = False
    for variant, scale in _variants(picture):
        if reduced_only and reduced and scale == 1.0:
            return None
        reduced |= scale < 1.0
        detections = []
        for corners, tag in read_tags(variant, scale, target.tag_family):
            seen = target if tag == target.tag_id else replace(target, tag_id=tag)
            detection = _verified(variant, scale, corners, seen)
            if detection is not None and seen is target:
                detections.append(detection)
            elif detection is not None:
                others.add(tag)
        if len(detections) > 1:
            raise TargetNotFound(
                f"Tag {target.tag_id} of the target is seen {len(detections)} times.",
                remedy="Keep mirrors and second targets out of the image.",
            )
        if detections:
            return detections[0]
    if others:
        raise TargetNotFound(
            f"Tag {target.tag_id} of family {target.tag_family} is not in the image; tags seen instead: "
            f"{', '.join(map(str, sorted(others)))}.",
            remedy="Check that the target is the one described.",
        )
    return None


def _variants(picture: Bytes) -> Iterator[tuple[Bytes, float]]:
    """Yield the pictures that the detector gets, in their order, and the scale of each relative to the image."""
    for scale in (0.25, 0.5):
        if scale * min(picture.shape) >= MIN_PICTURE_PX:
            smaller = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
            yield np.asarray(smaller, np.uint8), scale
    yield np.asarray(cv2.GaussianBlur(picture, (0, 0), 1.2), np.uint8), 1.0
    yield picture, 1.0
    yield np.asarray(cv2.medianBlur(picture, 5), np.uint8), 1.0
    yield np.asarray(cv2.GaussianBlur(cv2.medianBlur(picture, 5), (0, 0), 2.5), np.uint8), 1.0


def read_tags(picture: Bytes, scale: float, family: str) -> Iterator[tuple[Array, int]]:
    """Yield the (4, 2) corners, px of the full image, and the number of each tag of the family."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.detectInvertedMarker = True
    parameters.minMarkerPerimeterRate = MIN_PERIMETER
    # Windows of the adaptive threshold: from about the smallest module to an eighth of the picture.
    parameters.adaptiveThreshWinSizeMin = 9
    parameters.adaptiveThreshWinSizeMax = max(23, min(picture.shape) // 8 | 1)
    parameters.adaptiveThreshWinSizeStep = max(10, (parameters.adaptiveThreshWinSizeMax - 9) // 2)
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_APRILTAG_{family}"))
    corners, tags, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(picture)
    for quad, tag in zip(corners, [] if tags is None else np.ravel(tags), strict=True):
        yield (np.asarray(quad, np.float64).reshape(4, 2) + 0.5) / scale - 0.5, int(tag)


def _verified(picture: Bytes, scale: float, corners: Array, target: StarTarget) -> TagDetection | None:
    """Compare the modules with the print; return the detection, with refined corners, if they agree, else None."""
    nodes = target.tag_corners_mm / target.pitch_mm
    correlation = modules_correlation(picture, scale, fit_homography(nodes, corners), target)
    if abs(correlation) < MIN_CORRELATION:
        return None
    sign = float(np.sign(correlation))
    corners = _refined_corners(picture.astype(np.float32) * np.float32(sign), scale, corners, target)
    return TagDetection(fit_homography(nodes, corners), corners, sign, abs(correlation))


def modules_correlation(picture: AnyArray, scale: float, homography: Array, target: StarTarget) -> float:
    """Return Pearson's correlation, -1 to 1, of the modules' centres with the print; 0 if they are all equally bright.

    The picture is at some scale; the homography is from [column row 1] of the target's grid to px of the full image.
    """
    left, top = target.tag_corners_mm[0] / target.pitch_mm
    middles = (np.arange(target.tag_modules) + 0.5) * (target.tag_squares / target.tag_modules)
    u, v = np.meshgrid(left + middles, top + middles)
    at = cv2.perspectiveTransform(np.column_stack([u.ravel(), v.ravel()])[None], homography)[0]
    seen = _values(np.asarray(picture, np.float32), scale, at)
    if seen.std() == 0.0:
        return 0.0
    return float(np.corrcoef(seen, target.tag_print.ravel())[0, 1])


def _refined_corners(picture: Array32, scale: float, corners: Array, target: StarTarget) -> Array:
    """Fit lines to the outer edges of the border, and return their (4, 2) intersections; old corners if these are far.

    The edge is black inside, over the border of one module, and white outside, over the ring of half a square. The
    profiles are as long as the narrower of the two. Own procedure: a step filter finds the edge on each profile. Lines
    through points and their intersections are cross products (Hartley and Zisserman, 2004, section 2.2).
    """
    side = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).mean()
    clear = side / max(target.tag_modules, 2 * target.tag_squares)
    offsets = np.linspace(-1.4, 1.4, 113) * clear
    step = np.where(offsets < 0, -1.0, 1.0) * (np.abs(offsets) <= 0.6 * clear)
    lines = []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = (end - start) / np.linalg.norm(end - start)
        outward = np.array([along[1], -along[0]])
        # Not near the corners, where a profile would cross two edges.
        places = start + np.linspace(0.12, 0.88, 32)[:, None] * (end - start)
        profiles = _values(picture, scale, (places[:, None] + offsets[:, None] * outward).reshape(-1, 2))
        answers = np.array([np.convolve(p, step[::-1], "same") for p in profiles.reshape(32, -1)])
        inner = np.abs(offsets) <= 0.7 * clear
        edges = places + offsets[inner][np.argmax(answers[:, inner], axis=1)][:, None] * outward
        line = cv2.fitLine(edges.astype(np.float32), cv2.DIST_HUBER, 0, 0.01, 0.01)
        vx, vy, x, y = np.ravel(line).astype(float)
        lines.append(np.cross([x, y, 1.0], [x + vx, y + vy, 1.0]))
    cuts = np.array([np.cross(lines[i - 1], lines[i]) for i in range(4)])
    sharp = cuts[:, :2] / cuts[:, 2:]
    near = np.isfinite(sharp).all() and np.linalg.norm(sharp - corners, axis=1).max() < 1.5 * clear
    return np.asarray(sharp, np.float64) if near else corners


def _values(picture: Array32, scale: float, at: Array) -> Array:
    """Return the bilinear values, (N,), of a scaled picture at (N, 2) points of the full image."""
    x, y = np.ascontiguousarray(((at + 0.5) * scale - 0.5).T, np.float32)
    seen = cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(seen, float).ravel()


class DarkSquare(NamedTuple):
    """A dark square that looks like a tag."""

    # Centre (column, row), px, of the whole square; it may lie outside the frame.
    centre_px: tuple[float, float]
    side_px: float  # Side of the whole square, px
    borders: tuple[Border, ...]


def find_dark_square(image: AnyArray, beam: Beam, *, side_px: float | None = None) -> DarkSquare | None:
    """Find the largest dark square with a dark edge, light inside and light around it; None if there is none.

    Own procedure: connected dark parts of the reduced image, compared with their smallest rectangle (OpenCV's
    ``minAreaRect``, rotating calipers of Toussaint, 1983). ``side_px`` is the expected side of the tag, if it is known.
    """
    small, scale = reduced(image, REDUCED)
    white = float(np.quantile(small, 0.98))
    if white <= 0.0 or beam.share <= 0.0:
        return None
    lit = cv2.resize(beam.lit, small.shape[::-1], interpolation=cv2.INTER_NEAREST) > 0
    dark = (small < DARK * white) & lit
    expected = side_px / scale if side_px is not None else None
    count, parts, stats, _ = cv2.connectedComponentsWithStats(dark.astype(np.uint8), connectivity=8)
    longest = stats[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].max(axis=1)
    large = [part for part in range(1, count) if longest[part] >= SIDES[0] * REDUCED]
    for part in sorted(large, key=lambda label: -int(longest[label])):
        square = _square((parts == part).astype(np.uint8), dark, expected)
        if square is not None:
            (x, y), side, borders = square
            return DarkSquare(((x + 0.5) * scale - 0.5, (y + 0.5) * scale - 0.5), side * scale, borders)
    return None


def _square(
    part: Bytes, dark: Bools, expected: float | None
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


def _borders(points: NDArray[Any], shape: tuple[int, ...]) -> tuple[Border, ...]:
    """Return the borders of the frame that points lie at, to two cells."""
    (left, upper), (right, lower) = points.min(axis=0), points.max(axis=0)
    room = (left, shape[1] - 1 - right, upper, shape[0] - 1 - lower)
    return tuple(border for border, cells in zip(_NORMALS, room, strict=True) if cells <= 2)


def _is_tag_like(whole: Bytes, dark: Bools, side: float) -> bool:
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
