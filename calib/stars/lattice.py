"""Some stars anywhere in an image, and the grid they stand on, where no tag tells it.

Knows that a star's brightness turns eight times (half its segments) about its centre; nothing of which star is
which. The response to z -> exp(-i n theta) on a ring, n half the segments, is greatest at stars, for white and for
black alike; of the greatest ones, one whose four neighbours stand square to it gives the grid's directions.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.stars.centring import SEARCH_RADII, StarTemplate, search_stars
from calib.stars.growth import GrowthStart

#: Pitches tried, px; neighbouring ones differ by little enough for a star to answer to one of them.
PITCHES_PX = tuple(18.0 * 1.3**k for k in range(7))
#: The image is made smaller until a pitch is this long, px.
SMALL_PITCH_PX = 18.0
#: Ring of the response, in pitches.
RING = (0.22, 0.46)
#: Response, 0 to 1, from which a place is looked at, and how many places at most.
MIN_RESPONSE, MAX_PLACES = 0.35, 400
#: Share of the greatest response from which a place is surely a star.
STRONG = 0.75
#: Finer pitches are not tried once one answers less than this share of the best, and the best covers at least
#: that share of the image.
PAST, MIN_SHARE = 0.5, 0.05
#: How far neighbours may stand from a square, in pitches.
SQUARENESS = 0.2
#: Correlation with their print that the first star and its neighbours need.
MIN_CORRELATION = 0.5
#: How many places are tried.
TRIED = 25


def find_lattice(image: NDArray[np.float32], segments: int) -> GrowthStart | None:
    """Find a star with neighbours on all four sides; None where there is none.

    Parameters
    ----------
    image
        (H, W), smoothed; of either contrast.
    segments
        Segments of a star.

    Returns
    -------
    GrowthStart
        Relative: node (0, 0) is the star found, the directions are the grid's up to quarter turns.
    """
    answers: list[tuple[float, float, NDArray[np.float64], NDArray[np.float64]]] = []
    for pitch in reversed(PITCHES_PX):  # coarse first: it costs least
        scale = SMALL_PITCH_PX / pitch
        if scale * min(image.shape) < 3 * SMALL_PITCH_PX:
            continue
        places, heights = _peaks(_response(image, scale, segments))
        # Places at the right pitch answer most strongly, for the area that each covers.
        answer = float((heights**2).sum()) * pitch**2
        if len(places) >= 5:
            answers.append((answer, scale, places, heights))
        best = max((a[0] for a in answers), default=0.0)
        if best > MIN_SHARE * image.size and answer < PAST * best:
            break
    for _, scale, places, heights in sorted(answers, key=lambda a: -a[0]):
        # Stars answer more than the corners of their cells, but not in all kinds of image.
        for some in (places[heights >= STRONG * heights[0]], places):
            for number in range(min(len(some), TRIED)):
                directions = _square(some, number)
                if directions is not None:
                    at = (some[number] + 0.5) / scale - 0.5
                    start = _confirmed(image, at, directions / scale, segments)
                    if start is not None:
                        return start
    return None


def _response(image: NDArray[np.float32], scale: float, segments: int) -> NDArray[np.float32]:
    """How much the image turns like a star about each place, 0 to 1."""
    small = image if scale >= 1 else cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    reach = int(np.ceil(RING[1] * SMALL_PITCH_PX))
    x, y = np.meshgrid(np.arange(-reach, reach + 1.0), np.arange(-reach, reach + 1.0))
    radius, angle = np.hypot(x, y) / SMALL_PITCH_PX, np.arctan2(y, x)
    ring = ((radius >= RING[0]) & (radius <= RING[1])).astype(np.float32)
    ring /= ring.sum()
    turning = [ring * wave(segments / 2 * angle) for wave in (np.cos, np.sin)]
    real, imaginary = (cv2.filter2D(small, cv2.CV_32F, k.astype(np.float32)) for k in turning)
    mean, square = (cv2.filter2D(a, cv2.CV_32F, ring) for a in (small, small * small))
    spread = np.sqrt(np.maximum(square - mean * mean, 0.0))
    floor = 0.1 * float(np.quantile(spread, 0.95)) + 1e-12
    return np.asarray(np.hypot(real, imaginary) / np.maximum(spread, floor), np.float32)


def _peaks(response: NDArray[np.float32]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(M, 2) places of the greatest responses, the greatest first, and (M,) how great."""
    side = 2 * int(0.35 * SMALL_PITCH_PX) + 1
    greatest = cv2.dilate(response, np.ones((side, side), np.uint8))
    rows, columns = np.nonzero((response == greatest) & (response >= MIN_RESPONSE))
    heights = response[rows, columns]
    order = np.argsort(-heights, kind="stable")[:MAX_PLACES]
    return np.column_stack([columns, rows])[order].astype(float), heights[order].astype(float)


def _square(places: NDArray[np.float64], number: int) -> NDArray[np.float64] | None:
    """(2, 2) columns: steps to the right and the lower neighbour, where four neighbours stand square."""
    off = places - places[number]
    distance = np.linalg.norm(off, axis=1)
    distance[number] = np.inf
    first = off[np.argmin(distance)]
    pitch = float(np.linalg.norm(first))
    if not 0.6 * SMALL_PITCH_PX < pitch < 1.6 * SMALL_PITCH_PX:
        return None
    found = []
    for turned in (first, [-first[1], first[0]], -first, [first[1], -first[0]]):
        miss = np.linalg.norm(off - turned, axis=1)
        nearest = int(np.argmin(miss))
        if miss[nearest] > SQUARENESS * pitch:
            return None
        found.append(off[nearest])
    right, down = (found[0] - found[2]) / 2.0, (found[1] - found[3]) / 2.0
    return np.column_stack([right, down])


def _confirmed(
    image: NDArray[np.float32], place: NDArray[np.float64], linear: NDArray[np.float64], segments: int
) -> GrowthStart | None:
    """Look for the star and its four neighbours; where they are there, with one contrast, growth can begin.

    The corners of the cells answer as well, if less: where they were taken for neighbours, these stand diagonally.
    """
    template = StarTemplate.of(segments, SEARCH_RADII)
    for steps in (linear, linear @ np.array([[1.0, -1.0], [1.0, 1.0]])):
        around = np.array([[0.0, 0.0], *steps.T, *-steps.T])
        shapes = np.tile(steps, (len(around), 1, 1))
        reach = np.full(len(around), max(2.0, 0.1 * np.sqrt(abs(np.linalg.det(steps)))))
        for sign in (1.0, -1.0):
            at, score = search_stars(image, place + around, shapes, reach, template, sign)
            if (score >= MIN_CORRELATION).all():
                homography = np.array([[*steps[0], at[0, 0]], [*steps[1], at[0, 1]], [0.0, 0.0, 1.0]])
                empty = np.zeros((0, 2))
                return GrowthStart(homography, sign, np.array([[0, 0]]), empty, empty)
    return None
