"""What stands before the camera: the target behind the collimator, or a checkerboard on a screen at finite distance.

Knows which of the two a truth means, and where the screen is seen from in a pose.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from simulators.optics import picture as optics
from simulators.optics.screen import Checkerboard, project_board, render_board
from simulators.world.truth import ScreenTruth, Truth

FloatArray = NDArray[np.float64]


def picture(truth: Truth, angles_deg: Mapping[Any, float], *, subsamples: int = 4) -> NDArray[np.float32]:
    """Share of the full light that reaches each pixel in a pose: (height, width) float32.

    Raises
    ------
    SimulationMisuse
        When a screen is not wholly in front of the camera.
    """
    rotation = optics.pose_rotation(angles_deg, truth.optics)
    if truth.screen.columns == 0:
        return optics.render(truth, rotation, subsamples=subsamples)
    board, (turn, position) = board_of(truth.screen), board_pose(truth.screen, rotation)
    psf = truth.optics.psf_px
    image = render_board(board, truth.camera, turn, position, psf_px=psf, subsamples=subsamples)
    return np.asarray(image + np.float32(truth.optics.stray))


def corners(truth: Truth, angles_deg: Mapping[Any, float]) -> FloatArray:
    """Image points, (columns * rows, 2) px, of the board's inner corners in a pose, row by row."""
    rotation = optics.pose_rotation(angles_deg, truth.optics)
    return project_board(board_of(truth.screen), truth.camera, *board_pose(truth.screen, rotation))


def board_of(screen: ScreenTruth) -> Checkerboard:
    """Board on a screen."""
    return Checkerboard(screen.columns, screen.rows, screen.square_mm)


def board_pose(screen: ScreenTruth, rotation: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotation, (3, 3), and position, (3,) mm, of the board in the camera's frame: X_cam = R P + t.

    Parameters
    ----------
    rotation
        (3, 3) of the camera's pose, from the axes at zero angles.
    """
    own = np.asarray(cv2.Rodrigues(np.radians(np.asarray(screen.turn_deg, np.float64)))[0], np.float64)
    middle = 0.5 * screen.square_mm * np.array([screen.columns - 1.0, screen.rows - 1.0, 0.0])
    return rotation @ own, rotation @ (np.asarray(screen.position_mm, np.float64) - own @ middle)
