"""Half-pixel origins of some views, decided against the other views."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.adjustment.levenberg_marquardt import refine
from calib.adjustment.loss import Loss
from calib.calibration import CalibrationOptions
from calib.diagnosis.image_origin import find_other_origins
from calib.fit import initialize
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


def views_of(seed, sigma=0.02, poses=POSES):
    return BENCH.views(np.random.default_rng(seed), sigma, poses=poses)


def moved(view, by):
    return replace(view, points_px=view.points_px + by)


def others(views):
    bundle, start = initialize(views, CalibrationOptions(), "spherical")
    return find_other_origins(views, bundle, refine(bundle, start, Loss("l2"), 60).parameters)


@pytest.mark.parametrize("by", [0.5, -0.5])
def test_a_few_views_with_another_origin_are_named(by):
    views = views_of(4, 0.005)
    for place in (1, 4):
        views[place] = moved(views[place], by)
    found = others(views)
    assert found.views == ("pose-002", "pose-005")
    assert found.offset_px == pytest.approx([by, by], abs=4 * found.sigma_px)
    assert "The points of views pose-002, pose-005 lie" in found.sentence


@pytest.mark.parametrize(("noise_px", "named"), [(0.02, True), (0.03, False)])
def test_an_offset_that_noise_could_explain_is_not_named(noise_px, named):
    """In the noisier views, half a pixel is between 2.5 and 5 standard uncertainties."""
    views = views_of(0, noise_px)
    for place in (1, 4):
        views[place] = moved(views[place], 0.5)
    assert (others(views) is not None) == named


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 999), count=st.integers(2, 8))
def test_views_of_one_origin_are_not_doubted(seed, count):
    assert others([moved(view, 0.5) for view in views_of(seed, poses=POSES[:count])]) is None
