"""Any image as 8 bits a pixel, for the tag detector and for people to look at.

Knows brightness only, not what is in the image.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.errors import InputMismatch

#: Darkest and brightest share of the pixels that the stretch may clip.
CLIPPED_SHARE = 0.005


def to_uint8(image: NDArray[np.generic]) -> NDArray[np.uint8]:
    """Stretch an image to 0..255 between its darkest and brightest half percent.

    Parameters
    ----------
    image
        (H, W) of any integer or floating type; nan is taken for the darkest.

    Raises
    ------
    InputMismatch
        When it is not one plane, or empty.

    Examples
    --------
    >>> to_uint8(np.array([[0.0, 1.0], [2.0, 4.0]])).tolist()
    [[0, 63], [127, 255]]
    """
    if image.ndim != 2 or image.size == 0:
        raise InputMismatch(
            f"An image of shape {image.shape}.", where="picture", remedy="Give one grey plane (H, W)."
        )
    values = np.asarray(image, np.float32)
    sample = values if values.size < 4_000_000 else values[::2, ::2]
    finite = sample[np.isfinite(sample)]
    if finite.size == 0:
        return np.zeros(image.shape, np.uint8)
    low, high = np.quantile(finite, [CLIPPED_SHARE, 1.0 - CLIPPED_SHARE])
    if high <= low:
        low, high = float(finite.min()), float(finite.max())
    if high <= low:
        return np.zeros(image.shape, np.uint8)
    scaled = (np.nan_to_num(values, nan=low) - low) * (255.0 / (high - low))
    return np.asarray(np.clip(scaled, 0, 255), np.uint8)
