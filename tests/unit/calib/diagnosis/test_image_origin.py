"""Half-pixel origins: decided against a known camera or other views, or named as undecidable."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.adjustment.levenberg_marquardt import Loss, refine
from calib.calibration import CalibrationOptions
from calib.diagnosis.image_origin import find_other_origins, origin_offset
from calib.fit.starts import initialize
from calib.model.camera import CameraModel
from calib.model.collimator import Collimator
from tests.unit.calib.conftest import Bench

POSES = (
    (-5, 2),
    (0.5, -2.5, 10),
    (5, 2.5, -20),
    (0, 0, 45),
    (-5, -2, 90),
    (5, -2, 0),
    (0, 2.5, -60),
    (-3, 2, 20),
)
BENCH = Bench()
CAMERA = CameraModel(BENCH.fx, BENCH.fy, BENCH.cx, BENCH.cy, BENCH.size, {"k1": 0.06, "k2": -0.9})
COLLIMATOR = Collimator(97.0, 140.1, 255.0)


def views_of(seed, sigma=0.02, poses=POSES):
    return BENCH.views(np.random.default_rng(seed), sigma, poses=poses)


def moved(view, by):
    return replace(view, points_px=view.points_px + by)


def others(views):
    bundle, start = initialize(views, CalibrationOptions(), "spherical")
    return find_other_origins(views, bundle, refine(bundle, start, Loss("l2"), 60).parameters)


@pytest.mark.parametrize("collimator", [COLLIMATOR, None])
@pytest.mark.parametrize(
    ("by", "where"), [(0.5, "right and 0.5[0-9] px down"), (-0.5, "left and 0.[45]. px up")]
)
def test_half_a_pixel_against_a_known_camera_is_named(collimator, by, where):
    found = origin_offset([moved(view, by) for view in views_of(1, 0.01)], CAMERA, collimator)
    assert found.offset_px == pytest.approx([by, by], abs=4 * max(found.sigma_px))
    assert found.half_pixel
    assert not found.agrees
    assert found.sentence.startswith("All points lie 0.")
    assert found.sentence.endswith("check --origin.")


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 999))
def test_the_offset_of_the_same_origin_is_zero_within_its_sigma(seed):
    found = origin_offset(views_of(seed), CAMERA, COLLIMATOR)
    assert found.decided
    assert np.abs(np.array(found.offset_px) / found.sigma_px).max() < 4.5
    assert not found.half_pixel


def test_another_offset_is_not_called_an_origin():
    found = origin_offset([moved(view, [1.2, -0.8]) for view in views_of(2)], CAMERA, COLLIMATOR)
    assert not found.half_pixel
    assert "right and 0." in found.sentence
    assert found.sentence.endswith("part of the image.")


@pytest.mark.parametrize("known_to", [(0.0, 0.0), (0.3, 0.3)])
def test_one_view_or_a_poorly_known_camera_cannot_decide(known_to):
    poses = POSES[:1] if known_to == (0.0, 0.0) else POSES
    views = [moved(view, 0.5) for view in views_of(3, poses=poses)]
    found = origin_offset(views, CAMERA, COLLIMATOR, camera_sigma_px=known_to)
    assert not found.decided
    assert not found.half_pixel
    assert found.sentence.startswith("These views cannot decide")


@pytest.mark.parametrize("by", [0.5, -0.5])
def test_a_few_views_with_another_origin_are_named(by):
    views = views_of(4, 0.005)
    for place in (1, 4):
        views[place] = moved(views[place], by)
    found = others(views)
    assert found.views == ("pose-002", "pose-005")
    assert found.offset_px == pytest.approx([by, by], abs=4 * found.sigma_px)
    assert "The points of views pose-002, pose-005 lie" in found.sentence


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 999), count=st.integers(2, 8))
def test_views_of_one_origin_are_not_doubted(seed, count):
    assert others([moved(view, 0.5) for view in views_of(seed, poses=POSES[:count])]) is None
