"""The image of a live picture by counts: the same as the exact one where pixels send one event an edge."""

import numpy as np
import pytest

from calib.events.quick_image import make_quick_image


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
