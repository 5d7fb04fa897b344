"""From the first stars to all: growth over the grid, where the stars found predict their neighbours.

The order is outwards (Schöps et al., 2020, arXiv:1912.02908). `calib.stars.grid_map` predicts a star's place; around it
the place that correlates best with `calib.stars.template` is searched, in steps of one pixel.

Growth starts at the tag, or, in images without a readable tag, at some star anywhere. That star, and the directions of
its grid, are found by the rotational symmetry of a star: its brightness has n periods in a turn, with n half the number
of segments. The response at a place is the magnitude of the n-th angular Fourier coefficient on a ring around it, so it
is the same for either contrast. It is largest at stars. Among the strongest places, one with four neighbours at the
corners of a square gives the directions of the grid; without any such place, `calib.stars.period` gives them. It does
not identify stars.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import cv2
import numpy as np

from calib.arrays import Array, Array32, Bools, Ints
from calib.model.homography import apply_homography, fit_affine, fit_homography, linear_at
from calib.stars.beam import find_beam
from calib.stars.grid_map import predict_locally
from calib.stars.period import even_contrast, star_steps
from calib.stars.tag import TagDetection
from calib.stars.template import SEARCH_RADII, SHARP_CORRELATION, StarTemplate, correlations, values_at
from calib.target import StarTarget

#: Least correlation with its pattern of a star during growth, whose place is a whole pixel.
MIN_CORRELATION = 0.45
#: Radius of the search around a predicted star, pitches: for the first stars, and next to stars already found.
FIRST_REACH, REACH = 0.15, 0.08
#: Least distance of neighbouring stars, px: the outer ends of 16 segments are then 2 px wide.
MIN_PITCH_PX = 10.0
#: How often the pattern of a star is learnt from the first nodes, each time at places that are nearer to the stars.
LEARNING_ROUNDS = 3
#: How often a node is searched, each time with more neighbours that predict it.
MAX_TRIES = 3
#: Least number of points for a homography: the noise of fewer would bend it. From half of it on, an affine map is
#: fitted.
PERSPECTIVE_FROM = 16
_AROUND = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]

#: Pitches that are tried, px. Neighbouring ones are so close that a star responds to one of them.
PITCHES_PX = tuple(18.0 * 1.3**k for k in range(7))
#: The image is reduced until a pitch has this length, px.
SMALL_PITCH_PX = 18.0
#: Inner and outer radius of the ring of the response, pitches: further inside segments merge, further outside is the
#: next cell.
RING = (0.22, 0.46)
#: Least response of a candidate, 0 to 1, and largest number of candidates, which bounds the time.
MIN_RESPONSE, MAX_CANDIDATES = 0.35, 400
#: Least response of a candidate that is tried first, as a share of the largest response: corners of cells respond less.
STRONG = 0.75
#: The search over pitches ends if a pitch has less than the share `PAST` of the best pitch's total response, and that
#: is more than the share `MIN_SHARE` of the image's area.
PAST, MIN_SHARE = 0.5, 0.05
#: Largest distance of a neighbour from the corner of a square, pitches: the cells of a tilted target are no squares.
SQUARENESS = 0.2
#: Least correlation with their pattern of the first star and its neighbours, without the tag: more than during growth,
#: because all stars follow from these.
MIN_FIRST_CORRELATION = 0.5
#: Radius of the search for a star around any place if only the period is known, pitches: nearly half a cell's diagonal.
PERIOD_REACH = 0.6
#: Largest number of candidates that are tried in a group; it bounds the time in an image without stars.
MAX_TRIED = 25


def search_stars(
    image: Array32, guesses: Array, linear: Array, reach_px: Array, template: StarTemplate, sign: float
) -> tuple[Array, Array]:
    """Find the best place, px, of a star around each guess, in steps of one pixel, and its correlation, -1 to 1.

    Nan if no place lies sufficiently inside the image, (H, W) float32, smoothed. Guesses (N, 2), px; linear maps (N, 2,
    2), px per pitch; radii (N,), px; the sign is +1 if white is bright, else -1.
    """
    squares = reach_px**2 + 0.5
    farthest = squares.max(initial=0.0)
    steps = np.arange(-int(np.sqrt(farthest)), int(np.sqrt(farthest)) + 1)
    moves = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    moves = moves[(moves**2).sum(axis=1) <= farthest]
    places = template.places(guesses, linear).astype(np.float32)
    x, y = (at[:, None] + by[:, None] for at, by in zip(places, moves.T.astype(np.float32), strict=True))
    seen = values_at(image, x, y)
    score = sign * correlations(seen, template)
    score[(moves**2).sum(axis=1) > squares[:, None]] = np.nan
    best = np.where(np.isnan(score), -np.inf, score).argmax(axis=1)
    score = score[np.arange(len(score)), best]
    return np.where(np.isnan(score)[:, None], np.nan, guesses + moves[best]), score


@dataclass
class StarGrid:
    """Stars found so far, by their nodes."""

    # Image point, (2,) float64, px, of each node (column, row).
    points: dict[tuple[int, ...], Array] = field(default_factory=dict)

    def nodes(self) -> Ints:
        """Return the (N, 2) nodes, columns and rows, of the stars found."""
        return np.array(list(self.points), np.int64).reshape(-1, 2)

    def places(self) -> Array:
        """Return the stars found as (N, 2) image points, px, in the order of `nodes`."""
        return np.array(list(self.points.values()), np.float64).reshape(-1, 2)


class GrowthStart(NamedTuple):
    """Where growth starts."""

    # (3, 3) float64, from [column row 1] to [u v 1] px, right near the first nodes.
    homography: Array
    sign: float  # +1 if white is bright in the image, -1 if it is dark
    nodes: Ints  # (M, 2) int64, nodes that are searched first
    # (K, 2) float64, pitches: points known beforehand, which take part in all fits
    anchor_grid: Array = np.zeros((0, 2))
    anchor_px: Array = np.zeros((0, 2))  # (K, 2) float64, px: the same points in the image


def start_at_tag(tag: TagDetection, target: StarTarget) -> GrowthStart:
    """Start growth with the ring of stars around the tag."""
    corners = target.tag_corners_mm / target.pitch_mm
    low, high = corners[0].round().astype(np.int64) - 1, corners[2].round().astype(np.int64) + 1
    columns, rows = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    nodes = np.column_stack([columns.ravel(), rows.ravel()])
    ring = nodes[target.id_at(nodes[:, 0], nodes[:, 1]) >= 0]
    return GrowthStart(tag.homography, tag.sign, ring, corners, tag.corners_px)


def grow_star_grid(
    image: Array32, start: GrowthStart, segments: int, exists: Callable[[Ints], Bools]
) -> StarGrid:
    """Find the first stars, then those around them, until no more are found; none if the first nodes have no star.

    Growth of this kind is that of Schöps et al. (2020), arXiv:1912.02908. If the stars correlate badly with the sharp
    pattern, the pattern is learnt from the image, and growth starts again with it; the larger result is used. Stars are
    located to half a pixel, to two if out of focus. The image is smoothed; ``exists`` tells which (N, 2) nodes may be
    stars.
    """
    grown, scores = _grow(image, start, StarTemplate.of(segments, SEARCH_RADII), exists)
    if scores and np.median(scores) >= SHARP_CORRELATION:
        return grown
    learnt = _learn_at_start(image, start, StarTemplate.of(segments))
    if learnt is None:
        return grown
    again, _ = _grow(image, start, learnt, exists)
    return again if len(again.points) > len(grown.points) else grown


def _learn_at_start(image: Array32, start: GrowthStart, sharp: StarTemplate) -> StarTemplate | None:
    """Learn the pattern from the first nodes; None if they show no stars.

    Own procedure: each node's best place with the sharp pattern, then with the one learnt there, and so on.
    """
    grid = start.nodes.astype(float)
    at, linear = apply_homography(start.homography, grid), linear_at(start.homography, grid)
    reach = FIRST_REACH * np.sqrt(np.abs(np.linalg.det(linear)))
    template = sharp
    for _ in range(LEARNING_ROUNDS):
        places, score = search_stars(image, at, linear, reach, template, start.sign)
        seen = np.isfinite(score)
        learnt = sharp.learnt(image, places[seen], linear[seen], start.sign)
        if learnt is None:
            return None
        template = learnt
    return template


def _grow(
    image: Array32, start: GrowthStart, template: StarTemplate, exists: Callable[[Ints], Bools]
) -> tuple[StarGrid, list[float]]:
    """Grow the grid with one template; return it, and the correlations of its stars."""
    grown, tries = StarGrid(), Counter[tuple[int, ...]]()
    scores: list[float] = []
    h, wanted, reach = start.homography, start.nodes, FIRST_REACH
    while len(wanted):
        grid = wanted.astype(float)
        at = predict_locally(h, grown.nodes().astype(float), grown.places(), grid)
        linear = linear_at(h, grid)
        pitch = np.sqrt(np.abs(np.linalg.det(linear)))
        seen = (pitch >= MIN_PITCH_PX) & ((at >= 0) & (at < image.shape[::-1])).all(axis=1)
        places, score = search_stars(image, at[seen], linear[seen], reach * pitch[seen], template, start.sign)
        good = score >= MIN_CORRELATION
        if not good.any():
            break
        scores += score[good].tolist()
        new = wanted[seen][good]
        tries.update(map(tuple, wanted.tolist()))
        grown.points.update(zip(map(tuple, new.tolist()), places[good], strict=True))
        h = _refitted(h, start, grown)
        around = {(c + i, r + j) for c, r in new.tolist() for i, j in _AROUND}
        again = (node for node in around if node not in grown.points and tries[node] < MAX_TRIES)
        wanted = np.array(sorted(again), np.int64).reshape(-1, 2)
        wanted = wanted[exists(wanted)]
        reach = REACH
    return grown, scores


def _refitted(h: Array, start: GrowthStart, grown: StarGrid) -> Array:
    """Fit the homography again to the stars found and the anchors; with too few of them, return the old one."""
    grid = np.vstack([grown.nodes().astype(float), start.anchor_grid])
    places = np.vstack([grown.places(), start.anchor_px])
    if len(grid) >= PERSPECTIVE_FROM:
        return fit_homography(grid, places)
    return fit_affine(grid, places) if len(grid) >= PERSPECTIVE_FROM // 2 else h


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
    is relative: node (0, 0) is the star found, and the directions are those of the target up to quarter turns.
    """
    for candidate in _candidates_by_pitch(image, segments):
        # Stars respond more strongly than the corners of their cells, but not in all kinds of image.
        strong = candidate.places[candidate.responses >= STRONG * candidate.responses[0]]
        for some in (strong, candidate.places):
            for number in range(min(len(some), MAX_TRIED)):
                steps = _steps_to_neighbours(some, number)
                if steps is not None:
                    place = (some[number] + 0.5) / candidate.scale - 0.5
                    start = _confirmed_start(image, place, steps / candidate.scale, segments)
                    if start is not None:
                        return start
    return _start_by_period(image, segments)


def _start_by_period(image: Array32, segments: int) -> GrowthStart | None:
    """Return where growth may start if the image repeats itself, although no star's neighbours are candidates."""
    steps = star_steps(even_contrast(image))
    if steps is None:
        return None
    template = StarTemplate.of(segments, SEARCH_RADII)
    beam = find_beam(image)
    lit = np.argwhere(beam.lit)[:, ::-1] * beam.scale
    tried = lit[np.linspace(0, len(lit) - 1, MAX_TRIED).astype(int)]
    shapes = np.tile(steps, (len(tried), 1, 1))
    reach = np.full(len(tried), PERIOD_REACH * np.sqrt(abs(np.linalg.det(steps))))
    for sign in (1.0, -1.0):
        places, score = search_stars(image, tried, shapes, reach, template, sign)
        for place in places[score >= MIN_FIRST_CORRELATION]:
            start = _confirmed_start(image, place, steps, segments)
            if start is not None:
                return start
    return None


def _candidates_by_pitch(image: Array32, segments: int) -> list[_Candidates]:
    """Return the candidates of each pitch with five or more, the largest total (`_Candidates`, own) first."""
    candidates: list[_Candidates] = []
    for pitch in reversed(PITCHES_PX):  # the coarsest first, because it costs least
        scale = SMALL_PITCH_PX / pitch
        if scale * min(image.shape) < 3 * SMALL_PITCH_PX:
            continue
        places, responses = _peaks(_response(image, scale, segments))
        # At the right pitch, candidates respond most strongly in relation to the area that each of them covers.
        total = float((responses**2).sum()) * pitch**2
        if len(places) >= 5:
            candidates.append(_Candidates(total, scale, places, responses))
        best = max((c.total for c in candidates), default=0.0)
        if best > MIN_SHARE * image.size and total < PAST * best:
            break
    return sorted(candidates, key=lambda c: -c.total)


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
    steps = []
    for turned in (first, [-first[1], first[0]], -first, [first[1], -first[0]]):
        miss = np.linalg.norm(off - turned, axis=1)
        nearest = int(np.argmin(miss))
        if miss[nearest] > SQUARENESS * pitch:
            return None
        steps.append(off[nearest])
    right, down = (steps[0] - steps[2]) / 2.0, (steps[1] - steps[3]) / 2.0
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
            if (score >= MIN_FIRST_CORRELATION).all():
                homography = np.array([[*steps[0], at[0, 0]], [*steps[1], at[0, 1]], [0.0, 0.0, 1.0]])
                return GrowthStart(homography, sign, np.array([[0, 0]]))
    return None
