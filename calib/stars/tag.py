"""The target's AprilTag in an image: which way the target lies, roughly where, and with which contrast.

Knows the tag; nothing of stars. Reading the bits is OpenCV's work.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.errors import TargetNotFound
from calib.events.grey_image import to_uint8
from calib.target import TAG_MODULES, StarTarget

#: Correlation of a tag's modules with the print that it needs at least, of either sign.
MIN_CORRELATION = 0.5
#: Pictures stay at least this large when they are made smaller for the search, px.
SMALLEST_PICTURE_PX = 170
#: Perimeter of a tag as a share of the picture's longer side, at least: the stars' many corners are smaller.
MIN_PERIMETER = 0.12


@dataclass(frozen=True)
class TagDetection:
    """Where the tag lies.

    Attributes
    ----------
    homography
        (3, 3) maps [column row 1] of the target's grid of nodes to [u v 1] px, from the tag's corners alone.
    corners_px
        (4, 2) corners of the tag's border in the print's order (upper left, upper right, ...).
    sign
        +1 where white is bright in the image, -1 where it is dark.
    correlation
        Of the 8 x 8 modules with the print, 0 to 1.
    """

    homography: NDArray[np.float64]
    corners_px: NDArray[np.float64]
    sign: float
    correlation: float


def find_tag(image: NDArray[np.generic], target: StarTarget, *, name: str) -> TagDetection | None:
    """Find the target's own tag, at any roll and with either contrast.

    The image is tried smaller, blurred, as it is and median filtered, until the tag is seen.

    Parameters
    ----------
    image
        (H, W) of any integer or floating type.
    target
        Says which tag.
    name
        The view's name, for messages.

    Returns
    -------
    TagDetection or None
        None where no tag is seen.

    Raises
    ------
    TargetNotFound
        When the tag is there more than once, or another one is there in its place.
    """
    strangers: set[int] = set()
    for variant, scale in _variants(to_uint8(image)):
        seeds = []
        for corners, tag in _read_tags(variant, scale):
            seed = _judge(variant, scale, corners, target) if tag == target.tag_id else None
            if seed is None:
                strangers.add(tag)
            else:
                seeds.append(seed)
        if len(seeds) > 1:
            raise TargetNotFound(
                f"Tag {target.tag_id} of the target is seen {len(seeds)} times.",
                where=f"view {name}",
                remedy="Keep mirrors and second targets out of the image.",
            )
        if seeds:
            return seeds[0]
    if strangers - {target.tag_id}:
        others = ", ".join(map(str, sorted(strangers - {target.tag_id})))
        raise TargetNotFound(
            f"Tag {target.tag_id} of family 36h11 is not in the image; tags seen instead: {others}.",
            where=f"view {name}",
            remedy="Check that the target is the one described.",
        )
    return None


def _variants(picture: NDArray[np.uint8]) -> Iterator[tuple[NDArray[np.uint8], float]]:
    """Pictures to look at one after the other, and how many of their pixels make one of the image's."""
    for scale in (0.25, 0.5):
        if scale * min(picture.shape) >= SMALLEST_PICTURE_PX:
            smaller = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
            yield np.asarray(smaller, np.uint8), scale
    yield np.asarray(cv2.GaussianBlur(picture, (0, 0), 1.2), np.uint8), 1.0
    yield picture, 1.0
    yield np.asarray(cv2.medianBlur(picture, 5), np.uint8), 1.0
    yield np.asarray(cv2.GaussianBlur(cv2.medianBlur(picture, 5), (0, 0), 2.5), np.uint8), 1.0


def _read_tags(picture: NDArray[np.uint8], scale: float) -> Iterator[tuple[NDArray[np.float64], int]]:
    """Corners, in px of the full image, and numbers of all tags of the family."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.detectInvertedMarker = True
    parameters.minMarkerPerimeterRate = MIN_PERIMETER
    # Windows from about the smallest module to a quarter of the picture: larger modules are not hollow to it.
    parameters.adaptiveThreshWinSizeMin = 9
    parameters.adaptiveThreshWinSizeMax = max(23, min(picture.shape) // 8 | 1)
    parameters.adaptiveThreshWinSizeStep = max(10, (parameters.adaptiveThreshWinSizeMax - 9) // 2)
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    corners, tags, _ = cv2.aruco.ArucoDetector(family, parameters).detectMarkers(picture)
    for quad, tag in zip(corners, [] if tags is None else np.ravel(tags), strict=True):
        yield (np.asarray(quad, np.float64).reshape(4, 2) + 0.5) / scale - 0.5, int(tag)


def _judge(
    picture: NDArray[np.uint8], scale: float, corners: NDArray[np.float64], target: StarTarget
) -> TagDetection | None:
    """Compare the modules with the print; a seed where they agree, of either contrast."""
    nodes = target.tag_corners_mm / target.pitch_mm
    correlation = _modules_correlation(picture, scale, _homography(nodes, corners), target)
    if abs(correlation) < MIN_CORRELATION:
        return None
    sign = float(np.sign(correlation))
    corners = _sharpened(picture.astype(np.float32) * np.float32(sign), scale, corners)
    return TagDetection(_homography(nodes, corners), corners, sign, abs(correlation))


def _homography(nodes: NDArray[np.float64], corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 3) from four grid positions to four image points."""
    return np.asarray(
        cv2.getPerspectiveTransform(nodes.astype(np.float32), corners.astype(np.float32)), np.float64
    )


def _modules_correlation(
    picture: NDArray[np.uint8], scale: float, homography: NDArray[np.float64], target: StarTarget
) -> float:
    """Correlation of the middles of the 8 x 8 modules with the print."""
    left, top = target.tag_corners_mm[0] / target.pitch_mm
    middles = (np.arange(TAG_MODULES) + 0.5) * (target.tag_squares / TAG_MODULES)
    u, v = np.meshgrid(left + middles, top + middles)
    at = cv2.perspectiveTransform(np.column_stack([u.ravel(), v.ravel()])[None], homography)[0]
    seen = _values(picture.astype(np.float32), scale, at)
    if seen.std() == 0.0:
        return 0.0
    return float(np.corrcoef(seen, target.layout.tag_modules.ravel())[0, 1])


def _sharpened(
    picture: NDArray[np.float32], scale: float, corners: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Fit lines to the border's outer edges, black inside and white outside, and cut them with each other.

    The white ring is half a pitch wide and so is the black border: a module of the tag on either side.
    """
    module = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).mean() / TAG_MODULES
    offsets = np.linspace(-1.4, 1.4, 113) * module
    step = np.where(offsets < 0, -1.0, 1.0) * (np.abs(offsets) <= 0.6 * module)
    lines = []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = (end - start) / np.linalg.norm(end - start)
        outward = np.array([along[1], -along[0]])
        places = start + np.linspace(0.12, 0.88, 32)[:, None] * (end - start)
        profiles = _values(picture, scale, (places[:, None] + offsets[:, None] * outward).reshape(-1, 2))
        answers = np.array([np.convolve(p, step[::-1], "same") for p in profiles.reshape(32, -1)])
        inner = np.abs(offsets) <= 0.7 * module
        edges = places + offsets[inner][np.argmax(answers[:, inner], axis=1)][:, None] * outward
        vx, vy, x, y = np.ravel(cv2.fitLine(edges.astype(np.float32), cv2.DIST_HUBER, 0, 0.01, 0.01)).astype(
            float
        )
        lines.append(np.cross([x, y, 1.0], [x + vx, y + vy, 1.0]))
    cuts = np.array([np.cross(lines[i - 1], lines[i]) for i in range(4)])
    sharp = cuts[:, :2] / cuts[:, 2:]
    near = np.isfinite(sharp).all() and np.linalg.norm(sharp - corners, axis=1).max() < 1.5 * module
    return np.asarray(sharp, np.float64) if near else corners


def _values(picture: NDArray[np.float32], scale: float, at: NDArray[np.float64]) -> NDArray[np.float64]:
    """Bilinear values of a scaled picture at (N, 2) points of the full image."""
    points = ((at + 0.5) * scale - 0.5).astype(np.float32)
    return np.asarray(
        cv2.remap(picture, points[:, 0], points[:, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE),
        float,
    ).ravel()
