"""Some stars anywhere in an image, and the directions of their grid, for images without a readable tag.

The module uses the rotational symmetry of a star: its brightness has n periods in a turn, with n half the number of
segments. It does not identify stars.

The response at a place is the magnitude of the n-th angular Fourier coefficient on a ring around it, so it is the same
for either contrast. It is largest at stars. Among the strongest places, one with four neighbours at the corners of a
square gives the directions of the grid.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from calib.arrays import Array, Array32
from calib.stars.growth import GrowthStart, search_stars
from calib.stars.template import SEARCH_RADII, StarTemplate

#: Pitches that are tried, px. Neighbouring ones are so close that a star responds to one of them.
PITCHES_PX = tuple(18.0 * 1.3**k for k in range(7))
#: The image is reduced until a pitch has this length, px.
SMALL_PITCH_PX = 18.0
#: Inner and outer radius of the ring of the response, pitches.
RING = (0.22, 0.46)
#: Least response of a candidate, 0 to 1, and largest number of candidates.
MIN_RESPONSE, MAX_CANDIDATES = 0.35, 400
#: Least response of a candidate that is tried first, as a share of the largest response.
STRONG = 0.75
#: The search over pitches ends if a pitch has less than the share `PAST` of the best pitch's total response, and that
#: is more than the share `MIN_SHARE` of the image's area.
PAST, MIN_SHARE = 0.5, 0.05
#: Largest distance of a neighbour from the corner of a square, pitches.
SQUARENESS = 0.2
#: Least correlation with their pattern of the first star and its neighbours.
MIN_CORRELATION = 0.5
#: Largest number of candidates that are tried in a group.
MAX_TRIED = 25


class _Candidates(NamedTuple):
    """Places with the largest responses at one pitch, the largest first.

    ``total`` is the sum of their squared responses times the squared pitch, px^2; ``scale`` is that of the reduced
    image; ``places`` are (M, 2) px of the reduced image; ``responses`` are (M,).
    """

    total: float
    scale: float
    places: Array
    responses: Array


def find_lattice(image: Array32, segments: int) -> GrowthStart | None:
    """Find a star with neighbours on all four sides, at either contrast, in a smoothed image; None if there is none.

    The response is a circular harmonic of the image (Hsu and Arsenault, 1982); the search for a square is own. The grid
    is
    relative: node (0, 0) is the star found, and the directions are those of the target up to quarter turns.
    """
    for found in _candidates_by_pitch(image, segments):
        # Stars respond more strongly than the corners of their cells, but not in all kinds of image.
        for some in (found.places[found.responses >= STRONG * found.responses[0]], found.places):
            for number in range(min(len(some), MAX_TRIED)):
                steps = _steps_to_neighbours(some, number)
                if steps is not None:
                    place = (some[number] + 0.5) / found.scale - 0.5
                    start = _confirmed_start(image, place, steps / found.scale, segments)
                    if start is not None:
                        return start
    return None


def _candidates_by_pitch(image: Array32, segments: int) -> list[_Candidates]:
    """Return the candidates of each pitch with five or more, the largest total (`_Candidates`, own) first."""
    found: list[_Candidates] = []
    for pitch in reversed(PITCHES_PX):  # the coarsest first, because it costs least
        scale = SMALL_PITCH_PX / pitch
        if scale * min(image.shape) < 3 * SMALL_PITCH_PX:
            continue
        places, responses = _peaks(_response(image, scale, segments))
        # At the right pitch, candidates respond most strongly in relation to the area that each of them covers.
        total = float((responses**2).sum()) * pitch**2
        if len(places) >= 5:
            found.append(_Candidates(total, scale, places, responses))
        best = max((c.total for c in found), default=0.0)
        if best > MIN_SHARE * image.size and total < PAST * best:
            break
    return sorted(found, key=lambda c: -c.total)


def _response(image: Array32, scale: float, segments: int) -> Array32:
    """Return the response of the reduced image at each place, 0 to 1.

    Magnitude of the mean of I exp(i n phi) over the ring (circular harmonic; Hsu and Arsenault, 1982). Own
    normalisation by the standard deviation of I there.
    """
    small = image if scale >= 1 else cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    reach = int(np.ceil(RING[1] * SMALL_PITCH_PX))
    x, y = np.meshgrid(np.arange(-reach, reach + 1.0), np.arange(-reach, reach + 1.0))
    radius, angle = np.hypot(x, y) / SMALL_PITCH_PX, np.arctan2(y, x)
    ring = ((radius >= RING[0]) & (radius <= RING[1])).astype(np.float32)
    ring /= ring.sum()
    kernels = [ring * wave(segments / 2 * angle) for wave in (np.cos, np.sin)]
    real, imaginary = (cv2.filter2D(small, cv2.CV_32F, k.astype(np.float32)) for k in kernels)
    mean, square = (cv2.filter2D(a, cv2.CV_32F, ring) for a in (small, small * small))
    spread = cv2.sqrt(np.maximum(square - mean * mean, 0.0))
    floor = 0.1 * float(np.quantile(spread, 0.95)) + 1e-12
    return np.asarray(cv2.magnitude(real, imaginary) / np.maximum(spread, np.float32(floor)), np.float32)


def _peaks(response: Array32) -> tuple[Array, Array]:
    """Return the (M, 2) places of the local maxima, the largest first, and their (M,) responses."""
    side = 2 * int(0.35 * SMALL_PITCH_PX) + 1
    greatest = cv2.dilate(response, np.ones((side, side), np.uint8))
    rows, columns = np.nonzero((response == greatest) & (response >= MIN_RESPONSE))
    heights = response[rows, columns]
    order = np.argsort(-heights, kind="stable")[:MAX_CANDIDATES]
    return np.column_stack([columns, rows])[order].astype(float), heights[order].astype(float)


def _steps_to_neighbours(places: Array, number: int) -> Array | None:
    """Return the steps to the right and lower neighbour, in columns; they are within `SQUARENESS` of a square."""
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


def _confirmed_start(image: Array32, place: Array, linear: Array, segments: int) -> GrowthStart | None:
    """Search the star and its four neighbours; return where growth starts if all have one contrast, else None.

    The corners of the cells respond too, although less strongly. If these were taken for neighbours, the true
    neighbours are diagonal to them, so both sets of directions are tried.
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
