"""The part of the sensor that stars support: every point near a star. Outside of it, a calibration extrapolates."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

REACH = 0.05
"""A star supports its surroundings up to this share of the diagonal of the sensor."""


def reach_px(image_size: Sequence[int]) -> float:
    """Return how far from a star a point of the sensor is supported.

    image_size: Width and height, px.
    Returns: The distance, px.
    """
    return REACH * math.hypot(*image_size)


def star_distance(points: Array, image_size: Sequence[int]) -> NDArray[np.float32]:
    """Return the distance of each pixel from the nearest star.

    points: (N, 2) float64, px: stars of all poses, N > 0.
    image_size: Width and height, px.
    Returns: (H, W) float32, px. Stars count at the nearest pixel.
    """
    width, height = image_size
    free = np.full((height, width), 255, np.uint8)
    at = np.clip(np.rint(points).astype(int), 0, [width - 1, height - 1])
    free[at[:, 1], at[:, 0]] = 0
    distance = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(distance, np.float32)
