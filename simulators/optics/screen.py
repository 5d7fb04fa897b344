"""A flickering checkerboard on a screen at finite distance, the target of other calibration toolboxes.

There is no collimator; lens, areas and point spread are those of ``optics``. Frames: screen plane Z = 0, X right,
Y down, mm, origin at the board's first inner corner; X_cam = R P + t.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulators.errors import SimulationMisuse
from simulators.optics.collimator_errors import NO_ABERRATIONS
from simulators.optics.coverage import empty_picture, join_cells, spread_kernel
from simulators.optics.lens import lens_of, ray_grid
from simulators.optics.projection import Cells, Projection, draw, image_points
from simulators.world.truth import CameraTruth

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Checkerboard:
    """A checkerboard; the screen is dark around it."""

    columns: int = 11
    rows: int = 7
    square_mm: float = 20.0  # Side of a square

    @property
    def corners_mm(self) -> FloatArray:
        """(columns * rows, 2) inner corners, row by row, mm."""
        x, y = np.meshgrid(np.arange(self.columns), np.arange(self.rows))
        return self.square_mm * np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)

    @property
    def bright_mm(self) -> FloatArray:
        """(N, 4, 2) corners of the bright squares, mm, clockwise as seen; the upper left square is bright."""
        i, j = np.meshgrid(np.arange(self.columns + 1), np.arange(self.rows + 1))
        bright = (i + j) % 2 == 0
        upper_left = np.column_stack([i[bright], j[bright]]) - 1.0
        ring = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
        return np.asarray(self.square_mm * (upper_left[:, None] + ring[None]))


def project_board(
    board: Checkerboard, camera: CameraTruth, rotation: FloatArray, position: FloatArray
) -> FloatArray:
    """Return the image points of the board's inner corners.

    Projection: Hartley and Zisserman (2004), section 6.1.

    camera: True parameters of the camera.
    rotation, position: R, (3, 3), and t, (3,) mm: X_cam = R P + t.
    Returns: Image points, px, row by row; pixel centres at integers.
    Raises SimulationMisuse: If the board is not wholly in front of the camera.
    """
    return np.asarray(image_points(board.corners_mm, _projection(board, camera, rotation, position)))


def project_outline(
    board: Checkerboard, camera: CameraTruth, rotation: FloatArray, position: FloatArray
) -> FloatArray:
    """Return the image points of the corners of all bright squares.

    Projection: Hartley and Zisserman (2004), section 6.1.

    camera: True parameters of the camera.
    rotation, position: R, (3, 3), and t, (3,) mm: X_cam = R P + t.
    Returns: Image points, px.
    Raises SimulationMisuse: If the board is not wholly in front of the camera.
    """
    outline = np.ascontiguousarray(board.bright_mm.reshape(-1, 2))
    return np.asarray(image_points(outline, _projection(board, camera, rotation, position)))


def _projection(
    board: Checkerboard, camera: CameraTruth, rotation: FloatArray, position: FloatArray
) -> Projection:
    """Return the projection of the screen; raise if the board is not wholly in front of the camera."""
    outline = board.bright_mm.reshape(-1, 2)
    depth = outline @ rotation[2, :2] + position[2]
    if not (depth > 0.0).all():
        raise SimulationMisuse("The board is not wholly in front of the camera.", where="position")
    r = np.ascontiguousarray(rotation, np.float64)
    return Projection(lens_of(camera), r, -r.T @ np.asarray(position, np.float64), NO_ABERRATIONS)


def render_board(
    board: Checkerboard,
    camera: CameraTruth,
    rotation: FloatArray,
    position: FloatArray,
    *,
    psf_px: float = 0.7,
    subsamples: int = 4,
    margin_px: int = 0,
) -> NDArray[np.float32]:
    """Return the share of the full light that reaches each pixel.

    Areas: Levien (2016). Own model of the point spread: see `coverage.spread_kernel`.

    camera: True parameters of the camera.
    rotation, position: R, (3, 3), and t, (3,) mm: X_cam = R P + t.
    subsamples: Cells along each side of a pixel.
    Returns: 0 to 1.
    Raises SimulationMisuse: If the board is not wholly in front of the camera.
    """
    projection = _projection(board, camera, rotation, position)
    kernel = spread_kernel(psf_px, subsamples)
    kernel_px = math.ceil((kernel.size / subsamples - 1) / 2)
    cells = Cells(subsamples, kernel_px + margin_px)
    steps = empty_picture(camera.width, camera.height, cells.per_px, cells.margin_px)
    draw(board.bright_mm, projection, ray_grid(camera, cells.margin_px), cells, steps)
    light = np.ones(
        (camera.height + 2 * cells.margin_px + 1, camera.width + 2 * cells.margin_px + 1), np.float32
    )
    return np.asarray(join_cells(steps, light, (0.0, 1.0), kernel, subsamples, kernel_px))
