"""A tag that cannot be read is still a dark square: found where the true tag is, and nothing else is taken for one."""

import cv2
import numpy as np
import pytest

from calib.stars.beam import find_beam
from calib.stars.quick import find_stars_quickly
from calib.stars.tag import find_dark_square
from simulators.optics.picture import TARGET, project, true_rotation
from tests.support.live_slices import bench, fired, seen


def true_tag(truth, angles_deg):
    """Centre and side of the tag in the image, px."""
    corners = project(np.asarray(TARGET.tag_corners_mm), true_rotation(angles_deg, truth), truth)
    return corners.mean(axis=0), np.hypot(*(corners[1] - corners[0]))


@pytest.mark.parametrize(("circle_px", "roll_deg"), [(8.0, 1.0), (15.0, 1.0), (15.0, 10.0)])
@pytest.mark.parametrize(
    ("angles", "borders"),
    [
        ({"pan": 2.0, "tilt": 1.0}, ()),
        ({"pan": 5.5, "tilt": -4.5}, ("lower",)),
        ({"pan": 1.0, "tilt": -5.2}, ("lower",)),
        ({"pan": 10.0, "tilt": 1.0}, ("right",)),
    ],
)
def test_the_square_is_where_the_tag_is(circle_px, roll_deg, angles, borders):
    truth = bench(circle_px=circle_px, roll_deg=roll_deg)
    image = fired(seen(truth, **angles))
    centre, side = true_tag(truth, angles)
    for known_px in (float(side), None):
        square = find_dark_square(image, find_beam(image), side_px=known_px)
        assert square.borders == borders
        assert np.hypot(*(np.array(square.centre_px) - centre)) < 0.05 * side
        assert square.side_px == pytest.approx(side, rel=0.12)


def test_a_bright_picture_out_of_focus_shows_a_square_although_no_tag_is_recognised():
    truth = bench(circle_px=15.0, roll_deg=0.0)
    image = fired(seen(truth, pan=5.5, tilt=-4.5))
    assert find_stars_quickly(image, TARGET).tag is None
    assert find_dark_square(image, find_beam(image)) is not None


@pytest.mark.parametrize("angles", [{"pan": 14.0}, {"pan": -13.0, "tilt": 3.0}])
@pytest.mark.parametrize("circle_px", [0.0, 15.0])
def test_a_picture_without_the_tag_shows_no_square(angles, circle_px):
    image = fired(seen(bench(circle_px=circle_px), **angles))
    assert find_dark_square(image, find_beam(image), side_px=208.0) is None
    assert find_dark_square(image, find_beam(image)) is None


def picture(draw):
    """A lit picture of 1280 x 720 px with something dark drawn on it."""
    image = np.ones((720, 1280), np.uint8) * 200
    draw(image)
    return image


@pytest.mark.parametrize(
    "draw",
    [
        lambda image: cv2.rectangle(image, (500, 300), (700, 500), 5, -1),  # no light inside
        lambda image: cv2.circle(image, (600, 400), 110, 5, 40),
        lambda image: cv2.rectangle(image, (300, 300), (700, 500), 5, 30),  # twice as long as high
        lambda image: cv2.line(image, (0, 100), (1279, 600), 5, 40),
        lambda image: image[:, :640].fill(5),
        lambda image: image.fill(0),
        lambda image: None,
    ],
)
def test_other_shapes_are_no_square(draw):
    image = picture(draw)
    assert find_dark_square(image, find_beam(image)) is None


def test_a_hollow_square_is_one():
    image = picture(lambda image: cv2.rectangle(image, (520, 320), (680, 480), 5, 40))
    assert find_dark_square(image, find_beam(image)).centre_px == pytest.approx((600.0, 400.0), abs=4.0)
    assert find_dark_square(image, find_beam(image), side_px=600.0) is None
