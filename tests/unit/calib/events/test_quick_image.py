"""Images of events: quick ones, grey ones, and hot pixels."""

import cv2
import numpy as np
import pytest

from calib.events import accumulation
from calib.events.event_image import make_quick_image
from calib.events.grey_image import CLIPPED_SHARE, to_uint8


def counts_of(on, off):
    return np.stack([np.asarray(off, np.uint16), np.asarray(on, np.uint16)])


def scene(seed=1, shape=(60, 80)):
    """Which pixels see white print."""
    return np.kron(
        np.random.default_rng(seed).random((shape[0] // 10, shape[1] // 10)) > 0.5, np.ones((10, 10))
    )


@pytest.mark.parametrize("periods", [1, 3])
def test_one_event_an_edge_is_the_share_of_edges(periods):
    lit = scene()
    found = make_quick_image(counts_of(periods * lit, periods * lit), periods)
    assert (found.name, found.hot_pixels) == ("fired-per-edge", 0)
    np.testing.assert_array_equal(found.image, lit.astype(np.float32))
    half = make_quick_image(counts_of(periods * lit, 0 * lit), periods)
    np.testing.assert_array_equal(half.image, 0.5 * lit.astype(np.float32))


def test_more_events_of_some_pixels_do_not_show_in_a_black_and_white_image():
    lit = scene()
    on = lit.copy()
    on[:30] *= 2
    found = make_quick_image(counts_of(on, lit), 1)
    assert found.name == "fired-per-edge"
    np.testing.assert_array_equal(found.image, lit.astype(np.float32))


def test_several_events_an_edge_carry_grey_levels():
    lit = np.tile(np.repeat([1.0, 0.0], 10), (60, 4))  # stripes: a corner with many events looks hot
    grey = np.where(np.arange(80) < 40, 2.0, 4.0) * lit
    found = make_quick_image(counts_of(2 * grey, 2 * grey), 2)
    assert found.name == "events-per-edge"
    np.testing.assert_allclose(found.image, grey)


def test_hot_pixels_are_counted_and_replaced():
    lit = scene()
    on = lit.copy()
    hot = [(5, 5), (33, 71), (58, 40)]
    for row, column in hot:
        on[row, column] = 60_000
    found = make_quick_image(counts_of(on, lit), 1)
    assert found.hot_pixels == len(hot)
    np.testing.assert_array_equal(found.image, lit.astype(np.float32))


def test_nothing_is_dark():
    found = make_quick_image(np.zeros((2, 6, 8), np.uint16), 1)
    assert found.name == "fired-per-edge"
    assert not found.image.any()


# ---------------------------------------------------------------- grey

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


# ---------------------------------------------------------------- hot pixels

rng = np.random.default_rng(3)

ON = rng.poisson(2.0, (40, 50)).astype(np.uint32)

OFF = rng.poisson(3.0, (40, 50)).astype(np.uint32)

for at in [(0, 0), (39, 49), (1, 20), (17, 0), (30, 30), (30, 31)]:
    ON[at] += 40

ON.ravel()[rng.choice(ON.size, 150, replace=False)] += np.arange(150, dtype=np.uint32) // 6  # near the limits


@pytest.mark.parametrize("allowed", [0, 3, 8, 30])
def test_hot_pixels_are_those_of_the_median_filter(allowed):
    count = (ON + OFF).astype(np.int64)
    around = cv2.medianBlur(count.astype(np.uint16), 5)
    found = accumulation.hot_pixels(ON, OFF, allowed)
    assert found.any()
    np.testing.assert_array_equal(found, 2 * count > 5 * around.astype(np.int64) + 2 * allowed)


def test_hot_pixels_are_replaced_by_the_median_around_them():
    image = rng.normal(size=(40, 50)).astype(np.float32)
    hot = rng.random((40, 50)) < 0.2
    hot[[0, 0, -1, -1], [0, -1, 0, -1]] = True
    expected = np.where(hot, cv2.medianBlur(image, 3), image)
    np.testing.assert_array_equal(accumulation.without_hot_pixels(image, hot), expected)
