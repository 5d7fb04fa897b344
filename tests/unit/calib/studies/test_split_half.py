"""Two halves of the views, calibrated apart."""

import numpy as np
import pytest

from calib.engine import CalibrationOptions
from calib.errors import DegenerateViews
from calib.studies.split_half import split_half

POSES = ((-5, 2), (0.5, -2.5, 10), (5, 2.5, -20), (-3, -2, 60), (3, 0, 130), (-1, 1, 200))


def test_halves_of_ideal_views_differ_as_expected(bench):
    ratios = [split_half(bench.views(np.random.default_rng(i), 0.05, poses=POSES)).ratio for i in range(8)]
    assert 0.5 < np.sqrt(np.mean(np.square(ratios))) < 1.8


def test_a_moving_centre_makes_the_halves_differ_more_than_noise_would(bench):
    rng = np.random.default_rng(3)
    centres = np.array(bench.centre) + rng.normal(scale=0.5, size=(6, 3))
    found = split_half(bench.views(rng, 0.05, poses=POSES, centres=centres), CalibrationOptions("spherical"))
    steady = split_half(
        bench.views(np.random.default_rng(3), 0.05, poses=POSES), CalibrationOptions("spherical")
    )
    assert found.difference.rms_px > 3 * steady.difference.rms_px
    assert found.expected_px > 3 * steady.expected_px


def test_three_views_make_no_halves(bench):
    with pytest.raises(DegenerateViews, match="at least 4"):
        split_half(bench.views())
