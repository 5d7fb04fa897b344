"""Points of a board in an image: OpenCV finds the board; symmetry locates corners, the edge locates circles.

A corner of a checkerboard looks the same after half a turn about its centre, so `calib.stars.centring` locates it; a
circle is located by `calib.boards.discs`. Both follow the curvature of perspective and distortion: circles are then not
biased by perspective (Heikkilä, 2000).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from calib.arrays import AnyArray, Array, Array32, Bytes
from calib.boards.board import Board, Kind
from calib.boards.discs import DiscFit, fit_discs
from calib.boards.lens_map import fit_lens_map
from calib.errors import TargetNotFound, placed
from calib.events.grey_image import to_uint8
from calib.stars.centring import (
    SYMMETRY_REACH,
    SymmetryFit,
    refine_by_symmetry,
    smooth,
    symmetry_samples,
    variance_factor,
)
from calib.stars.grid_map import LocalMap, expanded, without_outliers
from calib.view import View

#: Blur before the points are located, px: it lowers the noise of single pixels.
_BLUR_PX = 0.7
#: Distance of the places at which symmetry is compared, px: first coarse, then fine.
_STEPS_PX = (2.0, 1.0)
#: A point may move by this share of the pitch from where OpenCV found it; the next point is a whole pitch away.
_MOST_MOVE_PITCHES = 0.3
#: Variance over that of white noise, typical for images smoothed by `_BLUR_PX`.
_TYPICAL_FACTOR = 4.0
#: Standard uncertainty that neighbouring points have in common, px, and which the image around a point does not show:
#: where the pixels lie relative to the edges, the screen, the readout. Without it, single points with little noise
#: determine the camera: the errors of simulated calibrations from event images were then 1.3 times as large as stated.
_COMMON_PX = 0.05
#: A point further than this number of standard deviations from the smooth map of the others, and further than this, px,
#: is refused: a view of hardly any noise loses no point by the small errors of its map.
_OUTLIER_SIGMAS = 6.0
_OUTLIER_PX = 0.3
#: Two steps from point to point differ by this share of the shorter one at most: perspective and lens change them
#: slowly.
_MOST_TURN = 0.5
#: At least this share of the points must be located: a reflection may hide some.
_LEAST_SHARE = 0.9
#: A smaller board than this number of corners is not named: noise looks like one now and then.
_FEWEST_NAMED = 12
#: The edges of an image in focus are about 4 px wide after the smoothing, px; this is out of focus.
_SOFT_PX, _EDGE_BLUR_PX = 8.0, 1.5
#: An image whose grey values differ by less than this shows no edges; share of the edge pixels that are the sharpest.
_LEAST_CONTRAST, _SHARPEST = 30.0, 0.002
#: In event images, blur leaves edges sharp and makes the bright squares too wide: by these widths in turn, px.
_TOO_WIDE_PX = (5, 9, 15, 23)
_SECTORS = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY


def detect_board(image: AnyArray, board: Board, *, name: str = "view") -> View:
    """Detect the points of a board as a view, in the order of their ids, row by row, with covariances.

    The (H, W) image may be of any number type, and the board bright on dark or dark on bright. A board that looks the
    same after half a turn may be numbered from either end.
    Raises TargetNotFound: If the image does not show the whole board once; says what it shows instead.
    """
    with placed(f"view {name}"):
        plain = np.nan_to_num(np.asarray(image, np.float32))
        grey = to_uint8(plain)
        coarse = find_points(grey, board)
        if coarse is None:
            raise TargetNotFound(f"No {board.words} was found.", remedy=_remedy(grey, board))
        _refuse_second(grey, coarse, board)
        points, covariances = locate_points(plain, coarse, board)
        ids = np.flatnonzero(np.isfinite(points).all(axis=1))
        if len(ids) < _LEAST_SHARE * len(points):
            raise TargetNotFound(
                f"Only {len(ids)} of {len(points)} points of the board could be located.",
                remedy="Check focus, reflections and shadows; use a larger board, or come nearer.",
            )
        size = (image.shape[1], image.shape[0])
        return View(name, size, ids, points[ids], board.points_mm[ids], covariances[ids])


def find_points(grey: Bytes, board: Board) -> Array | None:
    """Return (N, 2) points, px, of the board, row by row, to about half a pixel; bright on dark or dark on bright.

    Checkerboards: Duda and Frese (2018), as OpenCV has it. Circles: OpenCV's ``findCirclesGrid``. None without a board.
    """
    size = (board.columns, board.rows)
    if board.kind == "checkerboard":  # its finder takes either contrast
        tried = iter([cv2.findChessboardCornersSB(grey, size, flags=_SECTORS)])
    else:
        grid = cv2.CALIB_CB_SYMMETRIC_GRID if board.kind == "circles" else cv2.CALIB_CB_ASYMMETRIC_GRID
        flags, blobs = grid | cv2.CALIB_CB_CLUSTERING, _blobs(grey.shape)
        both = (grey, np.asarray(255 - grey, np.uint8))
        tried = (cv2.findCirclesGrid(shown, size, flags=flags, blobDetector=blobs) for shown in both)
    patterns = (np.asarray(points, np.float64).reshape(-1, 2) for ok, points in tried if ok)
    return next((seen for seen in patterns if board.kind == "checkerboard" or _is_even(seen, board)), None)


def _is_even(points: Array, board: Board) -> bool:
    """Tell whether (N, 2) points go on evenly along rows and columns, as those of a board do behind any lens.

    OpenCV's finder of circles takes other dots for a grid now and then.
    """
    grid = points.reshape(board.rows, board.columns, 2)
    of_columns = [grid[::2], grid[1::2]] if board.kind == "asymmetric-circles" else [grid]
    for lines in (np.swapaxes(grid, 0, 1), *of_columns):
        steps = np.diff(lines, axis=0)
        lengths = np.linalg.norm(steps, axis=2)
        turns = np.linalg.norm(np.diff(steps, axis=0), axis=2)
        if (turns > _MOST_TURN * np.minimum(lengths[:-1], lengths[1:])).any():
            return False
    return True


def _blobs(shape: tuple[int, ...]) -> Any:
    """Return OpenCV's detector of dark blobs, for circles from 5 px to a sixth of the image."""
    chosen = cv2.SimpleBlobDetector.Params()
    chosen.minArea, chosen.maxArea = 20.0, min(shape) ** 2 / 36.0
    chosen.minDistBetweenBlobs = 4.0
    chosen.filterByColor, chosen.blobColor = True, 0
    chosen.filterByConvexity, chosen.minConvexity = True, 0.8
    chosen.filterByInertia, chosen.minInertiaRatio = True, 0.1
    chosen.filterByCircularity = False
    return cv2.SimpleBlobDetector.create(chosen)


def locate_points(image: Array32, coarse: Array, board: Board) -> tuple[Array, Array]:
    """Locate points of a board: circles by their edges, others by symmetry (Schöps et al., 2020).

    From ``coarse``, (N, 2) px, to (N, 2) px, nan where it failed, and covariances, px^2. Both follow the curvature of
    perspective and distortion.
    """
    smoothed, nodes = smooth(image, _BLUR_PX), board.nodes
    grid, size = nodes.astype(float), (image.shape[1], image.shape[0])
    points, good = coarse, np.ones(len(coarse), np.bool_)
    covariances = np.full((len(points), 2, 2), np.nan)
    for step_px in _STEPS_PX:
        local_map = expanded(fit_lens_map(grid[good], points[good], size).apply, grid)
        fit = _located(smoothed, points, board, local_map, step_px)
        good = fit.converged
        if np.count_nonzero(good) < _LEAST_SHARE * len(good):
            return np.full_like(points, np.nan), covariances
        good = without_outliers(grid, fit.centres, good, sigmas=_OUTLIER_SIGMAS, least_px=_OUTLIER_PX)
        points = np.where(good[:, None], fit.centres, coarse)
        information = np.where(good[:, None, None], fit.information, np.eye(2))
        covariances = fit.mean_square[:, None, None] * np.linalg.inv(information)
    factor = variance_factor(nodes[good], points[good], covariances[good], typical=_TYPICAL_FACTOR)
    return np.where(good[:, None], points, np.nan), covariances * factor + _COMMON_PX**2 * np.eye(2)


def _located(
    smoothed: Array32, points: Array, board: Board, local_map: LocalMap, step_px: float
) -> SymmetryFit | DiscFit:
    """Locate points of a board once, from (N, 2) px on, with the map around each."""
    pitch = local_map.pitch_px
    if board.kind != "checkerboard":
        # Every second place of the lattice of an asymmetric grid is free: its circles are farther apart.
        cell = SYMMETRY_REACH * (1.0 if board.kind == "circles" else np.sqrt(2.0))
        return fit_discs(smoothed, points, local_map, cell, _MOST_MOVE_PITCHES * pitch)
    samples = symmetry_samples(pitch / step_px)
    used_to = np.full((len(points), 2), SYMMETRY_REACH)
    return refine_by_symmetry(smoothed, points, local_map, samples, used_to, _MOST_MOVE_PITCHES * pitch)


def _refuse_second(grey: Bytes, points: Array, board: Board) -> None:
    """Refuse an image that shows the board twice; the first one is painted over for the search."""
    hull = cv2.convexHull(points.astype(np.float32)).reshape(-1, 2)
    middle = hull.mean(axis=0)
    share = 1.0 + 3.0 / min(board.columns, board.rows)
    painted = grey.copy()
    outline = np.asarray(np.round(middle + share * (hull - middle)), np.int32)
    cv2.fillConvexPoly(painted, outline, int(np.median(grey)))
    if find_points(painted, board) is not None:
        raise TargetNotFound(
            f"The image shows two boards: a second {board.words} was found.", remedy="Leave only one in view."
        )


def _remedy(grey: Bytes, board: Board) -> str:
    """Return what to do when the board was not found: what the image shows, if it shows another board."""
    general = (
        "The whole board must be in view, in focus, and evenly lit, with a margin of one square around it."
    )
    width = edge_width_px(grey)
    if width is not None and width > _SOFT_PX:
        return f"The image is out of focus: its sharpest edges are {width:.0f} px wide. Focus the lens, or close it."
    if board.kind != "checkerboard":
        return _other_circles(grey, board) or f"{general} Count the circles of a row first, then the rows."
    flags = _SECTORS | cv2.CALIB_CB_LARGER
    ok, points, shown = cv2.findChessboardCornersSBWithMeta(grey, (3, 3), flags)
    rows, columns = shown.shape[:2] if ok and shown is not None else (0, 0)
    wide = _too_wide_px(grey, board)
    if wide is not None:
        return (
            f"The image is out of focus, or far too bright: its bright squares are about {wide} px too wide, and close "
            "the corners. Focus the lens, or close its aperture."
        )
    if rows * columns < _FEWEST_NAMED or sorted((rows, columns)) == sorted((board.rows, board.columns)):
        return general
    cut = _touches_frame(np.asarray(points, np.float64).reshape(-1, 2), grey.shape, rows, columns)
    if cut and columns * rows < board.columns * board.rows:
        return f"{columns} x {rows} inner corners are in view: the frame cuts the board. Show all of it."
    return f"{columns} x {rows} inner corners are in view. Show all of the board, or correct its description."


def _other_circles(grey: Bytes, board: Board) -> str:
    """Return a sentence if the circles are of the other kind, or their columns and rows are swapped; else empty."""
    kinds: tuple[Kind, ...] = ("circles", "asymmetric-circles")
    sides = dict.fromkeys([(board.rows, board.columns), (board.columns, board.rows)])
    for other in (replace(board, kind=kind, columns=c, rows=r) for kind in kinds for c, r in sides):
        if other != board and find_points(grey, other) is not None:
            shown = f"{other.columns} x {other.rows} {other.kind.replace('-', ' ')}"
            return f"The image shows {shown}: correct the description of the board."
    return ""


def _too_wide_px(grey: Bytes, board: Board) -> int | None:
    """Return by how much the bright (or the dark) squares must shrink so that the board is found; None if not at all.

    Own test by erosion (Serra, 1982): the finder needs corners at which four squares meet.
    """
    half = cv2.resize(cv2.medianBlur(grey, 3), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    for shown in (half, np.asarray(255 - half, np.uint8)):
        for width in _TOO_WIDE_PX:
            disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, ((width + 1) // 2, (width + 1) // 2))
            thinner = cv2.GaussianBlur(cv2.erode(shown, disc), (0, 0), 1.0)
            if cv2.findChessboardCornersSB(thinner, (board.columns, board.rows))[0]:
                return width
    return None


def edge_width_px(grey: Bytes) -> float | None:
    """Return the width, px, of the sharpest edges of an (H, W) image; None if it has hardly any contrast.

    Own measure: contrast of the smoothed image over its steepest slope. A step has 4 px because of the smoothing; a
    disc of blur adds three quarters of its diameter.
    """
    smoothed = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), _EDGE_BLUR_PX)
    low, high = np.quantile(smoothed, [0.01, 0.99])
    if high - low < _LEAST_CONTRAST:
        return None
    down, along = np.gradient(smoothed)
    slope = float(np.quantile(np.hypot(down, along), 1.0 - _SHARPEST))
    return float(high - low) / slope if slope > 0 else None


def _touches_frame(points: Array, shape: tuple[int, ...], rows: int, columns: int) -> bool:
    """Return whether the square beyond the outermost corners would reach the border of the image."""
    spread = np.ptp(points, axis=0)
    square = float(max(spread) / max(rows, columns))
    low, high = points.min(axis=0) - 1.5 * square, points.max(axis=0) + 1.5 * square
    return bool((low < 0).any() or high[0] > shape[1] - 1 or high[1] > shape[0] - 1)
