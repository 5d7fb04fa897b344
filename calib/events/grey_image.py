"""Conversion of any image to 8 bits a pixel, for the tag detector and for display."""

from __future__ import annotations

import numpy as np

from calib.arrays import AnyArray, Array32, Bytes
from calib.errors import InputMismatch

#: Share of the pixels that may be clipped at each end of the grey scale.
CLIPPED_SHARE = 0.005


def to_uint8(image: AnyArray) -> Bytes:
    """Stretch an (H, W) image to 0..255 between its quantiles `CLIPPED_SHARE` and 1 - `CLIPPED_SHARE`.

    Own linear stretch: 255 (value - low) / (high - low), cut at 0 and 255. A nan counts as the darkest value; all are 0
    if the image is constant or holds no finite value.

    >>> to_uint8(np.array([[0.0, 1.0], [2.0, 4.0]])).tolist()
    [[0, 63], [127, 255]]
    """
    require_grey_plane(image)
    values = np.ascontiguousarray(image, np.float32)
    sample = values if values.size < 4_000_000 else np.ascontiguousarray(values[::2, ::2])
    low, high = _clipped_ends(sample.ravel(), CLIPPED_SHARE)
    if not high > low:
        return np.zeros(image.shape, np.uint8)
    # In place, since new arrays of this size take longer than the sums; fmax returns 0 for nan.
    grey = np.subtract(values, low, dtype=np.float64)
    grey *= 255.0 / (high - low)
    return np.asarray(np.fmin(np.fmax(grey, 0.0, out=grey), 255.0, out=grey).astype(np.uint8))


def _clipped_ends(values: Array32, share: float) -> tuple[float, float]:
    """Return the quantiles ``share`` and 1 - ``share`` of the finite of (N,) values; if equal, the ends of the values.

    Quantiles: Hyndman and Fan (1996), definition 7. Both are 0 if no value is finite.
    """
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return 0.0, 0.0
    low, high = np.quantile(finite, [share, 1.0 - share])
    return (float(low), float(high)) if high > low else (float(finite.min()), float(finite.max()))


def require_grey_plane(image: AnyArray) -> None:
    """Raise InputMismatch if an image has other than two axes, or is empty."""
    if image.ndim != 2 or image.size == 0:
        raise InputMismatch(f"The image has shape {image.shape}.", remedy="Give one grey plane (H, W).")
