"""Hand-eye check: the readings of the gimbal against the rotations seen."""

import numpy as np
import pytest

from calib.errors import DegenerateViews, InputMismatch
from calib.model.rotation import euler_zxy, exp_map
from calib.studies.hand_eye import check_hand_eye

POSES = [(-5.0, 2.0), (0.0, -2.5), (5.0, 2.5), (3.0, -1.0), (-3.0, 0.5), (0.0, 0.0)]
READINGS = [{"pan_deg": pan, "tilt_deg": tilt} for pan, tilt in POSES]
SIGMA = np.deg2rad(2.0 / 3600)
COVARIANCE = np.eye(18) * SIGMA**2


def seen(rng, scale_pan=1.0, sigma=SIGMA):
    camera_from_head, base_from_target = (
        exp_map(np.array([0.01, -0.02, 0.005])),
        exp_map(np.array([-0.003, 0.004, 0.03])),
    )
    turns = [camera_from_head @ euler_zxy(scale_pan * pan, tilt) @ base_from_target for pan, tilt in POSES]
    return exp_map(sigma * rng.standard_normal((6, 3))) @ np.array(turns)


def test_a_true_gimbal_is_consistent_within_the_cameras_own_noise():
    chi = [check_hand_eye(seen(np.random.default_rng(i)), COVARIANCE, READINGS) for i in range(30)]
    assert chi[0].degrees_of_freedom == 18 - 8
    assert np.mean([one.chi_square for one in chi]) == pytest.approx(10, abs=3.5)
    assert sum(one.consistent for one in chi) >= 29
    assert chi[0].rms_arcsec < 6


def test_a_scale_error_is_found_with_its_uncertainty():
    runs = [
        check_hand_eye(seen(np.random.default_rng(i), scale_pan=1.002), COVARIANCE, READINGS)
        for i in range(30)
    ]
    z = [(one.scale["pan_deg"] - 1.002) / one.scale_sigma["pan_deg"] for one in runs]
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.35)
    assert abs(runs[0].scale["tilt_deg"] - 1.0) < 4 * runs[0].scale_sigma["tilt_deg"]


def test_a_reading_that_is_off_shows_in_arc_seconds():
    wrong = [dict(reading) for reading in READINGS]
    wrong[1]["pan_deg"] += 60.0 / 3600
    found = check_hand_eye(seen(np.random.default_rng(5)), COVARIANCE, wrong)
    assert not found.consistent
    assert np.linalg.norm(found.residuals_arcsec, axis=1).argmax() == 1
    assert np.abs(found.residuals_arcsec[1]).max() > 25


def test_a_turntable_has_one_scale_and_no_more():
    poses = [-5.0, -2.0, 1.0, 4.0]
    turns = np.array([exp_map(np.array([0.01, 0.0, 0.02])) @ euler_zxy(1.001 * pan, 0.0) for pan in poses])
    found = check_hand_eye(turns, np.eye(12) * SIGMA**2, [{"pan_deg": pan} for pan in poses])
    assert list(found.scale) == ["pan_deg"]
    assert found.scale["pan_deg"] == pytest.approx(1.001, abs=1e-9)
    # A turn about the axis itself belongs to the mounting as well as to the foot.
    assert found.degrees_of_freedom == 12 - 6


@pytest.mark.parametrize(
    ("readings", "error", "match"),
    [
        (READINGS[:5], InputMismatch, "6 rotations, but 5"),
        ([{"yaw_deg": 1.0}] * 6, InputMismatch, "Known: pan_deg"),
        ([{"pan_deg": 1.0}] * 6, DegenerateViews, "0 axes moved"),
    ],
)
def test_readings_that_say_nothing_are_refused(readings, error, match):
    with pytest.raises(error, match=match):
        check_hand_eye(seen(np.random.default_rng(6)), COVARIANCE, readings)
