"""A flat board at finite distance before the simulated camera, for pictures in which boards are looked for.

The board is drawn sharp and then blurred as its distance demands. The reciprocal of a plane's distance is a linear
function of the image coordinates, and so is the diameter of the blur with its sign (``lens_focus``). The light of each
point is divided between the two of a few diameters that are next to its own, so that the square of the diameter, and
with it the width of the blur, is exact.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from simulators.optics import picture as optics
from simulators.optics.collimator_errors import aberrations_of
from simulators.optics.drawing import (
    Cells,
    Projection,
    draw,
    empty_picture,
    image_points,
    join_cells,
    spread_kernel,
)
from simulators.optics.lens import ray_grid
from simulators.optics.lens_focus import SHARP_PX, blurred, brightness, camera_of, reach_px, signed_blur_px
from simulators.world.truth import CollimatorTruth, Truth

FloatArray = NDArray[np.float64]

NO_ABERRATIONS: Final = aberrations_of(CollimatorTruth(), np.eye(3))
"""No collimator: nothing is displaced."""
ROUND: Final = 64
"""Corners of a circle's ring."""
_RING: Final = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
_BLACK: Final = 0.04
"""Brightness of what is printed black."""


@dataclass(frozen=True)
class ShownBoard:
    """A checkerboard that shines on a dark screen, or dark circles on white paper, and where its middle stands."""

    columns: int
    rows: int
    pitch_mm: float
    position_mm: tuple[float, float, float]  # From the camera's centre, along its axes at zero angles
    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    kind: str = "checkerboard"

    @property
    def points_mm(self) -> FloatArray:
        """(N, 2) inner corners, or centres of circles, row by row, mm."""
        row, column = np.mgrid[: self.rows, : self.columns].astype(np.float64)
        if self.kind == "asymmetric-circles":
            column = 2.0 * column + row % 2.0
        return np.asarray(self.pitch_mm * np.column_stack([column.ravel(), row.ravel()]))

    @property
    def paper_mm(self) -> tuple[FloatArray, FloatArray]:
        """The upper left and the lower right corner of what shows the board, mm."""
        points = self.points_mm
        return points.min(axis=0) - 1.5 * self.pitch_mm, points.max(axis=0) + 1.5 * self.pitch_mm


@lru_cache(maxsize=4)
def bright_areas(kind: str, columns: int, rows: int, pitch_mm: float) -> tuple[FloatArray, ...]:
    """Return the rings, mm, from which the board's light comes; a ring that runs the other way is dark."""
    board = ShownBoard(columns, rows, pitch_mm, (0.0, 0.0, 1.0), kind=kind)
    if kind == "checkerboard":
        return (_squares(columns, rows, pitch_mm),)
    marks = board.points_mm[:, None] + _circle(0.25 * pitch_mm if kind == "circles" else 0.5 * pitch_mm)
    return _paper(*board.paper_mm, pitch_mm), marks[:, ::-1]


def _squares(columns: int, rows: int, side_mm: float) -> FloatArray:
    """Return every second square of a checkerboard, with the upper left one."""
    i, j = np.meshgrid(np.arange(columns + 1), np.arange(rows + 1))
    chosen = (i + j) % 2 == 0
    upper_left = np.column_stack([i[chosen], j[chosen]]) - 1.0
    return np.asarray(side_mm * (upper_left[:, None] + _RING))


def _circle(radius_mm: float) -> FloatArray:
    """Return a ring of the same area as a circle about the origin."""
    turn = 2.0 * math.pi / ROUND
    radius_mm *= math.sqrt(turn / math.sin(turn))
    angles = turn * np.arange(ROUND)
    return np.asarray(radius_mm * np.column_stack([np.cos(angles), np.sin(angles)]))


def _paper(low: FloatArray, high: FloatArray, tile_mm: float) -> FloatArray:
    """Return white paper as tiles; a single large ring would be left out if all its corners lie out of view."""
    ends = zip(low, high, strict=True)
    across, down = (np.linspace(a, b, 1 + math.ceil((b - a) / tile_mm)) for a, b in ends)
    x, y = np.meshgrid(across, down)
    corners = np.stack([x, y], axis=-1)
    ring = [corners[:-1, :-1], corners[:-1, 1:], corners[1:, 1:], corners[1:, :-1]]
    return np.asarray(np.stack(ring, axis=2).reshape(-1, 4, 2))


STEP_PX: Final = 1.0
"""Largest difference between two diameters by which the image is blurred."""

MOST_LEVELS: Final = 9

LARGEST_PX: Final = 600.0
"""Largest diameter of a blur; wider ones are cut to it."""


_BESIDE_PX: Final = 4.0
"""Pixels beside the outline of a board in which its blur is known too."""

_EVEN_PX: Final = 0.01
"""Range of diameters below which one diameter serves for all."""


class BoardBlur(NamedTuple):
    """Diameters of the blur over the image."""

    smallest_px: float
    largest_px: float
    # (height + 2 n, width + 2 n) float64, diameter in each pixel of the plane of the board, n = ``reach_px``
    # of the largest one; None if there is no blur.
    map_px: FloatArray | None


def plane_blur(truth: Truth, seen_px: FloatArray, rotation: FloatArray, position: FloatArray) -> BoardBlur:
    """Return the diameter of the blur over the image of a flat board, whose outline is at (N, 2) points, px.

    Own derivation: the point of the plane n . X = n . t that a ray (x, y, 1) meets has the reciprocal depth n . (x, y,
    1) / n . t. The lens's distortion is left out, as it changes depths by little. Rotation R, (3, 3), and position t,
    (3,) mm: X_cam = R P + t.
    """
    normal = rotation[:, 2]
    distance = float(normal @ position)
    if truth.lens.focus_distance_m is None or len(seen_px) == 0 or abs(distance) < 1e-9:
        return BoardBlur(0.0, 0.0, None)
    camera = camera_of(truth)
    # The signed diameter is linear in the vergence, and the vergence in the image coordinates.
    at_zero, per_unit = signed_blur_px(truth, 0.0), signed_blur_px(truth, 1.0) - signed_blur_px(truth, 0.0)
    a, b, c = per_unit * 1e3 * normal / distance

    def signed(margin: int) -> FloatArray:
        x = (np.arange(-margin, camera.width + margin) - camera.cx) / camera.fx
        y = (np.arange(-margin, camera.height + margin) - camera.cy) / camera.fy
        return np.asarray(at_zero + a * x[None, :] + b * y[:, None] + c)

    inside = signed(0)
    limits = [camera.width - 1, camera.height - 1]
    low = np.clip(np.nanmin(seen_px, axis=0) - _BESIDE_PX, 0, limits).astype(int)
    high = np.clip(np.nanmax(seen_px, axis=0) + _BESIDE_PX, 0, limits).astype(int)
    inside = inside[low[1] : high[1] + 1, low[0] : high[0] + 1]
    largest = min(float(np.abs(inside).max()), LARGEST_PX)
    smallest = 0.0 if inside.min() <= 0.0 <= inside.max() else min(float(np.abs(inside).min()), LARGEST_PX)
    return BoardBlur(smallest, largest, np.abs(signed(reach_px(largest))))


def spread_unevenly(image: NDArray[np.float32], blur: BoardBlur) -> NDArray[np.float32]:
    """Return an image whose points are spread over discs of different diameters, without its border; at least 0.

    Own rule: the light of a point is divided between two diameters that are at most about `STEP_PX` apart, linearly in
    their squares: the second moment of the blur is then exact. The image is (height + 2 n, width + 2 n) float32, n =
    ``reach_px`` of the largest diameter; it is returned as given without a blur.
    """
    margin = reach_px(blur.largest_px)
    if blur.map_px is None or margin == 0:
        return image
    steps = min(MOST_LEVELS - 1, math.ceil((blur.largest_px - blur.smallest_px) / STEP_PX))
    if blur.largest_px - blur.smallest_px < _EVEN_PX:
        middle = 0.5 * (blur.smallest_px + blur.largest_px)
        return blurred(image, middle, margin)
    diameters = np.linspace(blur.smallest_px, blur.largest_px, max(steps, 1) + 1)
    squared = np.clip(blur.map_px, blur.smallest_px, blur.largest_px) ** 2
    place = np.interp(squared, diameters**2, np.arange(len(diameters))).astype(np.float32)
    height, width = (n - 2 * margin for n in image.shape)
    out = np.zeros((height, width), np.float32)
    for number, diameter in enumerate(diameters):
        part = image * np.maximum(np.float32(1.0) - np.abs(place - np.float32(number)), np.float32(0.0))
        if diameter < SHARP_PX:
            out += part[margin:-margin, margin:-margin]
        else:
            out += blurred(part, float(diameter), margin)
    return out


NEAREST_MM: Final = 1.0
"""Areas that come nearer to the plane of the lens than this are not seen."""


class PlacedBoard(NamedTuple):
    """A board in front of the camera."""

    # rotation, position: R, (3, 3), and t, (3,) mm: X_cam = R P + t.
    rotation: FloatArray
    position: FloatArray

    def depth_mm(self, points: FloatArray) -> FloatArray:
        """Return the distance of points of the board, (..., 2) mm, from the plane of the lens, mm."""
        return np.asarray(points @ self.rotation[2, :2] + self.position[2])

    def projection(self, truth: Truth) -> Projection:
        """Return the projection of the board's plane."""
        r = np.ascontiguousarray(self.rotation)
        return Projection(camera_of(truth), r, -r.T @ self.position, NO_ABERRATIONS)


def placed_board(truth: Truth, board: ShownBoard, angles_deg: Mapping[Any, float]) -> PlacedBoard:
    """Return where the camera sees the board.

    Own derivation: with the rotation G of the camera's pose, the board's own rotation B, its place p and middle m,
    R = G B and t = G (p - B m). The board stands against the camera's shift.
    """
    rotation = optics.true_rotation(angles_deg, truth)
    own = np.asarray(cv2.Rodrigues(np.radians(np.asarray(board.turn_deg, np.float64)))[0], np.float64)
    middle = np.array([*(0.5 * (board.points_mm.min(axis=0) + board.points_mm.max(axis=0))), 0.0])
    (x, y), (right, down, forward) = truth.mount.shift_mm, board.position_mm
    place = np.asarray((right - x, down - y, forward), np.float64)
    return PlacedBoard(rotation @ own, rotation @ (place - own @ middle))


def corners(truth: Truth, board: ShownBoard, angles_deg: Mapping[Any, float]) -> FloatArray:
    """Return the true image points of the board, px (Hartley and Zisserman, 2004, section 6.1)."""
    placed = placed_board(truth, board, angles_deg)
    return np.asarray(image_points(np.ascontiguousarray(board.points_mm), placed.projection(truth)))


def picture(
    truth: Truth, board: ShownBoard, angles_deg: Mapping[Any, float], *, subsamples: int = 4
) -> NDArray[np.float32]:
    """Return each pixel's share of the full light, after blur and point spread (areas: Levien, 2016)."""
    placed, camera = placed_board(truth, board, angles_deg), camera_of(truth)
    corners_mm = np.array([[x, y] for x in (0, 1) for y in (0, 1)]) * np.subtract(*board.paper_mm[::-1])
    outline = corners_mm + board.paper_mm[0]
    ahead = outline[placed.depth_mm(outline) > NEAREST_MM]
    seen = np.asarray(image_points(np.ascontiguousarray(ahead), placed.projection(truth)))
    blur = plane_blur(truth, seen, placed.rotation, placed.position)
    kernel = spread_kernel(truth.optics.psf_px, subsamples)
    kernel_px = math.ceil((kernel.size / subsamples - 1) / 2)
    cells = Cells(subsamples, kernel_px + reach_px(blur.largest_px))
    steps = empty_picture(camera.width, camera.height, cells.per_px, cells.margin_px)
    rays, projection = ray_grid(camera, cells.margin_px), placed.projection(truth)
    for rings in bright_areas(board.kind, board.columns, board.rows, board.pitch_mm):
        draw(rings[(placed.depth_mm(rings) > NEAREST_MM).all(axis=1)], projection, rays, cells, steps)
    height, width = (n + 2 * cells.margin_px + 1 for n in (camera.height, camera.width))
    black = 0.0 if board.kind == "checkerboard" else _BLACK
    light = np.ones((height, width), np.float32)
    image = spread_unevenly(join_cells(steps, light, (0.0, 1.0), kernel, subsamples, kernel_px), blur)
    image = np.float32(truth.optics.stray + black) + np.float32(1.0 - black) * image
    return np.asarray(image * np.float32(brightness(truth)))
