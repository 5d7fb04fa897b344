"""Hot pixels by medians at single pixels, compared with OpenCV's median filter of the whole image."""

import cv2
import numpy as np
import pytest

from calib.events import accumulation

random = np.random.default_rng(3)
ON = random.poisson(2.0, (40, 50)).astype(np.uint32)
OFF = random.poisson(3.0, (40, 50)).astype(np.uint32)
for at in [(0, 0), (39, 49), (1, 20), (17, 0), (30, 30), (30, 31)]:
    ON[at] += 40
ON.ravel()[random.choice(ON.size, 150, replace=False)] += (
    np.arange(150, dtype=np.uint32) // 6
)  # near the limits


@pytest.mark.parametrize("allowed", [0, 3, 8, 30])
@pytest.mark.parametrize("few", [1, 64])
def test_hot_pixels_are_those_of_the_median_filter(allowed, few, monkeypatch):
    monkeypatch.setattr(accumulation, "FEW_MEDIANS", few)
    count = (ON + OFF).astype(np.int64)
    around = cv2.medianBlur(count.astype(np.uint16), 5)
    found = accumulation.hot_pixels(ON, OFF, allowed)
    assert found.any()
    np.testing.assert_array_equal(found, 2 * count > 5 * around.astype(np.int64) + 2 * allowed)


def test_hot_pixels_are_replaced_by_the_median_around_them():
    image = random.normal(size=(40, 50)).astype(np.float32)
    hot = random.random((40, 50)) < 0.2
    hot[[0, 0, -1, -1], [0, -1, 0, -1]] = True
    expected = np.where(hot, cv2.medianBlur(image, 3), image)
    np.testing.assert_array_equal(accumulation.without_hot_pixels(image, hot), expected)
