"""The part of the sensor that stars support: every point near a star. Outside, a calibration extrapolates."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.arrays import Array

REACH = 0.05
"""A star supports its surroundings up to this share of the diagonal of the sensor: 73 px of 1280 x 720, more than the
distance of stars of the usual target, so that nothing between stars is unsupported."""


def reach_px(image_size: Sequence[int]) -> float:
    """Return how far from a star, px, a point of the sensor is supported."""
    return REACH * math.hypot(*image_size)


def star_distance(points: Array, image_size: Sequence[int]) -> NDArray[np.float32]:
    """Return each pixel's distance, (H, W) float32 px, from the nearest of (N, 2) stars, N > 0, at whole pixels."""
    width, height = image_size
    free = np.full((height, width), 255, np.uint8)
    at = np.clip(np.rint(points).astype(int), 0, [width - 1, height - 1])
    free[at[:, 1], at[:, 0]] = 0
    distance = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(distance, np.float32)
