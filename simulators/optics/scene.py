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

from simulators.optics import board_scene
from simulators.optics import picture as optics
from simulators.optics.board_blur import plane_blur, spread_unevenly
from simulators.optics.lens_focus import brightness, camera_of, reach_px
from simulators.optics.screen import Checkerboard, project_board, project_outline, render_board
from simulators.world.truth import ScreenTruth, Truth

FloatArray = NDArray[np.float64]


def picture(truth: Truth, angles_deg: Mapping[Any, float], *, subsamples: int = 4) -> NDArray[np.float32]:
    """Return the share of the full light that reaches each pixel in a pose.

    angles_deg: Angles of the axes by name; missing = 0.
    subsamples: Cells along each side of a pixel.
    Returns: About 0 to 1 at the brightness of the lens as delivered.
    Raises SimulationMisuse: If a screen is not wholly in front of the camera.
    """
    if truth.board.present:
        image = board_scene.picture(truth, angles_deg, subsamples=subsamples)
    elif truth.screen.columns:
        image = _screen_picture(truth, optics.true_rotation(angles_deg, truth), subsamples)
    else:
        image = optics.render(truth, optics.true_rotation(angles_deg, truth), subsamples=subsamples)
    light = brightness(truth)
    return image if light == 1.0 else np.asarray(image * np.float32(light))


def still_picture(truth: Truth, angles_deg: Mapping[Any, float]) -> NDArray[np.float32]:
    """Return the picture of a camera that stands still; the last two are kept, as one pose is recorded often.

    angles_deg: Angles of the axes by name; missing = 0.
    Returns: As `picture`; the array may be shared, so do not change it.
    """
    return _kept_picture(truth, tuple(sorted(angles_deg.items())))


@lru_cache(maxsize=2)
def _kept_picture(truth: Truth, angles_deg: tuple[tuple[str, float], ...]) -> NDArray[np.float32]:
    """Compute the picture of ``still_picture``."""
    return picture(truth, dict(angles_deg))


def _screen_picture(truth: Truth, rotation: FloatArray, subsamples: int) -> NDArray[np.float32]:
    """Return the picture of the checkerboard, each part of it blurred as its distance demands."""
    board, (turn, position) = board_of(truth.screen), board_pose(_screen_of(truth), rotation)
    camera, psf = camera_of(truth), truth.optics.psf_px
    seen = project_outline(board, camera, turn, position)
    blur = plane_blur(truth, seen, turn, position)
    image = render_board(
        board, camera, turn, position, psf_px=psf, subsamples=subsamples, margin_px=reach_px(blur.largest_px)
    )
    return np.asarray(spread_unevenly(image, blur) + np.float32(truth.optics.stray))


def corners(truth: Truth, angles_deg: Mapping[Any, float]) -> FloatArray:
    """Return the image points of the board in a pose: its inner corners, circles, dots or stars.

    angles_deg: Angles of the axes by name; missing = 0.
    Returns: Image points, px, row by row.
    """
    if truth.board.present:
        return board_scene.points(truth, angles_deg)
    rotation = optics.true_rotation(angles_deg, truth)
    return project_board(board_of(truth.screen), camera_of(truth), *board_pose(_screen_of(truth), rotation))


def _screen_of(truth: Truth) -> ScreenTruth:
    """Return the screen as the shifted camera sees it: it stands against the camera's shift."""
    (x, y), (right, down, away) = truth.mount.shift_mm, truth.screen.position_mm
    return replace(truth.screen, position_mm=(right - x, down - y, away))


def board_of(screen: ScreenTruth) -> Checkerboard:
    """Return the board on a screen.

    screen: True size and pose of the board.
    """
    return Checkerboard(screen.columns, screen.rows, screen.square_mm)


def board_pose(screen: ScreenTruth, rotation: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the pose of the board in the camera's frame: X_cam = R P + t.

    Own derivation: with the board's own rotation R0, position p and middle m, R = R_pose R0 and t = R_pose (p - R0 m).

    screen: True pose of the board at zero angles.
    rotation: (3, 3) of the camera's pose, from the axes at zero angles.
    Returns: Rotation R, (3, 3), and position t, (3,) mm.
    """
    own = np.asarray(cv2.Rodrigues(np.radians(np.asarray(screen.turn_deg, np.float64)))[0], np.float64)
    middle = 0.5 * screen.square_mm * np.array([screen.columns - 1.0, screen.rows - 1.0, 0.0])
    return rotation @ own, rotation @ (np.asarray(screen.position_mm, np.float64) - own @ middle)
