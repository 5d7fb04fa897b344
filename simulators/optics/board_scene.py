"""The image of a board at finite distance: where its points lie, and how much of which light each pixel gets.

Each board is drawn sharp and then blurred as its distance demands. The reciprocal of a plane's distance is a linear
function of the image coordinates, and so is the diameter of the blur with its sign (``lens_focus``). The light of each
point is divided between the two of a few diameters that are next to its own, so that the square of the diameter, and
with it the width of the blur, is exact. What is darker than the board's white parts or its light has the brightness
``black`` of the board. Blinking dots, and the lines of a screen that is drawn from above, are lights of their own:
windows of the image with the pixels that belong to each. This module uses no time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import j1

from simulators.optics import picture as optics
from simulators.optics.collimator_errors import NO_ABERRATIONS
from simulators.optics.drawing import (
    Cells,
    Projection,
    draw,
    empty_picture,
    image_points,
    join_cells,
    plane_points,
    spread_kernel,
)
from simulators.optics.lens_focus import (
    SHARP_PX,
    Spectrum,
    blurred_spectrum,
    camera_of,
    ray_grid,
    reach_px,
    signed_blur_px,
)
from simulators.optics.outlines import bright_areas, middle_mm, points_mm
from simulators.world.board import is_flickering, pose, second_mm
from simulators.world.truth import Truth

FloatArray = NDArray[np.float64]

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
        return blurred_spectrum(Spectrum.of(image), middle, margin)
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
            out += blurred_spectrum(Spectrum.of(part), float(diameter), margin)
    return out


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
        """Return the distance of points of the board, (..., 2) mm, from the plane of the lens, mm."""
        return np.asarray(points @ self.rotation[2, :2] + self.position[2])

    def projection(self, truth: Truth) -> Projection:
        """Return the projection of the board's plane."""
        r = np.ascontiguousarray(self.rotation)
        return Projection(camera_of(truth), r, -r.T @ self.position, NO_ABERRATIONS)


def placed_boards(truth: Truth, angles_deg: Mapping[Any, float]) -> tuple[PlacedBoard, ...]:
    """Return the one or two boards in front of the camera; the first is that of the placement.

    Own derivation: with the rotation G of the camera from its axes at zero angles, the board's own rotation B, its
    middle at p and m on the board, R = G B and t = G (p - B m).
    """
    at_zero = optics.pose_rotation({}, truth.optics, truth.gimbal)
    turned = optics.true_rotation(angles_deg, truth) @ at_zero.T
    own, middle = pose(truth.board)
    from_middle = own @ middle_mm(truth.board, truth.target)
    shift = np.array([*truth.mount.shift_mm, 0.0])
    placed = [PlacedBoard(turned @ own, turned @ (middle - shift - from_middle))]
    second = second_mm(truth.board)
    if second is not None:
        placed.append(PlacedBoard(turned @ own, turned @ (middle - shift - from_middle + second)))
    return tuple(placed)


def points(truth: Truth, angles_deg: Mapping[Any, float]) -> FloatArray:
    """Return the board's true image points, px, nan behind the camera (Hartley and Zisserman, 2004, section 6.1)."""
    placed = placed_boards(truth, angles_deg)[0]
    on_board = points_mm(truth.board, truth.target)
    return np.asarray(image_points(np.ascontiguousarray(on_board), placed.projection(truth)))


def moved_px(before: Truth, after: Truth, angles_deg: Mapping[Any, float]) -> float:
    """Return how far the points of the board have moved at most, px; infinite if one comes from behind the camera."""
    distance = np.linalg.norm(points(after, angles_deg) - points(before, angles_deg), axis=1)
    return float(np.nan_to_num(distance, nan=np.inf).max())


def picture(truth: Truth, angles_deg: Mapping[Any, float], *, subsamples: int = 4) -> NDArray[np.float32]:
    """Return each pixel's share of the full light, without the aperture's brightness (areas: Levien, 2016)."""
    board, camera = truth.board, truth.camera
    image = np.zeros((camera.height, camera.width), np.float32)
    for placed in placed_boards(truth, angles_deg):
        image += lit_share(truth, placed, subsamples)
    np.minimum(image, np.float32(1.0), out=image)
    return np.asarray(np.float32(truth.optics.stray + board.black) + np.float32(1.0 - board.black) * image)


def blur_of(truth: Truth, placed: PlacedBoard) -> BoardBlur:
    """Return the diameters of the blur over the image of a board."""
    outline = bright_areas(truth.board, truth.target, pixels=False)[0].reshape(-1, 2)
    ahead = outline[placed.depth_mm(outline) > NEAREST_MM]
    seen = np.asarray(image_points(np.ascontiguousarray(ahead), placed.projection(truth)))
    return plane_blur(truth, seen, placed.rotation, placed.position)


def lit_share(truth: Truth, placed: PlacedBoard, subsamples: int) -> NDArray[np.float32]:
    """Return how much of each pixel the bright parts of one board cover, after blur and point spread."""
    board, camera = truth.board, camera_of(truth)
    blur = blur_of(truth, placed)
    kernel = spread_kernel(truth.optics.psf_px, subsamples)
    kernel_px = math.ceil((kernel.size / subsamples - 1) / 2)
    cells = Cells(subsamples, kernel_px + reach_px(blur.largest_px))
    steps = empty_picture(camera.width, camera.height, cells.per_px, cells.margin_px)
    rays, projection = ray_grid(camera, cells.margin_px), placed.projection(truth)
    pixels = _pixels_are_seen(truth, placed, blur.smallest_px)
    for rings in bright_areas(board, truth.target, pixels=pixels):
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
    depth = placed.depth_mm(points_mm(board, truth.target))
    period = board.pixel_mm * camera_of(truth).fx / max(float(depth.min()), NEAREST_MM)
    modulation = math.exp(-2.0 * (math.pi * truth.optics.psf_px / period) ** 2)
    x = math.pi * blur_px / period
    disc = abs(2.0 * float(j1(x)) / x) if x > 1e-6 else 1.0
    return modulation * disc > PIXELS_SEEN


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
    """Return whether the board is more than one light: blinking dots, or a screen that is drawn line by line."""
    return truth.board.blinks or (truth.board.own_clock and truth.board.scan > 0.0)


def images_of_lights(truth: Truth, angles_deg: Mapping[Any, float]) -> list[ImageOfLight]:
    """Return the images of all lights in view of the boards; a pixel belongs to one at most, that of the nearer dot."""
    flickers = is_flickering(truth.board)
    boards = placed_boards(truth, angles_deg)
    if truth.board.blinks:
        return _dots(truth, boards, flickers)
    return _bands(truth, boards, flickers)


def _dots(truth: Truth, boards: tuple[PlacedBoard, ...], flickers: bool) -> list[ImageOfLight]:
    """Return the images of blinking dots."""
    board, camera = truth.board, truth.camera
    on_board = np.ascontiguousarray(points_mm(board, truth.target))
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
    outline = bright_areas(truth.board, truth.target, pixels=False)[0].reshape(-1, 2)
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
