"""Image sizes that are too small, too large, or turned."""

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.image_size import check_image_size, require_points_inside
from calib.errors import InputMismatch
from calib.model.camera import CameraModel
from tests.unit.calib.conftest import Bench


@pytest.fixture
def views():
    return Bench().views(np.random.default_rng(1), 0.02)


def of_size(views, size):
    return [replace(view, image_size=size) for view in views]


def camera(size, cx=642.0, cy=363.0):
    return CameraModel(3345.0, 3345.0, cx, cy, size)


@pytest.mark.parametrize("size", [(640, 480), (720, 1280), (1279, 600)])
def test_points_outside_are_refused_with_a_size_that_holds_them(views, size):
    with pytest.raises(InputMismatch, match=r"view pose-001: .*The points fit into 1280 x 720") as raised:
        require_points_inside(of_size(views, size))
    assert f"{size[0]} x {size[1]}" in raised.value.what


def test_points_with_a_corner_origin_may_lie_at_the_border(views):
    points = views[0].points_px.copy()
    points[0], points[1] = (-0.5, -1.0), (1280.0, 719.5)
    require_points_inside([replace(views[0], points_px=points)])
    points[2] = (-1.2, 100.0)
    with pytest.raises(InputMismatch, match=r"outermost at \(-1.2, 100.0\)"):
        require_points_inside([replace(views[0], points_px=points)])


@pytest.mark.parametrize("size", [(1920, 1080), (2048, 1536), (1280, 1280), (2448, 2048)])
def test_a_size_that_is_too_large_is_named_with_a_plausible_one(views, size):
    doubt = check_image_size(of_size(views, size), camera(size), (1.0, 1.0))
    assert doubt.plausible == (1280, 720)
    assert doubt.sentence.endswith("The image size is probably 1280 x 720.")


def test_a_principal_point_far_off_without_a_known_size_is_only_a_doubt(views):
    doubt = check_image_size(views, camera((1280, 720), cx=900.0), (1.0, 1.0))
    assert doubt.plausible is None
    assert "lies 261 px from the middle" in doubt.sentence
    assert doubt.sentence.endswith(
        "Check the image size, and whether the points come from a part of the image."
    )


@pytest.mark.parametrize(("cx", "sigma"), [(642.0, 1.0), (500.0, 1.0), (900.0, 50.0)])
def test_a_plausible_or_uncertain_principal_point_is_no_doubt(views, cx, sigma):
    assert check_image_size(views, camera((1280, 720), cx=cx), (sigma, sigma)) is None
