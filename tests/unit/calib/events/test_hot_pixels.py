"""Hot pixels by medians at single pixels, compared with OpenCV's median filter of the whole image."""

import cv2
import numpy as np
import pytest

from calib.events.accumulation import above_surroundings, hot_pixels, without_hot_pixels

random = np.random.default_rng(3)
ON = random.poisson(2.0, (40, 50)).astype(np.uint32)
OFF = random.poisson(3.0, (40, 50)).astype(np.uint32)
for at in [(0, 0), (39, 49), (1, 20), (17, 0), (30, 30), (30, 31)]:
    ON[at] += 40
ON.ravel()[random.choice(ON.size, 150, replace=False)] += (
    np.arange(150, dtype=np.uint32) // 6
)  # near the limits


@pytest.mark.parametrize("allowed", [0, 3, 8])
def test_hot_pixels_are_those_of_the_median_filter(allowed):
    found, complete = hot_pixels(ON, OFF, allowed, ON.size)
    around = cv2.medianBlur((ON + OFF).astype(np.uint16), 5)
    assert complete
    assert found.any()
    np.testing.assert_array_equal(found, above_surroundings(ON + OFF, around, allowed))


def test_a_search_with_too_many_medians_is_given_up():
    assert not hot_pixels(ON, OFF, 0, 10)[1]


def test_hot_pixels_are_replaced_by_the_median_around_them():
    image = random.normal(size=(40, 50)).astype(np.float32)
    hot = random.random((40, 50)) < 0.2
    hot[[0, 0, -1, -1], [0, -1, 0, -1]] = True
    expected = np.where(hot, cv2.medianBlur(image, 3), image)
    np.testing.assert_array_equal(without_hot_pixels(image, hot), expected)
