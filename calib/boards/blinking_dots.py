"""Blinking dots in a recording of events: each dot is known by the frequency at which it blinks.

Neighbouring pixels of one frequency are a dot. Dots whose frequencies occur once are named by them, so that a part of
the board is enough; with few frequencies the grid names the dots, and the frequencies say which end is which. Symmetry
locates the centres in an image of how strongly each pixel blinks, with the curvature of perspective
(`calib.boards.detect.locate_points`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from calib.arrays import Array, Array32, Bytes, EventArrays, Ints
from calib.boards.board import Board
from calib.boards.detect import find_points, located_view
from calib.errors import FlickerNotFound, TargetNotFound, TooFewEvents, placed
from calib.model.homography import apply_homography
from calib.model.local_consistency import local_spacing
from calib.view import View

#: Ratios of the camera's clock to that of the dots that are tried: clocks of cheap controllers err by up to 3 %.
_CLOCK_RATIOS = np.linspace(0.97, 1.03, 301)
#: A frequency agrees with that of a dot if it differs by less than this share while the ratio is sought.
_CLOSE = 5e-4
#: A pixel belongs to a frequency if it differs by less than this share, and by less than half the step to the next one.
_MOST_OFF = 0.02
#: Fewest pixels that blink, and fewest of a dot.
_FEWEST_PIXELS, _SMALLEST_DOT = 20, 5
#: A dot has at least this share of the median dot's pixels.
_SMALLEST_SHARE = 0.1
#: At least this share of the dots must be seen if each has its own frequency; and of a board with few frequencies.
_LEAST_SEEN, _LEAST_OF_GRID = 0.5, 0.9
#: A dot may lie this far from its place on the plane that the others show, pitches.
_MOST_OFF_PLANE = 0.25
#: Share of the frequencies that two places share if there are two boards.
_SHARED_BY_TWO = 0.5
#: A second place of a frequency counts if it has this share of the first one's pixels.
_SECOND_AREA = 0.4
_SAMPLED = 20_000
#: Distance of the dots in the picture that is drawn for OpenCV, px, and its largest side.
_DRAWN_PITCH, _LARGEST_PICTURE = 48, 8000


class _Dots(NamedTuple):
    """Places that blink: the index of the frequency, the centre, px, and the number of pixels of each."""

    kind: Ints
    centres: Array
    areas: Ints


class _Named(NamedTuple):
    """Dots with their ids, and the map of the grid to the image."""

    ids: Ints
    centres: Array
    homography: Array


def detect_blinking_dots(
    t_us: Ints,
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    p: Bytes,
    size: tuple[int, int],
    board: Board,
    *,
    name: str = "view",
    keep_image: Callable[[Array32], None] = lambda _image: None,
) -> View:
    """Detect blinking dots as a view; with one frequency a dot, half of the dots are enough.

    Events are (N,), in the order of their times, us; polarity 1 is ON. ``keep_image`` is called with the (H, W) image
    of how strongly each pixel blinks.
    Raises TooFewEvents: If the recording is too short for the slowest dot, or has no events.
    Raises FlickerNotFound: If nothing blinks, or at other frequencies.
    Raises TargetNotFound: If the dots do not form the board; says what was found instead.
    """
    with placed(f"view {name}"):
        _require_long_enough(t_us, board)
        events = (t_us, x, y, p)
        seen_hz = blink_frequencies(events, size)
        frequencies, kind_of_dot = np.unique(board.frequencies_hz, return_inverse=True)
        ratio = _clock_ratio(seen_hz, frequencies)
        kinds = _kind_of_pixels(seen_hz, ratio * frequencies)
        dots = _dots(kinds, len(frequencies))
        unique = len(frequencies) == len(kind_of_dot)
        _require_dots(dots, seen_hz, ratio * frequencies, board)
        if unique:
            _refuse_two_boards(dots)
            named = _named_by_frequency(dots, kind_of_dot, board)
        else:
            named = _named_by_grid(dots, kind_of_dot, board)
        named = _wholly_in_view(named, board, size)
        _require_enough(named, board, size, _LEAST_SEEN if unique else _LEAST_OF_GRID)
        image = _blinking_image(events, size, named, ratio * np.array(board.frequencies_hz))
        keep_image(image)
        remedy = "Focus the lens, and hold the board still; come nearer if the dots are smaller than 5 px."
        return located_view(image, named.centres, board, named.ids, name, remedy)


def _require_long_enough(t_us: Ints, board: Board) -> None:
    """Refuse a recording in which the slowest dot does not blink often enough."""
    if len(t_us) == 0:
        raise TooFewEvents("The recording has no events.", remedy="Take off the lens cap.")
    span_s, slowest = 1e-6 * float(t_us[-1] - t_us[0]), min(board.frequencies_hz)
    needed_s = (LEAST_STARTS + 1) / slowest
    if span_s < needed_s:
        raise TooFewEvents(
            f"The recording of {1e3 * span_s:.0f} ms is too short for a dot of {slowest:g} Hz.",
            remedy=f"Record at least {1e3 * needed_s:.0f} ms; {1e3 * 3 * needed_s:.0f} ms are better (window_ms).",
        )


def _clock_ratio(seen_hz: Array, frequencies: Array) -> float:
    """Return the ratio of the frequencies seen to those of the board: that with which most pixels agree."""
    seen = seen_hz[np.isfinite(seen_hz)]
    if len(seen) < _FEWEST_PIXELS:
        raise FlickerNotFound(
            f"Nothing in view blinks regularly: {len(seen)} pixels do.",
            remedy="Switch on the dots, focus the lens, and take off the lens cap.",
        )
    seen = np.sort(seen)[:: max(1, len(seen) // _SAMPLED)]
    agree = [
        np.count_nonzero(np.abs(seen / _nearest(seen, ratio * frequencies)[1] - 1.0) < _CLOSE)
        for ratio in _CLOCK_RATIOS
    ]
    best = np.flatnonzero(np.array(agree) >= 0.98 * max(agree))
    return float(_CLOCK_RATIOS[best[np.argmin(np.abs(_CLOCK_RATIOS[best] - 1.0))]])


def _nearest(values: Array, frequencies: Array) -> tuple[Ints, Array]:
    """Return for each value the index of the nearest of rising frequencies, and that frequency."""
    above = np.clip(np.searchsorted(frequencies, values), 1, len(frequencies) - 1)
    index = above - (values - frequencies[above - 1] < frequencies[above] - values)
    return index, frequencies[index]


def _kind_of_pixels(seen_hz: Array, frequencies: Array) -> NDArray[np.int32]:
    """Return (H, W) the index of each pixel's frequency; -1 where it has none of them."""
    seen = np.nan_to_num(seen_hz, nan=0.0)
    index, nearest = _nearest(seen, frequencies)
    steps = np.diff(frequencies)
    room = np.minimum(np.append(steps, np.inf), np.insert(steps, 0, np.inf))
    allowed = np.minimum(0.5 * room, _MOST_OFF * frequencies)
    return np.where(np.abs(seen - nearest) <= allowed[index], index, -1).astype(np.int32)


def _dots(kinds: NDArray[np.int32], count: int) -> _Dots:
    """Return the places where neighbouring pixels have one frequency; specks are left out."""
    found: list[tuple[int, float, float, int]] = []
    present = np.unique(kinds[kinds >= 0])
    for kind in present[present < count].tolist():
        rows, columns = np.nonzero(kinds == kind)
        top, left = int(rows.min()), int(columns.min())
        mask = np.zeros((int(rows.max()) - top + 3, int(columns.max()) - left + 3), np.uint8)
        mask[rows - top + 1, columns - left + 1] = 1
        closed = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
        _, _, stats, centres = cv2.connectedComponentsWithStats(closed, connectivity=8)
        for area, (cx, cy) in zip(stats[1:, cv2.CC_STAT_AREA].tolist(), centres[1:].tolist(), strict=True):
            if area >= _SMALLEST_DOT:
                found.append((kind, cx + left - 1, cy + top - 1, area))
    table = np.array(found, np.float64).reshape(-1, 4)
    largest = [table[table[:, 0] == kind, 3].max() for kind in np.unique(table[:, 0])]
    if largest:
        table = table[table[:, 3] >= _SMALLEST_SHARE * float(np.median(largest))]
    return _Dots(table[:, 0].astype(np.int64), table[:, 1:3], table[:, 3].astype(np.int64))


def _require_dots(dots: _Dots, seen_hz: Array, frequencies: Array, board: Board) -> None:
    """Refuse a view in which hardly any place blinks at the board's frequencies."""
    seen = seen_hz[np.isfinite(seen_hz)]
    _, nearest = _nearest(seen, frequencies)
    matched = np.count_nonzero(np.abs(seen / nearest - 1.0) < _MOST_OFF)
    if len(dots.kind) >= 4 and matched >= 0.3 * len(seen):
        return
    low, high = np.quantile(seen, [0.02, 0.98])
    raise FlickerNotFound(
        f"What blinks in view does so at {low:.4g} to {high:.4g} Hz; the {board.words} has "
        f"{min(board.frequencies_hz):g} to {max(board.frequencies_hz):g} Hz.",
        remedy="Correct the frequencies in the description of the board, or cover lamps and screens in view.",
    )


def _refuse_two_boards(dots: _Dots) -> None:
    """Refuse a view in which many frequencies are seen at two places."""
    doubled = 0
    for kind in np.unique(dots.kind):
        areas = np.sort(dots.areas[dots.kind == kind])
        doubled += len(areas) > 1 and areas[-2] >= _SECOND_AREA * areas[-1]
    if doubled >= _SHARED_BY_TWO * len(np.unique(dots.kind)):
        raise TargetNotFound(
            f"{doubled} frequencies are seen at two places: there are two boards, or a mirror.",
            remedy="Leave only one in view.",
        )


def _named_by_frequency(dots: _Dots, kind_of_dot: Ints, board: Board) -> _Named:
    """Name each dot by its own frequency, and leave out what does not lie on the plane of the others."""
    id_of_kind = np.argsort(kind_of_dot)
    ids = id_of_kind[dots.kind]
    order = np.argsort(-dots.areas, kind="stable")
    first = order[np.unique(ids[order], return_index=True)[1]]
    h = _plane(board, ids[first], dots.centres[first])
    off = np.linalg.norm(apply_homography(h, board.nodes[ids].astype(float)) - dots.centres, axis=1)
    near = np.flatnonzero(off < _MOST_OFF_PLANE * local_spacing(dots.centres[first]))
    near = near[np.argsort(off[near], kind="stable")]
    kept = near[np.unique(ids[near], return_index=True)[1]]
    return _Named(ids[kept], dots.centres[kept], h)


def _named_by_grid(dots: _Dots, kind_of_dot: Ints, board: Board) -> _Named:
    """Name the dots by their grid; the frequencies say which of its corners is the first."""
    best: tuple[int, Ints] = (0, np.zeros(0, np.int64))
    for size in {(board.columns, board.rows), (board.rows, board.columns)}:
        grid = _grid_of_dots(dots.centres, size)
        if grid is None:
            continue
        # OpenCV may start at any corner, and may count the columns from either side.
        columns = slice(None, None, 1 if _seen_from_front(dots.centres[grid]) else -1)
        for turned in (np.rot90(grid, quarter)[:, columns] for quarter in range(4)):
            if turned.shape == (board.rows, board.columns):
                agree = int(np.count_nonzero(dots.kind[turned.ravel()] == kind_of_dot))
                best = max(best, (agree, turned.ravel()), key=lambda one: one[0])
    if best[0] < _LEAST_OF_GRID * len(kind_of_dot):
        raise TargetNotFound(
            f"No {board.words} was found: {len(dots.kind)} dots blink at its frequencies, and at most "
            f"{best[0]} are where the description has them.",
            remedy="Show the whole board, and check columns, rows and the frequency of each dot.",
        )
    ids = np.arange(len(kind_of_dot))
    centres = dots.centres[best[1]]
    return _Named(ids, centres, _plane(board, ids, centres))


def _seen_from_front(grid: Array) -> bool:
    """Return whether the rows of (rows, columns, 2) image points follow each other clockwise of the columns."""
    along, down = (grid[:, -1] - grid[:, 0]).mean(axis=0), (grid[-1] - grid[0]).mean(axis=0)
    return bool(along[0] * down[1] - along[1] * down[0] > 0)


def _grid_of_dots(centres: Array, size: tuple[int, int]) -> Ints | None:
    """Return (rows, columns) the indices of dots that form a grid, in any of its orders; OpenCV looks for it.

    OpenCV takes a picture: the dots are drawn as discs, a quarter of their distance wide.
    """
    if len(centres) < size[0] * size[1]:
        return None
    scale = _DRAWN_PITCH / local_spacing(centres)
    drawn = scale * (centres - centres.min(axis=0)) + 2 * _DRAWN_PITCH
    width, height = np.ceil(drawn.max(axis=0) + 2 * _DRAWN_PITCH).astype(int)
    if max(width, height) > _LARGEST_PICTURE:
        return None
    picture = np.full((height, width), 255, np.uint8)
    for x, y in np.round(drawn).astype(int).tolist():
        cv2.circle(picture, (x, y), _DRAWN_PITCH // 4, 0, -1)
    found = find_points(picture, Board("circles", *size, 1.0))
    if found is None:
        return None
    away = np.linalg.norm(found[:, None] - drawn[None], axis=2)
    return np.asarray(away.argmin(axis=1), np.int64).reshape(size[1], size[0])


def _plane(board: Board, ids: Ints, centres: Array) -> Array:
    """Return the homography from the grid to the image; refuse dots that form no plane, or a mirrored one."""
    nodes = board.nodes[ids].astype(np.float64)
    h, inside = None, 0
    if len(ids) >= 4:
        pitch = local_spacing(centres)
        h, mask = cv2.findHomography(nodes, centres, cv2.RANSAC, _MOST_OFF_PLANE * pitch)
        inside = int(np.count_nonzero(mask))
    if h is None or inside < max(4, 0.6 * len(ids)):
        raise TargetNotFound(
            f"{len(ids)} dots of the board's frequencies are in view, but they do not lie in its grid.",
            remedy="Check the numbers of columns and rows. List the frequencies row by row.",
        )
    if np.linalg.det(h) * np.sign(h[2] @ [*nodes.mean(axis=0), 1.0]) < 0:
        raise TargetNotFound(
            "The dots are in mirror order.",
            remedy="List the frequencies row by row from the left as the camera sees the board; remove mirrors.",
        )
    return np.asarray(h, np.float64)


def _require_enough(named: _Named, board: Board, size: tuple[int, int], least_share: float) -> None:
    """Refuse a board of which too little is seen; says whether the frame cuts it."""
    nodes = board.nodes[named.ids]
    count = len(board.nodes)
    lines = min(len(np.unique(nodes[:, 0])), len(np.unique(nodes[:, 1])))
    if len(named.ids) >= least_share * count and lines >= 3:
        return
    every = apply_homography(named.homography, board.nodes.astype(float))
    outside = np.count_nonzero(((every < 0) | (every > np.array(size) - 1)).any(axis=1))
    if outside:
        raise TargetNotFound(
            f"The frame cuts the board: {outside} of {count} dots are outside the image, "
            f"{len(named.ids)} are seen.",
            remedy="Show more of the board.",
        )
    raise TargetNotFound(
        f"Only {len(named.ids)} of {count} dots are seen.",
        remedy="Uncover the board, switch on all dots, and correct the list of frequencies.",
    )


def _wholly_in_view(named: _Named, board: Board, size: tuple[int, int]) -> _Named:
    """Leave out dots whose cell of the grid reaches beyond the image: part of their light is missing."""
    nodes = board.nodes[named.ids].astype(np.float64)
    corners = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])
    at = apply_homography(named.homography, (nodes + corners[:, None]).reshape(-1, 2))
    inside = ((at >= 0) & (at <= np.array(size) - 1)).all(axis=1).reshape(4, -1).all(axis=0)
    return _Named(named.ids[inside], named.centres[inside], named.homography)


def _blinking_image(events: EventArrays, size: tuple[int, int], named: _Named, frequencies: Array) -> Array32:
    """Return how strongly each pixel blinks at the frequency of the nearest dot, (H, W)."""
    seeds = np.full((size[1], size[0]), 255, np.uint8)
    columns, rows = np.clip(np.round(named.centres).astype(int), 0, np.array(size) - 1).T
    seeds[rows, columns] = 0
    _, labels = cv2.distanceTransformWithLabels(seeds, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    dot_of_label = np.full(int(labels.max()) + 1, -1, np.int64)
    dot_of_label[labels[rows, columns]] = np.arange(len(rows))
    return lock_in(events, dot_of_label[labels], frequencies[named.ids])


#: Starts that a pixel must have, so that its period has three intervals.
LEAST_STARTS = 4
#: An interval may differ from a whole number of periods by this share of a period.
_TOLERANCE = 0.2
#: This share of the intervals must be one period.
_REGULAR_SHARE = 0.6


def blink_frequencies(events: EventArrays, size: tuple[int, int]) -> Array:
    """Return the (H, W) frequency of each pixel, Hz; nan for one that does not blink regularly.

    From events in the order of their times. Own procedure: the median interval numbers the
    starts, so that a missed or an additional one does not matter; the least-squares line through the numbered starts
    gives the period.
    """
    (t_us, x, y, p), (width, height) = events, size
    starts = np.flatnonzero(_starts(x, y, p, width, height))
    pixel = y[starts].astype(np.int64) * width + x[starts]
    counts = np.bincount(pixel, minlength=width * height)
    times = t_us[starts[np.argsort(pixel, kind="stable")]].astype(np.float64)
    return np.asarray(_frequencies(times, np.cumsum(counts), counts).reshape(height, width))


@njit(cache=True)
def _starts(x: Any, y: Any, p: Any, width: int, height: int) -> Any:
    """Return which events, (N,), are ON events of a pixel whose event before was OFF, or that are its first event."""
    last = np.full((height, width), -1, np.int8)
    starts = np.empty(len(x), np.bool_)
    for i in range(len(x)):
        starts[i] = p[i] == 1 and last[y[i], x[i]] != 1
        last[y[i], x[i]] = p[i]
    return starts


@njit(cache=True)
def _frequencies(times: Any, ends: Any, counts: Any) -> Any:
    """Return the frequency of each pixel, Hz, nan where its starts are too few or irregular."""
    found = np.full(len(ends), np.nan)
    for pixel in range(len(ends)):
        count = counts[pixel]
        if count < LEAST_STARTS:
            continue
        own = times[ends[pixel] - count : ends[pixel]]
        period = np.median(np.diff(own))
        if period <= 0:
            continue
        number, late, regular, used = np.zeros(count), own - own[0], 0, 1
        for i in range(1, count):
            steps = (late[i] - late[used - 1]) / period
            whole = np.round(steps)
            if whole < 1.0 or abs(steps - whole) > _TOLERANCE:
                continue  # an additional start, of noise
            regular += whole == 1.0
            number[used], late[used] = number[used - 1] + whole, late[i]
            used += 1
        if used < LEAST_STARTS or regular < _REGULAR_SHARE * (count - 1):
            continue
        n, t = number[:used], late[:used]
        slope = (used * (n * t).sum() - n.sum() * t.sum()) / (used * (n * n).sum() - n.sum() ** 2)
        if slope > 0:
            found[pixel] = 1e6 / slope
    return found


def lock_in(events: EventArrays, dot_of_pixel: Ints, frequencies_hz: Array) -> Array32:
    """Return (H, W) how strongly each pixel blinks at the frequency, Hz, of its dot: about its events a period.

    Length of the sum of polarity times exp(-2 pi i f t), divided by the number of periods in the recording: lock-in
    detection (Scofield, 1994, American Journal of Physics 62, 129). Noise adds with random phases, so it nearly
    vanishes. ``dot_of_pixel`` is (H, W) int, -1 for no dot.
    """
    (t_us, x, y, p), dots = events, dot_of_pixel.ravel()
    pixel = y.astype(np.int64) * dot_of_pixel.shape[1] + x
    angle = 2.0 * np.pi * frequencies_hz[dots[pixel]] * 1e-6 * t_us
    sign = np.where(p == 1, 1.0, -1.0)
    real, imaginary = (
        np.bincount(pixel, sign * wave, minlength=dots.size) for wave in (np.cos(angle), np.sin(angle))
    )
    span_s = 1e-6 * (t_us[-1] - t_us[0]) if len(x) else 1.0
    image = np.hypot(real, imaginary) / np.maximum(span_s * frequencies_hz[dots], 1.0)
    return np.where(dots >= 0, image, 0.0).astype(np.float32).reshape(dot_of_pixel.shape)
