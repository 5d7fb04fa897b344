"""Blur of a board at finite distance, whose parts lie at different distances from the lens.

The reciprocal of a plane's distance is a linear function of the image coordinates, and so is the diameter of the blur
with its sign (``lens_focus``). The light of each point is divided between the two of a few diameters that are next to
its own, so that the square of the diameter, and with it the width of the blur, is exact. The parts are blurred one by
one and added. This module uses no time and no light.
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
    """Return the diameter of the blur over the image of a flat board.

    Own derivation: the point of the plane n . X = n . t that a ray (x, y, 1) meets has the reciprocal depth
    n . (x, y, 1) / n . t. The lens's distortion is left out, as it changes depths by little.

    seen_px: (N, 2), image points of the board's outline.
    rotation, position: R, (3, 3), and t, (3,) mm: X_cam = R P + t.
    Returns: Diameters, px.
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
    """Return an image whose points are spread over discs of different diameters, without its border.

    Own rule: the light of a point is divided between two diameters that are at most about `STEP_PX` apart, linearly in
    their squares: the second moment of the blur is then exact.

    image: (height + 2 n, width + 2 n) float32, n = ``reach_px`` of the largest diameter.
    Returns: At least 0; the given image without a blur.
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
