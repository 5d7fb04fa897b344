"""Quick stars: the same stars as the whole search, good to a few hundredths of a pixel, and named only if they are."""

import dataclasses

import numpy as np
import pytest

from calib.errors import TargetNotFound
from calib.stars.quick import find_stars_quickly
from simulators.optics.picture import TARGET, project, star_centres, true_rotation
from tests.support.live_slices import bench, fired, seen


@pytest.fixture(scope="module")
def truth():
    return bench()


def test_quick_stars_are_where_they_are(truth):
    found = find_stars_quickly(fired(seen(truth)), TARGET)
    assert found.named_by == "tag"
    assert not found.blurred
    rotation = true_rotation({}, truth)
    errors = found.points_px - project(np.asarray(TARGET.positions_mm(found.ids)), rotation, truth)
    assert np.sqrt((errors**2).mean()) < 0.1
    whole, _ = star_centres(truth, rotation, clearance=0.72, border_px=38.0)
    assert len(np.setdiff1d(whole, found.ids)) <= 2


def test_stars_without_a_tag_have_no_ids(truth):
    found = find_stars_quickly(fired(seen(truth, pan=16.0)), TARGET)
    assert len(found.points_px) >= 12
    assert found.tag is None
    assert found.named_by == ""
    assert (found.ids == -1).all()


def test_a_part_of_the_tag_names_the_stars(truth):
    found = find_stars_quickly(fired(seen(truth, tilt=5.5)), TARGET)
    assert (found.tag, found.named_by) == (None, "part of the tag")
    at = project(np.asarray(TARGET.positions_mm(found.ids)), true_rotation({"tilt": 5.5}, truth), truth)
    assert np.abs(found.points_px - at).max() < 0.7


@pytest.mark.parametrize("image", [np.zeros((720, 1280)), np.ones((720, 1280), np.uint8)])
def test_an_image_without_a_pattern_has_no_stars(image):
    found = find_stars_quickly(image, TARGET)
    assert found.tag is None
    assert len(found.ids) == len(found.points_px) == len(found.nodes) == 0


def test_another_tag_is_said(truth):
    with pytest.raises(TargetNotFound, match="tags seen instead: 3"):
        find_stars_quickly(fired(seen(truth)), dataclasses.replace(TARGET, tag_id=7))


def test_shapes_far_out_of_focus_are_no_stars():
    # The pattern shows with its contrast reversed, in an image that follows the logarithm of the light.
    image = np.log(seen(bench(circle_px=24.0), pan=1.0) + 0.03)
    assert np.ptp(image) > 0.3
    assert len(find_stars_quickly(image, TARGET).ids) == 0
