"""A plain box or sheet before the simulated camera: faces of even brightness, whose edges a moving camera sees.

The box is sharp at every distance. It stands on the frame of its own: X right, Y down, Z away from the camera, mm; the
origin is the middle of its front face. A box without depth is a sheet.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from board_scene import NO_ABERRATIONS
from numpy.typing import NDArray

from simulators.optics.drawing import (
    Cells,
    Projection,
    draw,
    empty_picture,
    join_cells,
    spread_kernel,
)
from simulators.optics.lens import ray_grid
from simulators.optics.lens_focus import camera_of
from simulators.world.truth import Truth

FloatArray = NDArray[np.float64]

BACKGROUND: Final = 0.08
"""Brightness of what stands behind the box, dark cloth; white paper is 1."""

# The faces: the corner at which each begins, in halves of width and height and in depths; the box's axes along its two
# sides (1, 2, 3 for X, Y, Z; negative: backwards), clockwise as seen from outside; brightness. Neighbours differ.
_FACES: Final = (
    ((-1, -1, 0), (1, 2), 1.0),  # front
    ((1, -1, 0), (3, 2), 0.5),  # right
    ((1, -1, 1), (-1, 2), 0.8),  # back
    ((-1, -1, 1), (-3, 2), 0.5),  # left
    ((-1, -1, 1), (1, -3), 0.25),  # top
    ((-1, 1, 0), (1, 3), 0.25),  # bottom
)


@dataclass(frozen=True)
class ShownBox:
    """A box, or a sheet of depth 0, and where the middle of its front face stands."""

    width_mm: float
    height_mm: float
    depth_mm: float
    position_mm: tuple[float, float, float]  # From the camera's centre, along its axes
    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) rotation, camera <- box."""
        return np.asarray(cv2.Rodrigues(np.radians(np.asarray(self.turn_deg, np.float64)))[0], np.float64)

    def faces_mm(self) -> list[FloatArray]:
        """Return the (4, 3) corners of each face, clockwise as seen from outside, in the box's frame."""
        half = np.array([self.width_mm / 2, self.height_mm / 2, self.depth_mm])
        sides = np.diag([self.width_mm, self.height_mm, self.depth_mm])
        rings = []
        for corner, axes, _ in _FACES if self.depth_mm else _FACES[:1]:
            begin = half * corner
            across, down = (math.copysign(1, axis) * sides[abs(axis) - 1] for axis in axes)
            rings.append(np.array([begin, begin + across, begin + across + down, begin + down]))
        return rings

    def edges_mm(self) -> FloatArray:
        """Return the (E, 2, 3) ends of the edges that the camera sees, in the box's frame."""
        edges: dict[tuple[tuple[float, ...], ...], FloatArray] = {}
        for ring in (self.faces_mm()[number] for number in self.seen_faces()):
            for edge in zip(ring, np.roll(ring, -1, axis=0), strict=True):
                first, second = sorted(tuple(np.round(end, 9).tolist()) for end in edge)
                edges[first, second] = np.array([first, second])
        return np.array(list(edges.values()))

    def seen_faces(self) -> list[int]:
        """Return which faces look at the camera."""
        seen = []
        for number, ring in enumerate(self.faces_mm()):
            placed = ring @ self.rotation.T + self.position_mm
            inwards = np.cross(placed[1] - placed[0], placed[3] - placed[0])
            if inwards @ placed[0] > 0.0:
                seen.append(number)
        return seen


def picture(truth: Truth, box: ShownBox, *, subsamples: int = 4) -> NDArray[np.float32]:
    """Return each pixel's share of the full light, after the point spread (areas: Levien, 2016)."""
    camera, rotation = camera_of(truth), box.rotation
    kernel = spread_kernel(truth.optics.psf_px, subsamples)
    margin = math.ceil((kernel.size / subsamples - 1) / 2)
    cells = Cells(subsamples, margin)
    rays = ray_grid(camera, margin)
    light = np.ones((camera.height + 2 * margin + 1, camera.width + 2 * margin + 1), np.float32)
    image = np.full((camera.height, camera.width), truth.optics.stray + BACKGROUND, np.float32)
    faces = box.faces_mm()
    for number in box.seen_faces():
        ring = faces[number]
        across, down = ring[1] - ring[0], ring[3] - ring[0]
        width, height = np.linalg.norm(across), np.linalg.norm(down)
        axes = np.column_stack([across / width, down / height, np.cross(across, down) / (width * height)])
        own = np.ascontiguousarray(rotation @ axes)
        begin = rotation @ ring[0] + box.position_mm
        steps = empty_picture(camera.width, camera.height, cells.per_px, cells.margin_px)
        flat = np.array([[[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]]])
        draw(flat, Projection(camera, own, -own.T @ begin, NO_ABERRATIONS), rays, cells, steps)
        shade = _FACES[number][2] - BACKGROUND
        image += join_cells(steps, light, (0.0, shade), kernel, subsamples, margin)
    return image
