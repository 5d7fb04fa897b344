"""The model is chosen by views it has not seen."""

import numpy as np
import pytest

from calib.calibrate import CalibrationOptions, calibrate
from calib.errors import DegenerateViews
from calib.selection import left_out_rms_px

AUTO = CalibrationOptions(model="auto", loss="l2")
POSES = ((-5, 2), (0.5, -2.5, 10), (5, 2.5, -20), (-3, -2, 60), (3, 0, 130))


def test_an_ideal_collimator_is_spherical(bench):
    result = calibrate(bench.views(np.random.default_rng(41), 0.05, poses=POSES), AUTO)
    assert result.model == "spherical"
    spherical, planar = result.candidates
    assert spherical.left_out_rms_px == pytest.approx(0.05 * np.sqrt(2), rel=0.15)
    assert spherical.left_out_rms_px < planar.left_out_rms_px
    assert spherical.bic < planar.bic
    assert (spherical.parameters, planar.parameters) == (9 + 15, 6 + 30)
    assert any("spherical" in note for note in result.notes)


def test_a_wandering_centre_makes_the_spherical_model_lose_on_bic_and_residuals(bench):
    rng = np.random.default_rng(42)
    centres = np.array(bench.centre) + rng.normal(scale=[4.0, 4.0, 8.0], size=(5, 3))
    result = calibrate(bench.views(rng, 0.05, poses=POSES, centres=centres), AUTO)
    spherical, planar = result.candidates
    assert planar.rms_px == pytest.approx(0.05 * np.sqrt(2), rel=0.1)
    assert spherical.rms_px > 5 * planar.rms_px
    assert planar.bic < spherical.bic


def test_two_views_take_the_spherical_model_and_say_so(bench):
    result = calibrate(bench.views(np.random.default_rng(43), 0.05)[:2], AUTO)
    assert result.model == "spherical"
    assert "Two views cannot choose" in result.notes[-1]
    assert all(candidate.left_out_rms_px is None for candidate in result.candidates)


def test_leaving_one_out_of_two_is_refused(bench):
    views = bench.views(np.random.default_rng(44), 0.05)[:2]
    with pytest.raises(DegenerateViews, match="at least 3"):
        left_out_rms_px(views, calibrate(views), AUTO)


def test_when_no_model_fits_the_first_reason_is_given(bench):
    with pytest.raises(DegenerateViews, match="same pose"):
        calibrate(bench.views(poses=((1, 1),) * 3), AUTO)
