"""Beside a result: halves of the poses, the gimbal's readings, the worst corner, and where stars support it."""

import json
from dataclasses import asdict

import numpy as np
import pytest
from expected_stars import expected_views

from bench.base.bounded_json import canonical_json
from bench.solve.checks import gimbal_check, split_half_check
from bench.solve.results_content import projection_facts
from calib.diagnosis.hand_eye_result import OFF_SCALE
from calib.engine import CalibrationOptions, calibrate
from calib.model.camera import CameraModel
from calib.model.cause import SLIPPED

POSES = [(-6, 2), (6, 2), (0, -3), (3, 3), (-4, -2), (5, -2), (-3, 0), (2, 1)]


@pytest.fixture(scope="module")
def views():
    return expected_views([(f"{pan} {tilt}", pan, tilt) for pan, tilt in POSES], sigma_px=0.02, seed=3)


@pytest.fixture(scope="module")
def calibration(views):
    return calibrate(views, CalibrationOptions())


def test_halves_differ_by_no_more_than_their_uncertainties_say_and_few_views_have_none(views):
    quick = CalibrationOptions("spherical", distortion="k1")
    check = split_half_check(views, quick)
    assert 0.0 < check.ratio < 2.5
    assert check.worst_px >= check.rms_px > 0
    assert split_half_check(views[:3], quick) is None


def test_the_gimbal_is_held_against_the_rotations_by_its_encoders(calibration, views):
    readings = [
        {"pan": pan + 1.0, "tilt": tilt, "pan_encoder": pan / 0.998, "tilt_encoder": tilt}
        for pan, tilt in POSES
    ]
    check = gimbal_check(calibration, views, readings)
    for axis, scale in (("pan_deg", 0.998), ("tilt_deg", 1.0)):
        assert check.scale[axis] == pytest.approx(scale, abs=4 * check.scale_sigma[axis])
    assert (check.verdict, check.agrees) == (OFF_SCALE, False)
    assert (check.slip, check.faults) == (None, [])
    assert check.pairs["count"] == 28
    assert json.loads(canonical_json(check)) == asdict(check)
    assert gimbal_check(calibration, views, [{"pan": 0.0}] * len(POSES)) is None


def test_a_slip_among_small_angles_is_stated_with_pose_and_size(calibration, views):
    readings = [
        {"pan": pan, "tilt": tilt + (0.2 if index >= 5 else 0.0)} for index, (pan, tilt) in enumerate(POSES)
    ]
    check = gimbal_check(calibration, views, readings)
    (fault,) = check.faults
    assert (check.agrees, fault["pose"], fault["claimed"]) == (False, 5, True)
    assert abs(fault["size_deg"]) == pytest.approx(0.2, abs=5 * fault["sigma_deg"])
    assert "between the poses '-4 -2' and '5 -2'" in check.says[0]
    assert check.verdict == SLIPPED
    assert json.loads(canonical_json(check)) == asdict(check)


# ---------------------------------------------------------------- corners

CAMERA = CameraModel(3345.0, 3345.0, 639.5, 359.5, (1280, 720), {"k1": 0.0})

COVARIANCE = np.diag([1.0, 1.0, 1e-6, 1e-6, 1e-8])


def test_the_worst_corner_has_px_and_microradians_with_the_factor():
    grid = np.meshgrid(np.arange(300, 990, 40.0), np.arange(100, 620, 40.0))
    stars = np.stack(grid, axis=-1).reshape(-1, 2)
    facts = projection_facts(CAMERA, COVARIANCE, 2.0, [stars])
    worst = facts.worst_corner
    assert worst.corner in {"top left", "top right", "bottom left", "bottom right"}
    # at the corner, a px is 1/f of the tangent, less the cosine squared of 12.4 degrees
    assert worst.expanded_urad == pytest.approx(1e6 * worst.expanded_px / 3345.0, rel=0.06)
    assert worst.expanded_px > facts.median.expanded_px
    once = projection_facts(CAMERA, COVARIANCE, 1.0, [stars])
    assert worst.expanded_px == pytest.approx(2 * once.worst_corner.expanded_px)
    assert 0.4 < facts.supported.share < 0.75
    assert facts.supported.expanded_px < worst.expanded_px


def test_stars_at_one_place_support_little_and_no_stars_nothing():
    facts = projection_facts(CAMERA, COVARIANCE, 2.0, [np.array([[640.0, 360.0]])])
    reached_px2 = np.pi * facts.supported.reach_px**2
    assert facts.supported.share == pytest.approx(reached_px2 / (1280 * 720), rel=0.01)
    assert projection_facts(CAMERA, COVARIANCE, 2.0, []).supported is None
