"""Rotations, homographies, closed forms of the planar and of the spherical model, and medians."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from calib.arrays import median
from calib.errors import DegenerateViews, InputMismatch, TooFewStars
from calib.model.closed_forms import (
    linear_solution,
    poses_from_homographies,
    rotations_from_centre,
    zhang_matrix,
)
from calib.model.homography import apply_homography, view_homography
from calib.model.rotation import euler_zxy, exp_map, log_map, nearest_rotation, skew
from calib.view import View

RNG = np.random.default_rng(3)


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


def test_a_gimbal_s_rotation_is_that_of_scipy():
    for pan, tilt, roll in RNG.uniform(-180.0, 180.0, (200, 3)):
        expected = Rotation.from_euler("ZXY", [roll, tilt, pan], degrees=True).as_matrix()
        assert np.abs(euler_zxy(pan, tilt, roll) - expected).max() <= 1e-15


# ---------------------------------------------------------------- homographies

DRAWS = np.random.default_rng(5)

TRUE = np.array([[12.0, -3.0, 100.0], [2.5, 11.0, 50.0], [1e-3, -2e-3, 1.0]])


def view_of(target, pixels):
    n = len(target)
    return View("one", (1280, 720), np.arange(n), pixels, target, np.tile(np.eye(2), (n, 1, 1)))


@pytest.mark.parametrize("stars", [4, 5, 40])
def test_exact_points_give_the_homography_back_with_determinant_one(stars):
    target = np.random.default_rng(stars).uniform(0, 60, (stars, 2))
    h = view_homography(view_of(target, apply_homography(TRUE, target)))
    assert np.linalg.det(h) == pytest.approx(1.0)
    assert np.allclose(h / h[2, 2], TRUE, rtol=1e-9)


def test_a_mirrored_target_is_refused():
    target = DRAWS.uniform(0, 60, (40, 2))
    with pytest.raises(InputMismatch, match="mirrored"):
        view_homography(view_of(target * [-1, 1], apply_homography(TRUE, target)))


def test_too_few_stars_are_refused():
    target = DRAWS.uniform(0, 60, (3, 2))
    with pytest.raises(TooFewStars, match="view one"):
        view_homography(view_of(target, target))


@pytest.mark.parametrize("which", ["target_mm", "points_px"])
def test_stars_on_a_line_are_refused(which):
    target = DRAWS.uniform(0, 60, (40, 2))
    view = view_of(target, apply_homography(TRUE, target))
    line = DRAWS.uniform(0, 60, (40, 1)) * [1.0, 2.0] + [3.0, 4.0]
    with pytest.raises(DegenerateViews, match="line"):
        view_homography(replace(view, **{which: line}))


# ---------------------------------------------------------------- the planar model

SIZE = (1280, 720)


@pytest.fixture
def ideal(make_bench):
    bench = make_bench(k=(0.0, 0.0), cx=639.5, cy=359.5, poses=((-20, 5), (15, -12), (3, 21, 40)))
    return bench, np.array([view_homography(view) for view in bench.views()])


@pytest.mark.parametrize("free", [True, False])
def test_ideal_views_give_the_exact_camera(ideal, free):
    bench, h = ideal
    matrix = zhang_matrix(h, SIZE, free_principal_point=free)
    assert np.allclose(matrix, [[bench.fx, 0, bench.cx], [0, bench.fy, bench.cy], [0, 0, 1]], rtol=1e-6)


def test_poses_follow_from_the_camera(ideal):
    bench, h = ideal
    matrix = np.array([[bench.fx, 0, bench.cx], [0, bench.fy, bench.cy], [0, 0, 1]])
    turns, centres = poses_from_homographies(h, matrix)
    assert np.allclose(centres, bench.centre, atol=1e-5)
    assert np.allclose(turns @ turns.transpose(0, 2, 1), np.eye(3))


# ---------------------------------------------------------------- the spherical model


def homographies(bench, count):
    return np.array([view_homography(view) for view in bench.views(poses=bench.poses[:count])])


def test_rotations_follow_from_camera_and_centre(make_bench):
    bench = make_bench(k=(0.0, 0.0))
    h = homographies(bench, 3)
    matrix, collimator = linear_solution(h, SIZE, free_principal_point=True)
    turns = rotations_from_centre(h, matrix, collimator.centre)
    assert np.allclose(turns, bench.rotations, atol=1e-5)


# ---------------------------------------------------------------- medians


@given(st.lists(st.floats(-1e6, 1e6) | st.just(math.inf), min_size=1, max_size=30))
def test_it_is_the_median_of_numpy(numbers):
    assert median(np.array(numbers)) == np.median(numbers)


@pytest.mark.parametrize("numbers", [[], [1.0, math.nan, 2.0], [math.nan]])
def test_without_a_middle_it_is_not_a_number(numbers):
    assert math.isnan(median(np.array(numbers)))
