"""The beam's disc in a picture against the true disc."""

import numpy as np
import pytest

from calib.stars.beam import find_beam
from simulators.optics.picture import beam_of, disc_of, project, true_rotation
from tests.support.live_slices import bench, fired, seen


def true_disc(truth, **angles_deg):
    """Centre and radius of the disc in the image, px, by points of its edge."""
    rotation = true_rotation(angles_deg, truth)
    disc = disc_of(beam_of(truth), rotation)
    turn = np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)
    edge = np.column_stack([disc.x + disc.radius * np.cos(turn), disc.y + disc.radius * np.sin(turn)])
    points = project(edge, rotation, truth)
    middle = points.mean(axis=0)
    return middle, np.hypot(*(points - middle).T).mean()


@pytest.mark.parametrize("circle_px", [0.0, 18.0])
@pytest.mark.parametrize(
    "angles", [{"pan": 6.0}, {"pan": -7.0, "tilt": 2.0}, {"tilt": -8.0}, {"pan": 9.0, "tilt": 5.0}]
)
def test_the_disc_is_the_true_one_to_some_per_cent(angles, circle_px):
    truth = bench(circle_px=circle_px)
    share = seen(truth, **angles)
    beam = find_beam(fired(share))
    centre, radius = true_disc(truth, **angles)
    assert beam.rim_in_view
    assert beam.share == pytest.approx(covered(centre, radius), abs=0.06)
    assert beam.radius_px == pytest.approx(radius, rel=0.08)
    assert np.hypot(*(np.array(beam.centre_px) - centre)) < 0.09 * radius


@pytest.mark.parametrize(
    "angles", [{"pan": 5.5, "tilt": -4.5}, {"pan": 3.4, "tilt": -2.8}, {"pan": -7.0}, {"tilt": -8.0}]
)
def test_with_the_radius_known_a_ragged_short_arc_shows_the_centre(angles):
    truth = bench(circle_px=15.0)
    centre, radius = true_disc(truth, **angles)
    beam = find_beam(fired(seen(truth, **angles)), radius_px=float(radius))
    assert beam.radius_px == pytest.approx(radius)
    assert np.hypot(*(np.array(beam.centre_px) - centre)) < 0.15 * radius


def test_a_short_arc_alone_shows_no_circle():
    v, u = np.indices((720, 1280))
    image = (np.hypot(u - 3300.0, v - 359.5) < 2900.0).astype(np.float32)  # an arc of 14 degrees
    beam = find_beam(image)
    assert beam.rim_in_view
    assert (beam.centre_px, beam.radius_px) == (None, None)
    known = find_beam(image, radius_px=2900.0)
    assert known.centre_px == pytest.approx((3300.0, 359.5), abs=30.0)


def test_a_rim_that_does_not_fit_the_known_radius_shows_no_circle():
    v, u = np.indices((720, 1280))
    small = (np.hypot(u - 700.0, v - 350.0) < 200.0).astype(np.float32)
    assert find_beam(small, radius_px=200.0).centre_px == pytest.approx((700.0, 350.0), abs=5.0)
    assert find_beam(small, radius_px=600.0).centre_px is None


def covered(centre, radius):
    """Share of the frame inside a circle."""
    v, u = np.indices((720, 1280))
    return float((np.hypot(u - centre[0], v - centre[1]) < radius).mean())


def test_a_beam_that_fills_the_frame_shows_no_rim():
    beam = find_beam(np.ones((720, 1280), np.float32))
    assert (beam.share, beam.rim_in_view, beam.centre_px) == (1.0, False, None)


def test_no_light_is_no_beam():
    noise = (np.random.default_rng(1).random((720, 1280)) < 0.01).astype(np.float32)
    for image in (np.zeros((720, 1280), np.uint8), noise):
        beam = find_beam(image, least=0.3)
        assert (beam.share, beam.rim_in_view, beam.centre_px) == (0.0, None, None)


def test_hot_pixels_are_no_beam():
    image = np.zeros((720, 1280), np.float32)
    image[np.random.default_rng(2).integers(0, 720, 300), np.random.default_rng(3).integers(0, 1280, 300)] = (
        100.0
    )
    assert find_beam(image, least=0.3).share == 0.0


@pytest.mark.parametrize("shape", [(1, 1), (8, 8), (3, 200)])
def test_small_images_do_not_fail(shape):
    assert find_beam(np.zeros(shape)).share == 0.0
    assert find_beam(np.ones(shape)).share == 1.0


def test_dark_corners_show_a_rim_but_no_circle():
    beam = find_beam(fired(seen(bench(), pan=1.0)))
    assert beam.rim_in_view
    assert (beam.centre_px, beam.radius_px) == (None, None)
    assert beam.share > 0.96
