"""Errors of the gimbal: each acts as stated, and without them the rotation is that of the angles read."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from simulators.config import bench_config
from simulators.optics.picture import true_rotation
from simulators.world.gimbal import (
    AXES,
    NOISE_STEP_DEG,
    Gears,
    GimbalTruth,
    drawn_errors,
    gimbal_rotation,
    true_angles_deg,
)
from simulators.world.truth import OpticsTruth, Truth

ANGLE = st.floats(-180.0, 180.0)
ANGLES = st.fixed_dictionaries(dict.fromkeys(AXES, ANGLE))
LEVEL = OpticsTruth(mounting_deg=(0.0, 0.0, 0.0))
READINGS = np.arange(-180.0, 180.0, 0.5)


def about(angles):
    """Rz(roll) Rx(tilt) Ry(pan), by another program."""
    ordered = [angles[name] for name in ("pan", "tilt", "roll")]
    return Rotation.from_euler("yxz", ordered, degrees=True).as_matrix()


def apart_deg(first, other):
    return math.degrees(Rotation.from_matrix(first @ other.T).magnitude())


@given(ANGLES, st.tuples(*[st.floats(-20.0, 20.0)] * 3))
def test_without_errors_the_camera_points_where_the_axes_read(angles, mounting_deg):
    mounting = Rotation.from_rotvec(mounting_deg, degrees=True).as_matrix()
    truth = Truth(optics=OpticsTruth(mounting_deg=mounting_deg), gimbal=GimbalTruth(seed=7))
    np.testing.assert_allclose(true_rotation(angles, truth), about(angles) @ mounting, atol=1e-14)


@given(ANGLES)
def test_a_scale_error_turns_6_degrees_into_6_006(angles):
    gimbal = GimbalTruth(scale=(0.001, 0.0, -0.002), seed=3)
    assert true_angles_deg({"pan": 6.0, "roll": 50.0}, gimbal) == pytest.approx((6.006, 0.0, 49.9), abs=1e-12)
    true = {"pan": 1.001 * angles["pan"], "tilt": angles["tilt"], "roll": 0.998 * angles["roll"]}
    np.testing.assert_allclose(gimbal_rotation(angles, gimbal), about(true), atol=1e-12)


@pytest.mark.parametrize("seed", range(1, 6))
def test_eccentricity_has_its_amplitude_and_one_period_a_turn(seed):
    gimbal = GimbalTruth(eccentricity_deg=0.02, seed=seed)
    for axis, name in enumerate(AXES):
        error = np.array([true_angles_deg({name: a}, gimbal)[axis] - a for a in READINGS])
        spectrum = 2.0 * np.abs(np.fft.rfft(error)) / error.size
        assert spectrum[1] == pytest.approx(0.02, rel=1e-9)
        assert spectrum[2:].max() < 1e-9
        assert true_angles_deg({name: 0.0}, gimbal)[axis] == 0.0
        # over a small range it acts as a scale error of amplitude times cos(phase)
        slope = (true_angles_deg({name: 0.1}, gimbal)[axis] - 0.1) / math.radians(0.1)
        assert slope == pytest.approx(0.02 * math.cos(drawn_errors(seed)[axis].phase), abs=1e-4)
    assert len({drawn.phase for drawn in drawn_errors(seed)}) == 3


@pytest.mark.parametrize(("name", "direction"), [("pan", 1), ("tilt", 0), ("roll", 2)])
def test_wobble_tilts_an_axis_about_the_two_other_directions_by_its_rms(name, direction):
    gimbal = GimbalTruth(wobble_deg=0.01, seed=11)
    turns = np.array(
        [
            Rotation.from_matrix(about({**dict.fromkeys(AXES, 0.0), name: a}).T @ gimbal_rotation({name: a}, gimbal))
            .as_rotvec(degrees=True)
            for a in READINGS
        ]
    )  # fmt: skip
    others = [k for k in range(3) if k != direction]
    np.testing.assert_allclose(turns[:, others].std(axis=0), 0.01, rtol=1e-3)
    assert np.abs(turns[:, direction]).max() < 1e-5
    share = np.abs(np.fft.rfft(turns[:, others], axis=0)) ** 2
    assert (share[3:].sum(axis=0) < 1e-6 * share[1:3].sum(axis=0)).all()
    assert (share[1:3].sum(axis=0) > 0.0).all()
    np.testing.assert_array_equal(gimbal_rotation({name: 0.0}, gimbal), np.eye(3))


@given(st.floats(-3.0, 3.0))
def test_the_angle_between_the_axes_differs_from_90_degrees_by_the_non_orthogonality(error_deg):
    gimbal = GimbalTruth(nonorthogonality_deg=error_deg)

    def axis_of(name):
        vector = Rotation.from_matrix(gimbal_rotation({name: 20.0}, gimbal)).as_rotvec()
        return vector / np.linalg.norm(vector)

    between = math.degrees(math.acos(axis_of("pan") @ axis_of("tilt")))
    assert between == pytest.approx(90.0 + error_deg, abs=1e-9)


def test_readings_err_by_their_sigma_and_alike_at_the_same_reading():
    gimbal = GimbalTruth(reading_sigma_deg=0.002, seed=5)
    readings = np.random.default_rng(1).uniform(-10.0, 10.0, 3000)
    errors = np.array([np.subtract(true_angles_deg(dict.fromkeys(AXES, a), gimbal), a) for a in readings])
    np.testing.assert_allclose(errors.std(axis=0), 0.002, rtol=0.1)
    assert np.abs(np.corrcoef(errors.T) - np.eye(3)).max() < 0.15
    assert true_angles_deg({"pan": 3.3}, gimbal) == true_angles_deg({"pan": 3.3}, gimbal)
    fine = [true_angles_deg({"pan": a}, gimbal)[0] - a for a in np.arange(0.0, 0.1, NOISE_STEP_DEG / 200)]
    assert np.abs(np.diff(fine)).max() < 2e-4  # continuous: a moving camera does not jump


@given(ANGLES, st.integers(1, 1000))
def test_a_seed_fixes_all_errors_and_another_seed_gives_others(angles, seed):
    gimbal = GimbalTruth(wobble_deg=0.02, eccentricity_deg=0.02, reading_sigma_deg=0.01, seed=seed)
    once = gimbal_rotation(angles, gimbal)
    np.testing.assert_array_equal(once, gimbal_rotation(dict(angles), replace(gimbal)))
    np.testing.assert_allclose(once @ once.T, np.eye(3), atol=1e-12)
    assert apart_deg(once, gimbal_rotation(angles, replace(gimbal, seed=seed + 1))) > 0.0
    assert apart_deg(once, about(angles)) < 0.5


def test_the_camera_may_stand_crooked_on_its_head():
    crooked = GimbalTruth(camera_on_head_deg=(0.5, -1.0, 3.0))
    head = Rotation.from_rotvec([0.5, -1.0, 3.0], degrees=True).as_matrix()
    angles = {"pan": 5.0, "tilt": -3.0, "roll": 0.0}
    np.testing.assert_allclose(gimbal_rotation(angles, crooked), head @ about(angles), atol=1e-14)


def test_a_load_stands_half_the_play_behind_its_motor():
    gears = Gears(GimbalTruth(backlash_deg=(0.03, 0.01, 0.0)))
    assert gears.load_angles_deg({"pan": 0.0, "tilt": 0.0}) == {"pan": 0.0, "tilt": 0.0}
    for _ in range(2):  # the second time, no axis moves
        assert gears.load_angles_deg({"pan": 2.0, "tilt": -1.0}) == {"pan": 1.985, "tilt": -0.995}


def test_one_section_of_the_configuration_holds_all_errors():
    section = {
        "wobble_deg": 0.005,
        "eccentricity_deg": 0.01,
        "scale": 1e-3,
        "backlash_deg": {"tilt": 0.02},
        "nonorthogonality_deg": -0.1,
        "reading_sigma_deg": 0.002,
        "camera_on_head_deg": [0.1, 0.2, 0.3],
        "seed": 9,
    }
    truth = bench_config({"gimbal": section}).truth_for(4)
    assert truth.gimbal == GimbalTruth(
        0.005, 0.01, (1e-3, 1e-3, 1e-3), (0.0, 0.02, 0.0), -0.1, 0.002, (0.1, 0.2, 0.3), 9
    )


def test_backlash_stands_in_either_section_but_not_in_both():
    own = bench_config({"stage": {"pan": {"backlash_deg": 0.03}, "tilt": {}}})
    of_gimbal = bench_config({"stage": {"pan": {}, "tilt": {}}, "gimbal": {"backlash_deg": {"pan": 0.03}}})
    for config in (own, of_gimbal):
        assert [axis.backlash_deg for axis in config.axes.values()] == [0.03, 0.0]
        assert config.truth_for(1).gimbal.backlash_deg == (0.03, 0.0, 0.0)
    all_axes = bench_config({"gimbal": {"backlash_deg": 0.01}}).truth_for(1)
    assert all_axes.gimbal.backlash_deg == (0.01, 0.01, 0.0)


def test_the_truth_file_holds_what_is_needed_to_compute_the_errors():
    gimbal = GimbalTruth(eccentricity_deg=0.02, wobble_deg=0.01, scale=(1e-3, 0.0, 0.0), seed=3)
    written = Truth(gimbal=gimbal).to_dict()["gimbal"]
    assert written["scale"] == {"pan": 1e-3, "tilt": 0.0, "roll": 0.0}
    phase = math.radians(written["drawn"]["pan"]["phase_deg"])
    by_hand = 1.001 * 6.0 + 0.02 * (math.sin(math.radians(6.0) + phase) - math.sin(phase))
    assert true_angles_deg({"pan": 6.0}, gimbal)[0] == pytest.approx(by_hand, abs=1e-12)
