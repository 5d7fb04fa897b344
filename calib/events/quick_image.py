"""The event image of a live picture, from the number of events of each pixel and polarity alone.

Without times, events need no list: a decoder counts them straight into the two images. The counts must be those of
whole periods of the flicker. The images are like those of `calib.events.event_image`, which a calibration uses:

fired-per-edge
    Share of the edges on which a pixel fired, taken as its number of events a period, 1 at most. This differs from the
    exact image where a pixel sends two events on one edge and none on another one.
events-per-edge
    Number of events that a pixel sends at an edge. Used where pixels send several, in place of the lock-in image.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.events.event_image import LIT_SHARE, LOCK_IN_MIN_EVENTS


class QuickImage(NamedTuple):
    """Image by counts."""

    name: str  # ``fired-per-edge`` or ``events-per-edge``
    # (H, W) float32, brighter where the target is brighter; hot pixels are replaced.
    image: NDArray[np.float32]
    hot_pixels: int  # Number of pixels that fire far more often than their surroundings


def make_quick_image(counts: NDArray[np.uint16], periods: int) -> QuickImage:
    """Make the image in which stars of a live picture are searched; kinds are those of `calib.events.event_image`.

    ``counts`` are (2, H, W) OFF events, then ON events, in at least one whole period. All 0 without events.
    """
    off, on = counts
    total = cv2.convertScaleAbs(cv2.add(on, off))  # at most 255
    levels = np.arange(256)
    limits = np.minimum(2.5 * levels + 4.0 + 4.0 * periods, 255.0).astype(np.uint8)
    hot = cv2.compare(total, cv2.LUT(cv2.medianBlur(total, 5), limits), cv2.CMP_GT)
    least = LIT_SHARE * periods
    lit = ((on >= least) & (off >= least) & (hot == 0)).view(np.uint8)
    per_edge = (cv2.mean(on, mask=lit)[0] + cv2.mean(off, mask=lit)[0]) / (2.0 * periods)
    name = "events-per-edge" if per_edge >= LOCK_IN_MIN_EVENTS else "fired-per-edge"
    if name == "fired-per-edge":
        on, off = (np.minimum(part, np.uint16(periods)) for part in (on, off))
    image = cv2.add(on, off).astype(np.float32)
    image *= np.float32(0.5 / periods)
    found = cv2.countNonZero(hot)
    if found:
        cv2.copyTo(cv2.medianBlur(image, 3), hot, image)
    return QuickImage(name, image, found)
