"""A plain white sheet before the simulated camera, whose edges a moving camera sees.

The sheet is sharp at every distance. It stands on the frame of its own: X right, Y down, Z away from the camera, mm; the
origin is its middle.
"""

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from board_scene import NO_ABERRATIONS
from numpy.typing import NDArray

from simulators.optics.drawing import Cells, Projection, draw, empty_picture, join_cells, spread_kernel
from simulators.optics.lens import ray_grid
from simulators.optics.lens_focus import camera_of
from simulators.world.truth import Truth

FloatArray = NDArray[np.float64]

BACKGROUND: Final = 0.08
"""Brightness of what stands behind the sheet, dark cloth; white paper is 1."""


@dataclass(frozen=True)
class ShownSheet:
    """A sheet of white paper, and where its middle stands."""

    width_mm: float
    height_mm: float
    position_mm: tuple[float, float, float]  # From the camera's centre, along its axes
    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) rotation, camera <- sheet."""
        return np.asarray(cv2.Rodrigues(np.radians(np.asarray(self.turn_deg, np.float64)))[0], np.float64)

    def corners_mm(self) -> FloatArray:
        """Return the (4, 3) corners, clockwise as seen from the front, in the sheet's frame."""
        halves = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
        return 0.5 * halves * [self.width_mm, self.height_mm, 0.0]

    def edges_mm(self) -> FloatArray:
        """Return the (4, 2, 3) ends of the edges, in the sheet's frame."""
        a, b, c, d = self.corners_mm()
        return np.array([[a, b], [b, c], [d, c], [a, d]])

    def shows_its_front(self) -> bool:
        """Whether the front looks at the camera."""
        return float(self.rotation[:, 2] @ self.position_mm) > 0.0


def picture(truth: Truth, sheet: ShownSheet, *, subsamples: int = 4) -> NDArray[np.float32]:
    """Return each pixel's share of the full light, after the point spread (areas: Levien, 2016)."""
    camera, rotation = camera_of(truth), np.ascontiguousarray(sheet.rotation)
    kernel = spread_kernel(truth.optics.psf_px, subsamples)
    margin = math.ceil((kernel.size / subsamples - 1) / 2)
    cells = Cells(subsamples, margin)
    rays = ray_grid(camera, margin)
    light = np.ones((camera.height + 2 * margin + 1, camera.width + 2 * margin + 1), np.float32)
    image = np.full((camera.height, camera.width), truth.optics.stray + BACKGROUND, np.float32)
    if not sheet.shows_its_front():
        return image
    width, height = sheet.width_mm, sheet.height_mm
    begin = rotation @ sheet.corners_mm()[0] + sheet.position_mm
    steps = empty_picture(camera.width, camera.height, cells.per_px, cells.margin_px)
    flat = np.array([[[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]]])
    draw(flat, Projection(camera, rotation, -rotation.T @ begin, NO_ABERRATIONS), rays, cells, steps)
    return image + join_cells(steps, light, (0.0, 1.0 - BACKGROUND), kernel, subsamples, margin)
