"""Conversion of any image to 8 bits a pixel, for the tag detector and for display."""

from __future__ import annotations

import numpy as np

from calib.arrays import AnyArray, Bytes
from calib.errors import InputMismatch, require_unmasked

#: Share of the pixels that may be clipped at each end of the grey scale, so that hot pixels do not take the range of
#: grey.
CLIPPED_SHARE = 0.005


def to_uint8(image: AnyArray) -> Bytes:
    """Stretch an (H, W) image to 0..255 between its quantiles `CLIPPED_SHARE` and 1 - `CLIPPED_SHARE`.

    Own linear stretch: 255 (value - low) / (high - low), cut at 0 and 255, with quantiles of Hyndman and Fan (1996),
    definition 7, or the least and the largest value if these are equal. A nan counts as the darkest value; all are 0 if
    the image is constant or holds no finite value.

    >>> to_uint8(np.array([[0.0, 1.0], [2.0, 4.0]])).tolist()
    [[0, 63], [127, 255]]
    """
    require_grey_plane(image)
    values = np.ascontiguousarray(image, np.float32)
    sample = (values if values.size < 4_000_000 else values[::2, ::2]).ravel()
    finite = sample[np.isfinite(sample)]
    ends = CLIPPED_SHARE, 1.0 - CLIPPED_SHARE
    low, high = np.quantile(finite, ends).tolist() if finite.size else (0.0, 0.0)
    if finite.size and not high > low:
        low, high = float(finite.min()), float(finite.max())
    if not high > low:
        return np.zeros(image.shape, np.uint8)
    # In place, since new arrays of this size take longer than the sums; fmax returns 0 for nan.
    grey = np.subtract(values, low, dtype=np.float64)
    grey *= 255.0 / (high - low)
    return np.asarray(np.fmin(np.fmax(grey, 0.0, out=grey), 255.0, out=grey).astype(np.uint8))


def require_grey_plane(image: AnyArray) -> None:
    """Raise InputMismatch if an image has other than two axes, is empty, or has masked pixels."""
    if image.ndim != 2 or image.size == 0:
        raise InputMismatch(f"The image has shape {image.shape}.", remedy="Give one grey plane (H, W).")
    require_unmasked(image, "The image holds", remedy="Fill them first: image.filled(0).")
