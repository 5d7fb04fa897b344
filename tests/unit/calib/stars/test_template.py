"""Tests of the samples of stars: any number of places, and places outside of the image."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from calib.stars.growth import search_stars
from calib.stars.template import SEARCH_RADII, StarTemplate, correlations, values_at


def test_more_rows_of_places_than_opencv_takes_are_interpolated() -> None:
    image = np.add.outer(2.0 * np.arange(40), np.arange(50)).astype(np.float32)
    x, y = np.random.default_rng(1).uniform(0.0, 38.0, (2, 40_000, 3))
    assert_allclose(values_at(image, x, y), 2.0 * y + x, atol=1e-4)
    assert np.isnan(values_at(image, x - 60.0, y)).all()


def test_large_stars_are_searched_in_a_wide_circle() -> None:
    template = StarTemplate.of(16, SEARCH_RADII)
    v, u = np.mgrid[:700, :700] - 350.0
    white = np.floor(16 * ((np.arctan2(v, u) / (2 * np.pi) - 0.25) % 1.0)) % 2 == 0
    guesses, linear = np.tile([371.0, 330.0], (12, 1)), np.tile(200.0 * np.eye(2), (12, 1, 1))
    at, score = search_stars(white.astype(np.float32), guesses, linear, np.full(12, 30.0), template, 1.0)
    assert_allclose(at, 350.0, atol=4.0)
    assert (score > 0.9).all()


@pytest.mark.parametrize("outside", [0, 20, 40])
def test_a_correlation_leaves_out_what_lies_outside(outside: int) -> None:
    template = StarTemplate.of(16)
    seen = np.tile(3.0 + template.values, (4, 1)).astype(np.float32)
    seen[1, : len(template.values) * outside // 100] = np.nan
    found = correlations(seen, template)
    assert_allclose(found[[0, 2, 3]], 1.0, atol=1e-5)
    assert np.isnan(found[1]) == (outside > 20)
    assert outside > 20 or abs(found[1] - 1.0) < 0.01
