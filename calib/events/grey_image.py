"""Conversion of any image to 8 bits a pixel, for the tag detector and for display."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.errors import InputMismatch

#: Share of the pixels that may be clipped at each end of the grey scale.
CLIPPED_SHARE = 0.005


def to_uint8(image: NDArray[np.generic]) -> NDArray[np.uint8]:
    """Stretch an image to 0..255 between its quantiles `CLIPPED_SHARE` and 1 - `CLIPPED_SHARE`.

    Own linear stretch: 255 (value - low) / (high - low), cut at 0 and 255.

    Parameters
    ----------
    image
        (H, W) of any integer or floating type; nan counts as the darkest value.

    Returns
    -------
    array
        (H, W) uint8; all 0 if the image is constant or holds no finite value.

    Raises
    ------
    InputMismatch
        If the image does not have two axes, or is empty.

    Examples
    --------
    >>> to_uint8(np.array([[0.0, 1.0], [2.0, 4.0]])).tolist()
    [[0, 63], [127, 255]]
    """
    if image.ndim != 2 or image.size == 0:
        raise InputMismatch(
            f"The image has shape {image.shape}.", where="picture", remedy="Give one grey plane (H, W)."
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
