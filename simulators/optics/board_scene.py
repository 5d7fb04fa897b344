"""The image of a board at finite distance: where its points lie, and how much of its light each pixel gets.

Each board is drawn sharp and then blurred as its distance demands (`board_blur`). What is darker than the board's white
parts or its light has the brightness ``black`` of the board. This module uses no time and no light.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import j1

from simulators.optics import board_outline
from simulators.optics import picture as optics
from simulators.optics.board_blur import BoardBlur, plane_blur, spread_unevenly
from simulators.optics.collimator_errors import NO_ABERRATIONS
from simulators.optics.coverage import empty_picture, join_cells, spread_kernel
from simulators.optics.lens import lens_of, ray_grid
from simulators.optics.lens_focus import camera_of, reach_px
from simulators.optics.projection import Cells, Projection, draw, image_points
from simulators.world.board import pose, second_mm, view_of
from simulators.world.truth import Truth

FloatArray = NDArray[np.float64]

NEAREST_MM: Final = 1.0
"""Areas that come nearer to the plane of the lens than this are not seen."""
PIXELS_SEEN: Final = 5e-4
"""Modulation from which on the pixels of a screen are drawn one by one."""


class PlacedBoard(NamedTuple):
    """A board in front of the camera."""

    # rotation, position: R, (3, 3), and t, (3,) mm: X_cam = R P + t.
    rotation: FloatArray
    position: FloatArray

    def depth_mm(self, points: FloatArray) -> FloatArray:
        """Return the depth of points of the board.

        points: (..., 2), points of the board, mm.
        Returns: Distance from the plane of the lens, mm.
        """
        return np.asarray(points @ self.rotation[2, :2] + self.position[2])

    def projection(self, truth: Truth) -> Projection:
        """Return the projection of the board's plane."""
        r = np.ascontiguousarray(self.rotation)
        return Projection(lens_of(camera_of(truth)), r, -r.T @ self.position, NO_ABERRATIONS)


def placed_boards(truth: Truth, angles_deg: Mapping[Any, float]) -> tuple[PlacedBoard, ...]:
    """Return the boards in front of the camera: one, or two.

    Own derivation: with the rotation G of the camera from its axes at zero angles, the board's own rotation B, its
    middle at p and m on the board, R = G B and t = G (p - B m).

    angles_deg: Angles of the axes by name; missing = 0.
    Returns: The first one is that of the placement.
    """
    at_zero = optics.pose_rotation({}, truth.optics, truth.gimbal)
    turned = optics.true_rotation(angles_deg, truth) @ at_zero.T
    view = view_of(truth.board, truth.target)
    own, middle = pose(truth.board, view)
    from_middle = own @ board_outline.middle_mm(truth.board, truth.target)
    shift = np.array([*truth.mount.shift_mm, 0.0])
    placed = [PlacedBoard(turned @ own, turned @ (middle - shift - from_middle))]
    second = second_mm(truth.board, view)
    if second is not None:
        placed.append(PlacedBoard(turned @ own, turned @ (middle - shift - from_middle + second)))
    return tuple(placed)


def points(truth: Truth, angles_deg: Mapping[Any, float]) -> FloatArray:
    """Return the true image points of the board.

    Projection: Hartley and Zisserman (2004), section 6.1.

    angles_deg: Angles of the axes by name; missing = 0.
    Returns: Image points, px, in the order of `board_outline.points_mm`; nan behind the camera.
    """
    placed = placed_boards(truth, angles_deg)[0]
    on_board = board_outline.points_mm(truth.board, truth.target)
    return np.asarray(image_points(np.ascontiguousarray(on_board), placed.projection(truth)))


def moved_px(before: Truth, after: Truth, angles_deg: Mapping[Any, float]) -> float:
    """Return how far the points of the board have moved in the image.

    angles_deg: Angles of the axes by name; missing = 0.
    Returns: Largest distance, px; infinite if a point comes from behind the camera.
    """
    distance = np.linalg.norm(points(after, angles_deg) - points(before, angles_deg), axis=1)
    return float(np.nan_to_num(distance, nan=np.inf).max())


def picture(truth: Truth, angles_deg: Mapping[Any, float], *, subsamples: int = 4) -> NDArray[np.float32]:
    """Return the share of the full light that reaches each pixel.

    Areas: Levien (2016). Own model of the point spread: see `coverage.spread_kernel`.

    angles_deg: Angles of the axes by name; missing = 0.
    subsamples: Cells along each side of a pixel.
    Returns: Without the brightness of the lens's aperture.
    """
    board, camera = truth.board, truth.camera
    image = np.zeros((camera.height, camera.width), np.float32)
    for placed in placed_boards(truth, angles_deg):
        image += _lit_share(truth, placed, subsamples)
    np.minimum(image, np.float32(1.0), out=image)
    return np.asarray(np.float32(truth.optics.stray + board.black) + np.float32(1.0 - board.black) * image)


def blur_of(truth: Truth, placed: PlacedBoard) -> BoardBlur:
    """Return the diameters of the blur over the image of a board.

    Returns: Diameters, px.
    """
    outline = board_outline.bright_areas(truth.board, truth.target, pixels=False)[0].reshape(-1, 2)
    ahead = outline[placed.depth_mm(outline) > NEAREST_MM]
    seen = np.asarray(image_points(np.ascontiguousarray(ahead), placed.projection(truth)))
    return plane_blur(truth, seen, placed.rotation, placed.position)


def _lit_share(truth: Truth, placed: PlacedBoard, subsamples: int) -> NDArray[np.float32]:
    """Return how much of each pixel the bright parts of one board cover, after blur and point spread."""
    board, camera = truth.board, camera_of(truth)
    blur = blur_of(truth, placed)
    kernel = spread_kernel(truth.optics.psf_px, subsamples)
    kernel_px = math.ceil((kernel.size / subsamples - 1) / 2)
    cells = Cells(subsamples, kernel_px + reach_px(blur.largest_px))
    steps = empty_picture(camera.width, camera.height, cells.per_px, cells.margin_px)
    rays, projection = ray_grid(camera, cells.margin_px), placed.projection(truth)
    pixels = _pixels_are_seen(truth, placed, blur.smallest_px)
    for rings in board_outline.bright_areas(board, truth.target, pixels=pixels):
        draw(rings[(placed.depth_mm(rings) > NEAREST_MM).all(axis=1)], projection, rays, cells, steps)
    height, width = (n + 2 * cells.margin_px + 1 for n in (camera.height, camera.width))
    shine = 1.0 if pixels else board.fill
    image = join_cells(
        steps, np.ones((height, width), np.float32), (0.0, shine), kernel, subsamples, kernel_px
    )
    return spread_unevenly(image, blur)


def _pixels_are_seen(truth: Truth, placed: PlacedBoard, blur_px: float) -> bool:
    """Return whether the grid of a screen's pixels can be seen; drawing it takes long.

    The modulation of a grid of period p behind a Gaussian of standard deviation s and an even disc of diameter b:
    exp(-2 pi^2 s^2 / p^2) |2 J1(pi b / p) / (pi b / p)| (Goodman, Introduction to Fourier Optics, chapter 2).
    """
    board = truth.board
    if board.pixel_mm == 0.0 or board.fill >= 1.0:
        return False
    depth = placed.depth_mm(board_outline.points_mm(board, truth.target))
    period = board.pixel_mm * camera_of(truth).fx / max(float(depth.min()), NEAREST_MM)
    modulation = math.exp(-2.0 * (math.pi * truth.optics.psf_px / period) ** 2)
    x = math.pi * blur_px / period
    disc = abs(2.0 * float(j1(x)) / x) if x > 1e-6 else 1.0
    return modulation * disc > PIXELS_SEEN
