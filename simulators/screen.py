"""A flickering checkerboard on a screen at finite distance: what other calibration toolboxes look at.

Shares the camera, the blur and the sampling of a pixel with ``optics``; here there is no collimator. Frames:
screen plane Z = 0, X right, Y down, mm, its origin at the board's first inner corner; X_cam = R P + t.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulators.errors import SimulationMisuse
from simulators.optics import blur, corner_rays, distort
from simulators.truth import CameraTruth

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Checkerboard:
    """A board of ``columns`` x ``rows`` inner corners, with squares of ``square_mm``; the screen is dark around it."""

    columns: int = 11
    rows: int = 7
    square_mm: float = 20.0

    @property
    def corners_mm(self) -> FloatArray:
        """(columns * rows, 2) inner corners, row by row, mm."""
        x, y = np.meshgrid(np.arange(self.columns), np.arange(self.rows))
        return self.square_mm * np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)


def project_board(
    board: Checkerboard, camera: CameraTruth, rotation: FloatArray, position: FloatArray
) -> FloatArray:
    """Image points, (N, 2) px, of the inner corners; pixel centres at integers.

    Parameters
    ----------
    rotation, position
        R, (3, 3), and t, (3,) mm: X_cam = R P + t.

    Raises
    ------
    SimulationMisuse
        When the board is not in front of the camera.
    """
    points = np.column_stack([board.corners_mm, np.zeros(board.columns * board.rows)]) @ rotation.T + position
    if not (points[:, 2] > 0.0).all():
        raise SimulationMisuse("The board is not in front of the camera.", where="position")
    xd, yd = distort(points[:, 0] / points[:, 2], points[:, 1] / points[:, 2], camera)
    return np.column_stack([camera.fx * xd + camera.cx, camera.fy * yd + camera.cy])


def render_board(
    board: Checkerboard,
    camera: CameraTruth,
    rotation: FloatArray,
    position: FloatArray,
    *,
    psf_px: float = 0.7,
    subsamples: int = 4,
) -> NDArray[np.float32]:
    """Share of the full light that reaches each pixel, (height, width) float32, 0 to 1.

    Parameters
    ----------
    rotation, position
        As in ``project_board``.
    psf_px
        Standard deviation of the Gaussian point spread.
    subsamples
        Samples along each side of a pixel.
    """
    project_board(board, camera, rotation, position)
    eye = -rotation.T @ position  # the camera's centre in the screen's frame
    image = _render_board(
        corner_rays(camera), rotation.T.copy(), eye, board.square_mm, board.columns, board.rows, subsamples
    )
    return blur(image, psf_px)


@njit(cache=True, nogil=True)
def _brightness(x_mm: float, y_mm: float, square_mm: float, columns: int, rows: int) -> float:
    """1 on the board's bright squares; squares are counted from the one before the first inner corner."""
    i, j = np.floor(x_mm / square_mm) + 1, np.floor(y_mm / square_mm) + 1
    if not (0 <= i <= columns and 0 <= j <= rows):
        return 0.0
    return 1.0 if (i + j) % 2 == 0 else 0.0


@njit(cache=True, nogil=True)
def _render_board(
    rays: NDArray, r_t: NDArray, eye: NDArray, square_mm: float, columns: int, rows: int, n: int
) -> NDArray:
    """Loop of ``render_board``: rays of the pixels' corners, interpolated between them, meet the screen."""
    height, width = rays.shape[0] - 1, rays.shape[1] - 1
    image = np.zeros((height, width), np.float32)
    for i in range(height):
        for j in range(width):
            total = 0.0
            for a in range(n):
                v = (a + 0.5) / n
                for b in range(n):
                    u = (b + 0.5) / n
                    top_x, top_y = _mix(rays[i, j], rays[i, j + 1], u)
                    low_x, low_y = _mix(rays[i + 1, j], rays[i + 1, j + 1], u)
                    xn, yn = (1.0 - v) * top_x + v * low_x, (1.0 - v) * top_y + v * low_y
                    dz = r_t[2, 0] * xn + r_t[2, 1] * yn + r_t[2, 2]
                    scale = -eye[2] / dz
                    if scale > 0.0:
                        x = eye[0] + scale * (r_t[0, 0] * xn + r_t[0, 1] * yn + r_t[0, 2])
                        y = eye[1] + scale * (r_t[1, 0] * xn + r_t[1, 1] * yn + r_t[1, 2])
                        total += _brightness(x, y, square_mm, columns, rows)
            image[i, j] = total / (n * n)
    return image


@njit(cache=True, nogil=True)
def _mix(a: NDArray, b: NDArray, u: float) -> tuple[float, float]:
    """Point between two rays."""
    return (1.0 - u) * a[0] + u * b[0], (1.0 - u) * a[1] + u * b[1]
