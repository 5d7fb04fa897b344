"""Search of a star around a guess, compared with the correlation at each single place."""

import numpy as np
import pytest

from calib.stars.star_search import search_stars
from calib.stars.template import SEARCH_RADII, StarTemplate, star_contrasts

random = np.random.default_rng(7)
TEMPLATE = StarTemplate.of(16, SEARCH_RADII)
IMAGE = random.normal(200.0, 5.0, (90, 120)).astype(np.float32)
LINEAR = np.array([[22.0, 6.0], [-7.0, 21.0]])


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("guess", [(60.2, 45.7), (8.4, 45.1), (60.0, 82.3), (111.6, 45.5)])
def test_the_best_place_is_found(guess, sign):
    """The last guesses are so close to the border that parts of the star lie outside."""
    reach = 3.3
    found, score = search_stars(IMAGE, np.array([guess]), LINEAR[None], np.array([reach]), TEMPLATE, sign)
    steps = np.arange(-4, 5)
    moves = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    places = guess + moves[(moves**2).sum(axis=1) <= reach**2 + 0.5]
    shapes = np.broadcast_to(LINEAR, (len(places), 2, 2)).copy()
    expected, _ = star_contrasts(IMAGE, places, shapes, TEMPLATE, sign)
    assert np.isfinite(expected).any()
    assert score[0] == pytest.approx(np.nanmax(expected), abs=1e-4)
    np.testing.assert_allclose(found[0], places[np.nanargmax(expected)])


def test_no_place_is_found_outside_of_the_image():
    guesses = np.array([[-20.0, 45.0], [60.0, 110.0]])
    found, score = search_stars(IMAGE, guesses, np.array([LINEAR, LINEAR]), np.full(2, 3.0), TEMPLATE, 1.0)
    assert np.isnan(found).all()
    assert np.isnan(score).all()


@pytest.mark.parametrize("brightness", [0.0, 0.1, 1.0, 255.0, 60000.0])
@pytest.mark.parametrize("middle", [1.0, 0.37, 0.0])
def test_a_flat_image_shows_no_star(brightness, middle):
    flat = np.full(IMAGE.shape, brightness, np.float32)
    flat[45, 60] *= middle  # none of the samples lies there
    _, score = search_stars(flat, np.array([[60.2, 45.7]]), LINEAR[None], np.array([3.0]), TEMPLATE, 1.0)
    assert score[0] == 0.0
