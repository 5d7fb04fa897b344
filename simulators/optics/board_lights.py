"""Where in the image which light of a board shines: blinking dots, and the lines of a screen that is drawn from above.

This module returns windows of the image with the pixels that belong to each light; it uses no time.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from simulators.optics import board_outline
from simulators.optics.board_scene import NEAREST_MM, PlacedBoard, blur_of, placed_boards
from simulators.optics.lens import ray_grid
from simulators.optics.lens_focus import camera_of
from simulators.optics.projection import image_points, plane_points
from simulators.world.board import is_flickering, view_of
from simulators.world.truth import Truth

FloatArray = NDArray[np.float64]

BESIDE_PX: Final = 10.0
"""Pixels beside the image of a dot that belong to it too: its point spread, and the shaking of a hand."""
BANDS: Final = 24
"""Bands of lines in which a screen changes at a time."""


class ImageOfLight(NamedTuple):
    """A light's image."""

    # left, top: First column and row of its window.
    left: int
    top: int
    share: NDArray[np.float32]  # (rows, columns) float32: 1 in pixels that see this light, else 0
    frequency_hz: float  # Frequency of a dot; 0: that of the whole board
    # Phase of a dot at the common moment, in periods; of the lines of a screen how much later they change.
    phase: float
    flickers: bool  # Whether the light flickers


def has_many_lights(truth: Truth) -> bool:
    """Return whether the board is more than one light.

    Returns: True for blinking dots, and for a screen that is drawn line by line.
    """
    return truth.board.blinks or (truth.board.own_clock and truth.board.scan > 0.0)


def images_of_lights(truth: Truth, angles_deg: Mapping[Any, float]) -> list[ImageOfLight]:
    """Return the images of all lights of the board, or of both boards.

    angles_deg: Angles of the axes by name; missing = 0.
    Returns: Only those in view. A pixel belongs to one light at most: to that of the nearer dot.
    """
    flickers = is_flickering(truth.board, view_of(truth.board, truth.target))
    boards = placed_boards(truth, angles_deg)
    if truth.board.blinks:
        return _dots(truth, boards, flickers)
    return _bands(truth, boards, flickers)


def _dots(truth: Truth, boards: tuple[PlacedBoard, ...], flickers: bool) -> list[ImageOfLight]:
    """Return the images of blinking dots."""
    board, camera = truth.board, truth.camera
    on_board = np.ascontiguousarray(board_outline.points_mm(board, truth.target))
    centres, reaches = [], []
    for placed in boards:
        seen = np.asarray(image_points(on_board, placed.projection(truth)))
        depth = np.maximum(placed.depth_mm(on_board), NEAREST_MM)
        radius = 0.5 * board.dot_mm * camera_of(truth).fx / depth
        centres.append(np.where(depth[:, None] > NEAREST_MM, seen, np.nan))
        reaches.append(radius + 0.5 * blur_of(truth, placed).largest_px + BESIDE_PX)
    centre, reach = np.concatenate(centres), np.concatenate(reaches)
    nearest = np.full((camera.height, camera.width), np.inf, np.float32)
    owner = np.full(nearest.shape, -1, np.int32)
    windows = {}
    for number, (point, radius) in enumerate(zip(centre, reach, strict=True)):
        window = _window(point - radius, point + radius, camera.width, camera.height)
        if window is None:
            continue
        rows, columns = np.ogrid[window]
        distance = np.hypot(columns - point[0], rows - point[1]).astype(np.float32)
        nearer = (distance < nearest[window]) & (distance < radius * np.sqrt(2.0))
        nearest[window][nearer] = distance[nearer]
        owner[window][nearer] = number
        windows[number] = window
    lights = []
    for number, window in windows.items():
        dot = number % len(on_board)
        share = (owner[window] == number).astype(np.float32)
        lights.append(
            ImageOfLight(
                window[1].start,
                window[0].start,
                share,
                board.frequencies_hz[dot],
                board.phases[dot],
                flickers,
            )
        )
    return lights


def _bands(truth: Truth, boards: tuple[PlacedBoard, ...], flickers: bool) -> list[ImageOfLight]:
    """Return the images of bands of lines; a later line is drawn later by its share of a refresh."""
    board = truth.board
    lowest, height = -board.pitch_mm, board.pitch_mm * (board.rows + 1)
    lines = _lines(truth, boards[0])
    with np.errstate(invalid="ignore"):
        if len(boards) > 1:
            inside = (lines > lowest) & (lines < lowest + height)
            lines = np.where(inside, lines, _lines(truth, boards[1]))
        lines[~_near_boards(truth, boards)] = np.nan
        band = np.clip(np.floor((lines - lowest) / height * BANDS), 0, BANDS - 1)
    lights = []
    for number in range(BANDS):
        own = band == number
        if not own.any():
            continue
        rows, columns = np.nonzero(own.any(axis=1))[0], np.nonzero(own.any(axis=0))[0]
        share = own[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1].astype(np.float32)
        late = board.scan * (number + 0.5) / BANDS * board.flicker_hz / board.refresh_hz
        lights.append(ImageOfLight(int(columns[0]), int(rows[0]), share, 0.0, late, flickers))
    return lights


def _near_boards(truth: Truth, boards: tuple[PlacedBoard, ...]) -> NDArray[np.bool_]:
    """Return which pixels lie in the boxes around the images of the boards."""
    near = np.zeros((truth.camera.height, truth.camera.width), np.bool_)
    outline = board_outline.bright_areas(truth.board, truth.target, pixels=False)[0].reshape(-1, 2)
    for placed in boards:
        ahead = np.ascontiguousarray(outline[placed.depth_mm(outline) > NEAREST_MM])
        seen = np.asarray(image_points(ahead, placed.projection(truth)))
        beside = 0.5 * blur_of(truth, placed).largest_px + BESIDE_PX
        if len(seen):
            low, high = seen.min(axis=0) - beside, seen.max(axis=0) + beside
            window = _window(low, high, truth.camera.width, truth.camera.height)
            if window is not None:
                near[window] = True
    return near


def _lines(truth: Truth, placed: PlacedBoard) -> FloatArray:
    """Return Y on the board that each pixel sees, mm, interpolated between rays."""
    camera = truth.camera
    grid = plane_points(ray_grid(camera_of(truth), 0), placed.projection(truth))[..., 1]
    down, across = (n - 1 for n in grid.shape)
    x = (np.arange(camera.width, dtype=np.float32) + 0.5) / camera.width * across
    y = (np.arange(camera.height, dtype=np.float32) + 0.5) / camera.height * down
    at_x, at_y = np.meshgrid(x.astype(np.float32), y.astype(np.float32))
    return np.asarray(
        cv2.remap(grid.astype(np.float32), at_x, at_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE),
        np.float64,
    )


def _window(low: FloatArray, high: FloatArray, width: int, height: int) -> tuple[slice, slice] | None:
    """Return the rows and columns of a window, or None if it lies outside the image."""
    if not np.isfinite([*low, *high]).all():
        return None
    first, last = np.maximum(np.floor(low), 0.0), np.minimum(np.ceil(high), [width - 1.0, height - 1.0])
    if (first > last).any():
        return None
    return slice(int(first[1]), int(last[1]) + 1), slice(int(first[0]), int(last[0]) + 1)
