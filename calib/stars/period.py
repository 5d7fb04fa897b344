"""The steps from star to star by the autocorrelation of an image, where single stars stand out too little to be found.

At 25 px a pitch under a bright light, white fills most of a star, and a third of the stars respond to no search; the
sum over all of them still shows how far apart they are.
"""

from __future__ import annotations

import cv2
import numpy as np

from calib.arrays import Array, Array32
from calib.stars.beam import find_beam

#: Shortest and longest period that is searched, px.
SHORTEST_PX, LONGEST_PX = 14, 100
#: Standard deviation of the blur that leaves the lamp's slow changes, px.
SLOW_PX = 20.0
#: Least standard deviation of an image's contrast that is made even, as a share of the largest: the rest is dark.
LEAST_SPREAD = 0.1
#: Least height of both peaks, as a share of the variance. Simulated, it is 0.43 to 0.89 with stars in focus, and up to
#: 0.28 far out of focus or in fog.
LEAST = 0.35
#: Least height of such peaks as a share of the highest one.
AS_HIGH = 0.8
#: How far the second step may lie from a right angle with the first, px: cells are seen askew.
ASKEW_PX = 3


def star_steps(image: Array32) -> Array | None:
    """Return the steps to the right and lower neighbour, (2, 2) px in columns; None if the image (H, W) has no period.

    The period is the nearest of the highest peaks of the autocorrelation (Wiener and Khinchin) with another one at a
    right angle: the diagonals of the squares and their multiples are as high.
    """
    reach = LONGEST_PX + ASKEW_PX
    near = _autocorrelation(_without_slow_light(image), reach)
    down, across = np.mgrid[: reach + 1, -reach : reach + 1]
    distance = np.hypot(across, down)
    greatest = cv2.dilate(near, np.ones((9, 9), np.uint8))
    highest = cv2.dilate(near, np.ones((2 * ASKEW_PX + 1,) * 2, np.uint8))
    peaks = (near[reach:] == greatest[reach:]) & (distance >= SHORTEST_PX) & (distance <= LONGEST_PX)
    steps = np.column_stack([across[peaks], down[peaks]])
    if not len(steps):
        return None
    turned = np.column_stack([-steps[:, 1], steps[:, 0]])
    heights = [highest[places[:, 1] + reach, places[:, 0] + reach] for places in (steps, turned)]
    height = np.minimum(*heights)
    if height.max() <= LEAST * near[reach, reach]:  # also if all is dark
        return None
    best = int(np.argmin(np.where(height >= AS_HIGH * height.max(), np.hypot(*steps.T), np.inf)))
    return np.column_stack([steps[best], turned[best]]).astype(float)


def even_contrast(image: Array32) -> Array32:
    """Return an image (H, W) without slow light, over its standard deviation around each pixel.

    Dust and the tag, whose contrast is that of many stars, then hide no period.
    """
    flat = _without_slow_light(image)
    spread = cv2.sqrt(cv2.GaussianBlur(flat * flat, (0, 0), SLOW_PX))
    return np.asarray(flat / np.maximum(spread, np.float32(LEAST_SPREAD * spread.max() + 1e-6)), np.float32)


def _without_slow_light(image: Array32) -> Array32:
    """Return an image without its mean around each pixel, and 0 from the beam's rim on, which is no print."""
    lit = cv2.erode(find_beam(image).lit, np.ones((5, 5), np.uint8), borderType=cv2.BORDER_REPLICATE)
    inside = cv2.resize(lit, image.shape[::-1], interpolation=cv2.INTER_NEAREST).astype(np.float32)
    share = cv2.GaussianBlur(inside, (0, 0), SLOW_PX) + np.float32(1e-3)
    slow = cv2.GaussianBlur(image * inside, (0, 0), SLOW_PX) / share
    return np.asarray((image - slow) * inside, np.float32)


def _autocorrelation(image: Array32, reach: int) -> Array32:
    """Return the autocorrelation of an image for all shifts up to a reach, (2 reach + 1, 2 reach + 1)."""
    shape = [cv2.getOptimalDFTSize(side + reach) for side in image.shape]
    spectrum = np.fft.rfft2(image, shape)
    all_shifts = np.fft.irfft2(np.abs(spectrum) ** 2, shape)
    shifts = np.arange(-reach, reach + 1)
    return np.asarray(all_shifts[np.ix_(shifts, shifts)], np.float32)
