"""Stars at a glance, and the search for them."""

import dataclasses

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from calib.errors import TargetNotFound
from calib.stars.centring import centre_information, solve_steps
from calib.stars.growth import search_stars
from calib.stars.quick import find_stars_quickly
from calib.stars.template import SEARCH_RADII, StarTemplate, correlations, star_contrasts, values_at
from simulators.optics.picture import TARGET, project, star_centres, true_rotation
from simulators.world.truth import CameraTruth
from tests.support.live_slices import bench, fired, seen


@pytest.fixture(scope="module")
def truth():
    return bench()


def test_quick_stars_are_where_they_are(truth):
    stars = find_stars_quickly(fired(seen(truth)), TARGET)
    assert stars.named_by == "tag"
    assert not stars.blurred
    rotation = true_rotation({}, truth)
    errors = stars.points_px - project(np.asarray(TARGET.positions_mm(stars.ids)), rotation, truth)
    assert np.sqrt((errors**2).mean()) < 0.1
    whole, _ = star_centres(truth, rotation, clearance=0.72, border_px=38.0)
    assert len(np.setdiff1d(whole, stars.ids)) <= 2


def test_stars_without_a_tag_have_no_ids(truth):
    stars = find_stars_quickly(fired(seen(truth, pan=16.0)), TARGET)
    assert len(stars.points_px) >= 12
    assert stars.tag is None
    assert stars.named_by == ""
    assert (stars.ids == -1).all()


def test_a_part_of_the_tag_names_the_stars(truth):
    stars = find_stars_quickly(fired(seen(truth, tilt=5.5)), TARGET)
    assert (stars.tag, stars.named_by) == (None, "part of the tag")
    at = project(np.asarray(TARGET.positions_mm(stars.ids)), true_rotation({"tilt": 5.5}, truth), truth)
    assert np.abs(stars.points_px - at).max() < 0.7


def test_stars_are_found_between_large_dust_on_a_small_sensor():
    camera = CameraTruth(width=640, height=360, fx=1672, fy=1672, cx=320, cy=180)
    image = fired(seen(bench(camera=camera), tilt=-3.0))
    drops = np.random.default_rng(2)
    for _ in range(40):
        at = int(drops.uniform(0, 640)), int(drops.uniform(0, 360))
        cv2.circle(image, at, int(drops.uniform(4, 14)), 0.0, -1)
    stars = find_stars_quickly(image, TARGET)
    assert stars.named_by == "part of the tag"
    assert len(stars.ids) > 150


@pytest.mark.parametrize("image", [np.zeros((720, 1280)), np.ones((720, 1280), np.uint8)])
def test_an_image_without_a_pattern_has_no_stars(image):
    stars = find_stars_quickly(image, TARGET)
    assert stars.tag is None
    assert len(stars.ids) == len(stars.points_px) == len(stars.nodes) == 0


def test_another_tag_is_said(truth):
    with pytest.raises(TargetNotFound, match="tags seen instead: 3"):
        find_stars_quickly(fired(seen(truth)), dataclasses.replace(TARGET, tag_id=7))


def test_shapes_far_out_of_focus_are_no_stars():
    # The pattern shows with its contrast reversed, in an image that follows the logarithm of the light.
    image = np.log(seen(bench(circle_px=24.0), pan=1.0) + 0.03)
    assert np.ptp(image) > 0.3
    assert len(find_stars_quickly(image, TARGET).ids) == 0


# ---------------------------------------------------------------- the search

random = np.random.default_rng(7)

TEMPLATE = StarTemplate.of(16, SEARCH_RADII)

IMAGE = random.normal(200.0, 5.0, (90, 120)).astype(np.float32)

LINEAR = np.array([[22.0, 6.0], [-7.0, 21.0]])


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("guess", [(60.2, 45.7), (8.4, 45.1), (60.0, 82.3), (111.6, 45.5)])
def test_the_best_place_is_found(guess, sign):
    """The last guesses are so close to the border that parts of the star lie outside."""
    reach = 3.3
    at_px, score = search_stars(IMAGE, np.array([guess]), LINEAR[None], np.array([reach]), TEMPLATE, sign)
    steps = np.arange(-4, 5)
    moves = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    places = guess + moves[(moves**2).sum(axis=1) <= reach**2 + 0.5]
    shapes = np.broadcast_to(LINEAR, (len(places), 2, 2)).copy()
    expected, _ = star_contrasts(IMAGE, places, shapes, TEMPLATE, sign)
    assert np.isfinite(expected).any()
    assert score[0] == pytest.approx(np.nanmax(expected), abs=1e-4)
    np.testing.assert_allclose(at_px[0], places[np.nanargmax(expected)])


def test_no_place_is_found_outside_of_the_image():
    guesses = np.array([[-20.0, 45.0], [60.0, 110.0]])
    at_px, score = search_stars(IMAGE, guesses, np.array([LINEAR, LINEAR]), np.full(2, 3.0), TEMPLATE, 1.0)
    assert np.isnan(at_px).all()
    assert np.isnan(score).all()


@pytest.mark.parametrize("brightness", [0.0, 0.1, 1.0, 255.0, 60000.0])
@pytest.mark.parametrize("middle", [1.0, 0.37, 0.0])
def test_a_flat_image_shows_no_star(brightness, middle):
    flat = np.full(IMAGE.shape, brightness, np.float32)
    flat[45, 60] *= middle  # none of the samples lies there
    _, score = search_stars(flat, np.array([[60.2, 45.7]]), LINEAR[None], np.array([3.0]), TEMPLATE, 1.0)
    assert score[0] == 0.0


# ---------------------------------------------------------------- centring


def equations(smallest, random):
    """Return normal equations with unknowns in different units, and their exact solution."""
    q, _ = np.linalg.qr(random.normal(size=(6, 6)))
    units = np.diag([1.0, 1.0, 100.0, 100.0, 7.0, 7.0])
    return units @ q @ np.diag([1.0, 1.0, 1.0, 1.0, 1.0, smallest]) @ q.T @ units, random.normal(size=6)


def test_each_step_solves_the_equations_of_its_star():
    random = np.random.default_rng(4)
    normal, solution = map(np.array, zip(*(equations(c, random) for c in (1.0, 1e-2, 1e-6)), strict=True))
    right = np.einsum("nkm,nm->nk", normal, solution)
    regular, step = solve_steps(normal, right)
    assert regular.all()
    np.testing.assert_allclose(np.einsum("nkm,nm->nk", normal, step), right, rtol=1e-9, atol=1e-6)
    expected = np.linalg.inv(np.linalg.inv(normal)[:, :2, :2])
    np.testing.assert_allclose(centre_information(normal), expected, rtol=1e-4)


@pytest.mark.parametrize("flat", [np.zeros((6, 6)), np.ones((6, 6)), np.full((6, 6), np.nan)])
def test_a_flat_image_determines_no_step_and_leaves_other_stars_theirs(flat):
    lit, solution = equations(0.1, np.random.default_rng(6))
    regular, step = solve_steps(np.array([flat, lit]), np.array([np.ones(6), lit @ solution]))
    assert list(regular) == [False, True]
    np.testing.assert_array_equal(step[0], 0.0)
    np.testing.assert_allclose(step[1], solution, rtol=1e-9)


def test_a_matrix_that_is_nearly_singular_determines_no_step():
    normal, _ = equations(1e-14, np.random.default_rng(5))
    assert not solve_steps(normal[None], np.ones((1, 6)))[0].any()


# ---------------------------------------------------------------- samples of stars: any number of places, and places outside of the image


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
    correlation = correlations(seen, template)
    assert_allclose(correlation[[0, 2, 3]], 1.0, atol=1e-5)
    assert np.isnan(correlation[1]) == (outside > 20)
    assert outside > 20 or abs(correlation[1] - 1.0) < 0.01
