"""Rotations."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.model.rotation import euler_zxy, exp_map, log_map, nearest_rotation, skew

RNG = np.random.default_rng(3)


def test_exponential_agrees_with_rodrigues_formula_of_opencv():
    vectors = RNG.normal(size=(20, 3))
    expected = [cv2.Rodrigues(v)[0] for v in vectors]
    assert np.allclose(exp_map(vectors), expected, atol=1e-14)


def test_logarithm_inverts_exponential_down_to_zero():
    directions = RNG.normal(size=(20, 3))
    angles = RNG.uniform(0.0, 3.1, (20, 1))  # beyond pi the shortest vector is another one
    vectors = angles * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    vectors = np.vstack([vectors, np.zeros(3), [1e-12, 0, 0]])
    assert np.allclose(log_map(exp_map(vectors)), vectors, atol=1e-13)


@pytest.mark.parametrize("count", [1, 5, 300])
@pytest.mark.parametrize("length", [0.0, 1e-160, 1e-9, 1e-3, 1.0, np.pi - 1e-6])
def test_few_and_many_rotations_are_those_of_scipy(count, length):
    vectors = RNG.normal(size=(count, 3))
    vectors *= length / np.linalg.norm(vectors, axis=1, keepdims=True)
    expected = Rotation.from_rotvec(vectors).as_matrix()
    assert np.abs(exp_map(vectors) - expected).max() <= 1e-15
    back = Rotation.from_matrix(expected).as_rotvec()
    assert np.abs(log_map(expected) - back).max() <= 1e-15 * max(length, 1e-160)


@pytest.mark.parametrize("count", [1, 100])
def test_half_a_turn_about_each_axis_and_a_step_that_is_not_finite(count):
    halves = np.tile(
        np.array([np.diag([1.0, -1, -1]), np.diag([-1.0, 1, -1]), np.diag([-1.0, -1, 1])]), (count, 1, 1)
    )
    assert np.array_equal(log_map(halves), np.tile(np.pi * np.eye(3), (count, 1)))
    for bad in (np.inf, np.nan):
        assert np.isnan(exp_map(np.full((count, 3), bad))).all()
        assert np.isnan(log_map(np.full((count, 3, 3), np.nan))).all()


def test_skew_matrix_times_vector_is_the_cross_product():
    v, w = RNG.normal(size=(2, 5, 3))
    assert np.allclose((skew(v) @ w[:, :, None])[:, :, 0], np.cross(v, w))


def test_nearest_rotation_undoes_scale_and_noise_and_is_never_a_reflection():
    rotations = exp_map(RNG.normal(size=(50, 3)))
    assert np.allclose(nearest_rotation(3.0 * rotations), rotations)
    wild = nearest_rotation(RNG.normal(size=(50, 3, 3)))
    assert np.allclose(wild @ wild.transpose(0, 2, 1), np.eye(3))
    assert np.allclose(np.linalg.det(wild), 1.0)


def test_pan_turns_about_y_first_and_roll_about_z_last():
    axis = euler_zxy(90.0, 0.0, 0.0) @ [0.0, 0.0, 1.0]
    assert np.allclose(axis, [1.0, 0.0, 0.0])
    assert np.allclose(euler_zxy(10.0, 20.0, 30.0), euler_zxy(0, 0, 30) @ euler_zxy(0, 20) @ euler_zxy(10, 0))


def test_a_gimbal_s_rotation_is_that_of_scipy():
    for pan, tilt, roll in RNG.uniform(-180.0, 180.0, (200, 3)):
        expected = Rotation.from_euler("ZXY", [roll, tilt, pan], degrees=True).as_matrix()
        assert np.abs(euler_zxy(pan, tilt, roll) - expected).max() <= 1e-15
