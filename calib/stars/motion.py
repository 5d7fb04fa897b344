"""How far the stars moved during a recording: the shifts of their windows between the images of its two halves.

The shift of a window is that of Lucas and Kanade (1981), in pyramids (Bouguet, 2000), by OpenCV. A pixel of an event
image has fired or not, so the edges of the stars are steps on the pixel grid, which no interpolation follows: a shift
comes out too small. So the images are smoothed first, and the shift is the mean of the way forth and the way back,
whose errors are opposite.
"""

from __future__ import annotations

import cv2
import numpy as np

from calib.arrays import AnyArray, Array, Array32, Bools, Bytes
from calib.errors import TooFewStars
from calib.events.grey_image import to_uint8
from calib.model.homography import fit_homography, linear_at
from calib.target import StarTarget
from calib.view import View

Halves = tuple[AnyArray, AnyArray]
"""Images of the first and the second half of a recording, (H, W) each."""
#: Least number of stars that both halves must show: the median of eight bears three wrong ones.
MIN_COMMON = 8
#: Most stars that are followed: time grows with their number.
MOST_STARS = 300
#: Side of the square that is followed around each star, pitches: the whole star, and its rim.
FOLLOWED_PITCHES = 1.3
#: Largest shift of a star, pitches. Further away its neighbour's cell would take part.
MAX_SHIFT_PITCHES = 0.25
#: Largest difference between the way forth and the way back, pitches: with more, the halves show different things.
MAX_APART_PITCHES = 0.03
#: Smoothing of the images after they were halved, px of the halved image: 2 px. With 1 to 4 px, shifts are as right.
SMOOTHING_PX = 1.0
#: Number of times the image is halved again, for large shifts; and when a search ends: steps, or px, half of the error
#: that a shift has anyway.
LEVELS, STEPS, LAST_STEP_PX = 1, 10, 0.005


def shift_between_halves(first: AnyArray, second: AnyArray, view: View, target: StarTarget) -> Array:
    """Return the median shift, (2,) px, of the stars of a view between the images, (H, W), of its recording's halves.

    It is right to .01 px for shifts up to 1 px (`tests/validation/test_star_motion.py`).
    Raises TooFewStars if fewer than `MIN_COMMON` stars are found in both.
    """
    some = slice(None, None, -(-len(view.ids) // MOST_STARS))
    nodes = target.node_of(view.ids).astype(float)
    cells = linear_at(fit_homography(nodes, view.points_px), nodes)
    pitch_px = float(np.median(np.sqrt(np.abs(np.linalg.det(cells)))))
    small, other = _small(first), _small(second)
    # Pixel centres are at integers, so those of a halved image lie between two of the whole one.
    points = np.ascontiguousarray((view.points_px[some] - 0.5) / 2.0, np.float32)
    side_px = int(FOLLOWED_PITCHES * pitch_px / 2.0) | 1  # odd
    there, found_there = _followed(small, other, points, side_px)
    back, found_back = _followed(other, small, points, side_px)
    shifts, apart = there - back, 2.0 * (there + back - 2.0 * points)
    common = found_there & found_back & (np.hypot(*apart.T) <= MAX_APART_PITCHES * pitch_px)
    common &= np.hypot(*shifts.T) <= MAX_SHIFT_PITCHES * pitch_px
    if np.count_nonzero(common) < MIN_COMMON:
        raise TooFewStars(
            f"The halves of the recording share {np.count_nonzero(common)} stars; {MIN_COMMON} are needed.",
            where=f"view {view.name}",
            remedy="Record for longer.",
        )
    return np.asarray(np.median(shifts[common], axis=0), np.float64)


def _small(image: AnyArray) -> Bytes:
    """Return an image, (H, W), in 8 bits, halved and smoothed."""
    grey = image if image.dtype == np.uint8 else to_uint8(image)
    half = cv2.resize(np.asarray(grey, np.uint8), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.GaussianBlur(half, (0, 0), SMOOTHING_PX), np.uint8)


def _followed(image: Bytes, other: Bytes, points: Array32, side_px: int) -> tuple[Array32, Bools]:
    """Find (N, 2) points, px, of an image in another one by the windows around them, and return which were found."""
    ends = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, STEPS, LAST_STEP_PX)
    seen, status, _ = cv2.calcOpticalFlowPyrLK(
        image,
        other,
        points,
        np.zeros_like(points),
        winSize=(side_px, side_px),
        maxLevel=LEVELS,
        criteria=ends,
    )
    return np.asarray(seen, np.float32), np.asarray(status[:, 0] == 1)
