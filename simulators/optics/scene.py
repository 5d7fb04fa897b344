"""The scene in front of the camera: the target behind the collimator, or a board at finite distance.

This module selects one of them by the truth, and computes the pose of the screen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from simulators.errors import SimulationMisuse
from simulators.optics import board_scene
from simulators.optics import picture as optics
from simulators.optics.board_scene import PlacedBoard, lit_share
from simulators.optics.drawing import image_points
from simulators.optics.lens_focus import brightness
from simulators.optics.outlines import bright_areas, points_mm
from simulators.world.board import BoardTruth
from simulators.world.truth import Truth

FloatArray = NDArray[np.float64]


def picture(truth: Truth, angles_deg: Mapping[Any, float], *, subsamples: int = 4) -> NDArray[np.float32]:
    """Return each pixel's share of the light; a screen not wholly before the camera raises `SimulationMisuse`."""
    if truth.board.present:
        image = board_scene.picture(truth, angles_deg, subsamples=subsamples)
    elif truth.screen.columns:
        shown, placed = _screen(truth, angles_deg)
        image = lit_share(shown, placed, subsamples) + np.float32(truth.optics.stray)
    else:
        image = optics.render(truth, optics.true_rotation(angles_deg, truth), subsamples=subsamples)
    return np.asarray(image * np.float32(brightness(truth)))


def still_picture(truth: Truth, angles_deg: Mapping[Any, float]) -> NDArray[np.float32]:
    """Return the `picture` of a camera that stands still; the last two are kept and shared, so do not change it."""
    return _kept_picture(truth, tuple(sorted(angles_deg.items())))


@lru_cache(maxsize=2)
def _kept_picture(truth: Truth, angles_deg: tuple[tuple[str, float], ...]) -> NDArray[np.float32]:
    """Compute the picture of ``still_picture``."""
    return picture(truth, dict(angles_deg))


def corners(truth: Truth, angles_deg: Mapping[Any, float]) -> FloatArray:
    """Return the image points of the board in a pose: its inner corners, circles, dots or stars."""
    if truth.board.present:
        return board_scene.points(truth, angles_deg)
    shown, placed = _screen(truth, angles_deg)
    on_board = np.ascontiguousarray(points_mm(shown.board, truth.target))
    return np.asarray(image_points(on_board, placed.projection(shown)))


def _screen(truth: Truth, angles_deg: Mapping[Any, float]) -> tuple[Truth, PlacedBoard]:
    """Return the checkerboard on the screen as a board, and where the camera sees it: X_cam = R P + t.

    Own derivation: with the rotation G of the camera's pose, the board's own rotation B, its place p and middle m,
    R = G B and t = G (p - B m). The screen stands against the camera's shift.
    """
    screen = truth.screen
    board = BoardTruth(
        kind="checkerboard",
        columns=screen.columns,
        rows=screen.rows,
        pitch_mm=screen.square_mm,
        surface="screen",
        black=0.0,
    )
    shown = replace(truth, board=board)
    rotation = optics.true_rotation(angles_deg, truth)
    own = np.asarray(cv2.Rodrigues(np.radians(np.asarray(screen.turn_deg, np.float64)))[0], np.float64)
    middle = 0.5 * screen.square_mm * np.array([screen.columns - 1.0, screen.rows - 1.0, 0.0])
    (x, y), (right, down, away) = truth.mount.shift_mm, screen.position_mm
    place = np.asarray((right - x, down - y, away), np.float64)
    placed = PlacedBoard(rotation @ own, rotation @ (place - own @ middle))
    (outline,) = bright_areas(board, truth.target, pixels=False)
    if not (placed.depth_mm(outline.reshape(-1, 2)) > 0.0).all():
        raise SimulationMisuse("The board is not wholly in front of the camera.", where="position")
    return shown, placed
