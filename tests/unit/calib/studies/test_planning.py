"""The expected uncertainty of planned poses."""

from dataclasses import replace

import numpy as np
import pytest

from calib.engine import CalibrationOptions, calibrate
from calib.errors import DegenerateViews, TooFewStars
from calib.model.camera import CameraModel
from calib.model.collimator import Collimator
from calib.model.passport import Passport
from calib.studies.planning import forecast, next_poses
from calib.studies.predicted_views import ExpectedBench
from calib.uncertainty.projection_uncertainty import projection_uncertainty

CAMERA = CameraModel(3345.0, 3345.0, 640.0, 360.0, (1280, 720), {"k1": 0.06, "k2": -0.9})
BENCH = ExpectedBench(CAMERA, Collimator(97.0, 140.1, 255.0), 12.0, 0.05, needs_tag=False)
POSES = [
    {"pan_deg": -5.0, "tilt_deg": 2.0},
    {"pan_deg": 0.5, "tilt_deg": -2.5, "roll_deg": 10.0},
    {"pan_deg": 5.0, "tilt_deg": 2.5, "roll_deg": -20.0},
]


def test_the_forecast_is_what_a_calibration_then_states(bench):
    result = calibrate(bench.views(np.random.default_rng(91), 0.05), CalibrationOptions(loss="l2"))
    expected = forecast(BENCH, POSES)
    for name, sigma in result.sigma.items():
        assert expected.sigma[name] == pytest.approx(sigma, rel=0.1)
    assert expected.projection_map.worst_px == pytest.approx(
        projection_uncertainty(result.camera, result.camera_covariance, 9).worst_px, rel=0.1
    )
    assert expected.stars == pytest.approx([view.n for view in result.views], abs=6)


def test_a_passport_lowers_what_is_expected():
    passport = Passport(("x", "y", "r"), np.array([97.0, 140.1, 255.0]), np.eye(3) * 1e-8)
    known = ExpectedBench(CAMERA, BENCH.collimator, 12.0, 0.05, passport=passport, needs_tag=False)
    assert forecast(known, POSES).sigma["fx"] < 0.1
    assert forecast(known, POSES[:1]).sigma["fx"] < 0.5


def test_the_next_pose_lowers_the_worst_uncertainty_more_than_any_other():
    candidates = [
        {"pan_deg": pan, "tilt_deg": tilt} for pan in (-6.0, -2.0, 2.0, 6.0) for tilt in (-2.5, 0.0, 2.5)
    ]
    (best,) = next_poses(BENCH, POSES[:2], candidates)
    worst = {
        i: forecast(BENCH, [*POSES[:2], pose]).projection_map.worst_px for i, pose in enumerate(candidates)
    }
    assert candidates.index(best.angles_deg) == min(worst, key=lambda i: worst[i])


def test_poses_chosen_from_nothing_beat_random_ones():
    rng = np.random.default_rng(92)
    candidates = [
        {"pan_deg": pan, "tilt_deg": tilt, "roll_deg": roll}
        for pan in (-6.0, 0.0, 6.0)
        for tilt in (-3.0, 0.0, 3.0)
        for roll in (0.0, 90.0)
    ]
    suggested = next_poses(BENCH, [], candidates, 3)
    chosen = forecast(BENCH, [pose.angles_deg for pose in suggested]).projection_map.worst_px
    drawn = [
        forecast(
            BENCH, [candidates[i] for i in rng.choice(len(candidates), 3, replace=False)]
        ).projection_map.worst_px
        for _ in range(15)
    ]
    assert chosen <= np.quantile(drawn, 0.2)


def test_a_pose_that_loses_the_tag_is_named():
    careful = replace(BENCH, needs_tag=True)
    assert forecast(careful, [POSES[0], {"pan_deg": 5.0}]).stars
    with pytest.raises(TooFewStars, match="pose 2: The tag"):
        forecast(careful, [POSES[0], {"pan_deg": 14.0}])
    with pytest.raises(DegenerateViews, match="0 of the candidate poses"):
        next_poses(careful, POSES[:2], [{"pan_deg": 14.0}])


def test_one_pose_twice_will_not_constrain():
    square = {"pan_deg": 0.0}
    with pytest.raises(DegenerateViews, match="cannot separate fx and r"):
        forecast(BENCH, [square])
