"""Blur of a board at finite distance, whose parts lie at different distances from the lens.

The reciprocal of a plane's distance is a linear function of the image coordinates, and so is the diameter of the blur
with its sign (``lens_focus``). The image is blurred by a few diameters, and each pixel takes the two that are next to
its own. This module uses no time and no light.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulators.optics.lens_focus import (
    SHARP_PX,
    Spectrum,
    blurred_spectrum,
    camera_of,
    reach_px,
    signed_blur_px,
)
from simulators.optics.screen import Checkerboard, project_board
from simulators.world.truth import Truth

FloatArray = NDArray[np.float64]

STEP_PX: Final = 1.0
"""Largest difference between two diameters by which the image is blurred."""

MOST_LEVELS: Final = 9


class BoardBlur(NamedTuple):
    """Diameters of the blur over the image.

    Attributes
    ----------
    smallest_px, largest_px
        Over the board, as far as it lies in the image.
    map_px
        (height, width) float64, diameter in each pixel of the plane of the board; None if there is no blur.
    """

    smallest_px: float
    largest_px: float
    map_px: FloatArray | None


def board_blur(truth: Truth, board: Checkerboard, rotation: FloatArray, position: FloatArray) -> BoardBlur:
    """Return the diameter of the blur over the image of a board.

    Own derivation: the point of the plane n . X = n . t that a ray (x, y, 1) meets has the reciprocal depth
    n . (x, y, 1) / n . t. The lens's distortion is left out, as it changes depths by little.

    Parameters
    ----------
    truth
        Camera and lens.
    board
        Board on the screen.
    rotation, position
        R, (3, 3), and t, (3,) mm: X_cam = R P + t.

    Returns
    -------
    BoardBlur
        Diameters, px.
    """
    if truth.lens.focus_distance_m is None:
        return BoardBlur(0.0, 0.0, None)
    camera, normal = camera_of(truth), rotation[:, 2]
    # The signed diameter is linear in the vergence, and the vergence in the image coordinates.
    at_zero, per_unit = signed_blur_px(truth, 0.0), signed_blur_px(truth, 1.0) - signed_blur_px(truth, 0.0)
    a, b, c = per_unit * 1e3 * normal / float(normal @ position)
    x = (np.arange(camera.width) - camera.cx) / camera.fx
    y = (np.arange(camera.height) - camera.cy) / camera.fy
    signed = at_zero + a * x[None, :] + b * y[:, None] + c
    seen = project_board(board, camera, rotation, position)
    pitch = float(np.ptp(seen, axis=0).max()) / max(min(board.columns, board.rows) - 1, 1)
    low = np.clip(seen.min(axis=0) - pitch, 0, [camera.width - 1, camera.height - 1]).astype(int)
    high = np.clip(seen.max(axis=0) + pitch, 0, [camera.width - 1, camera.height - 1]).astype(int)
    inside = signed[low[1] : high[1] + 1, low[0] : high[0] + 1]
    largest = float(np.abs(inside).max())
    smallest = 0.0 if inside.min() <= 0.0 <= inside.max() else float(np.abs(inside).min())
    return BoardBlur(smallest, largest, np.abs(signed))


def spread_unevenly(image: NDArray[np.float32], blur: BoardBlur) -> NDArray[np.float32]:
    """Return an image whose points are spread over discs of different diameters, without its border.

    Own rule: between two diameters that are at most about `STEP_PX` apart, images are mixed linearly.

    Parameters
    ----------
    image
        (height + 2 n, width + 2 n) float32, n = ``reach_px`` of the largest diameter.
    blur
        Diameters.

    Returns
    -------
    (height, width) float32
        At least 0; the given image without a blur.
    """
    margin = reach_px(blur.largest_px)
    if blur.map_px is None or margin == 0:
        return image
    steps = min(MOST_LEVELS - 1, max(1, math.ceil((blur.largest_px - blur.smallest_px) / STEP_PX)))
    diameters = np.linspace(blur.smallest_px, blur.largest_px, steps + 1)
    spectrum, out = Spectrum.of(image), np.zeros(blur.map_px.shape, np.float32)
    place = (blur.map_px - blur.smallest_px) / max(blur.largest_px - blur.smallest_px, 1e-9) * steps
    place = np.clip(place, 0.0, steps)
    for number, diameter in enumerate(diameters):
        weight = np.maximum(1.0 - np.abs(place - number), 0.0).astype(np.float32)
        if diameter < SHARP_PX:
            out += weight * image[margin:-margin, margin:-margin]
        else:
            out += weight * blurred_spectrum(spectrum, float(diameter), margin)
    return out
