"""Conversion to 8 bits: the ends of the grey scale are exact quantiles."""

import numpy as np
import pytest

from calib.events.grey_image import CLIPPED_SHARE, to_uint8

random = np.random.default_rng(2)
NOISE = random.normal(size=(90, 110))
IMAGES = {
    "noise": NOISE,
    "three values": random.integers(-1, 2, (80, 70)).astype(np.float32),
    "below zero": -np.abs(NOISE),
    "with nan": np.where(NOISE > 1.0, np.nan, NOISE),
    "with infinite values": np.where(NOISE > 1.5, np.inf, NOISE),
    "few bright pixels": np.where(random.random((100, 100)) < 0.001, 7.0, 1.0),
    "whole numbers": random.integers(0, 900, (60, 50)),
}


@pytest.mark.parametrize("image", IMAGES.values(), ids=IMAGES.keys())
def test_the_scale_reaches_from_quantile_to_quantile(image):
    values = image.astype(np.float32)
    finite = values[np.isfinite(values)]
    low, high = np.quantile(finite, [CLIPPED_SHARE, 1.0 - CLIPPED_SHARE])
    if high <= low:
        low, high = finite.min(), finite.max()
    scaled = (np.nan_to_num(values, nan=low).astype(float) - low) * (255.0 / (float(high) - low))
    np.testing.assert_array_equal(to_uint8(image), np.clip(scaled, 0, 255).astype(np.uint8))


@pytest.mark.parametrize("image", [np.full((4, 5), np.nan), np.full((4, 5), 3.0)])
def test_an_image_without_contrast_is_black(image):
    assert not to_uint8(image).any()
