"""Checks of a camera by a few views, one view, and halves."""

import numpy as np
import pytest
from made_views import shifted
from slow_cases import slow

from calib import CalibrationOptions, CameraModel, View
from calib.errors import DegenerateViews, InputMismatch
from calib.model.rotation import exp_map
from calib.studies.camera_check import check_camera, check_one_view, split_half

SIZE = (1280, 720)

LENS = {"k1": 0.06, "k2": -0.9, "p1": 3e-4, "p2": -2e-4}

CAMERA = CameraModel(3345.0, 3345.5, 643.2, 364.8, SIZE, LENS)

SIGMA = np.array([1.0, 1.0, 1.2, 1.4, 6e-3, 0.15, 2e-4, 2e-4])


def drawn_covariance(rng):
    """Sigmas as those of a run, with drawn correlations."""
    factor = rng.normal(size=(8, 12))
    shape = factor @ factor.T
    scale = SIGMA / np.sqrt(np.diag(shape))
    return shape * np.outer(scale, scale)


def with_values(values):
    return CameraModel(*values[:4], SIZE, dict(zip(LENS, values[4:].tolist(), strict=True)))


def share_not_right(change, n):
    """Share of checks that find the camera not right, where its focal length changed by ``change`` times U."""
    wrong = 0
    for seed in range(n):
        rng = np.random.default_rng([7, seed])
        covariance = drawn_covariance(rng)
        moved = 2.0 * change * np.sqrt(2.0) * SIGMA * np.array([1, 1, 0, 0, 0, 0, 0, 0])
        old, new = (rng.multivariate_normal(np.zeros(8), covariance) for _ in range(2))
        stated, now = with_values(CAMERA.values + old), with_values(CAMERA.values + moved + new)
        wrong += not check_camera(stated, covariance, now, covariance, rng).right
    return wrong / n


@pytest.mark.slow
def test_a_camera_that_did_not_change_is_called_wrong_in_about_one_case_of_twenty():
    assert 0.01 <= share_not_right(0.0, 150) <= 0.10


@pytest.mark.slow
def test_the_larger_the_change_the_more_often_it_is_found():
    half, single, three = (share_not_right(change, 50) for change in (0.5, 1.0, 3.0))
    assert half <= single <= three
    assert half < 0.35
    assert three > 0.9


@pytest.mark.parametrize(
    ("change", "cause"),
    [({"fx": 12, "fy": 12}, "scale"), ({"cx": 60, "cy": -40}, "principal point"), ({"k1": 0.05}, "lens")],
)
def test_one_kind_of_change_is_named(change, cause):
    values = dict(zip(CAMERA.parameter_names, CAMERA.values, strict=True))
    moved = with_values(np.array([values[name] + change.get(name, 0.0) for name in values]))
    checked = check_camera(CAMERA, None, moved, np.diag((SIGMA / 20.0) ** 2), np.random.default_rng(1))
    assert not checked.right
    assert checked.cause == cause


def test_a_change_of_scale_is_largest_in_a_corner():
    longer = with_values(CAMERA.values + np.array([9.0, 9.0, 0, 0, 0, 0, 0, 0]))
    checked = check_camera(CAMERA, None, longer, np.diag(SIGMA**2), np.random.default_rng(1))
    offsets = {region.name: region.offset_px for region in checked.regions}
    assert len(offsets) == 9
    corners = [offsets[f"{row} {column}"] for row in ("top", "bottom") for column in ("left", "right")]
    assert min(corners) > 1.5 * offsets["middle centre"]
    # By the definition of the focal length: a point moves by its distance from the centre, times the change.
    assert checked.rms_px == pytest.approx(9.0 / 3345.0 * np.sqrt((1280**2 + 720**2) / 12.0), rel=0.1)


def test_a_fisheye_and_another_lens_are_compared_by_what_they_project():
    fisheye = CameraModel(400.0, 400.0, 640.0, 360.0, SIZE, {"kb1": 0.0, "kb2": 0.0, "kb3": 0.0, "kb4": 0.0})
    pinhole = CameraModel(400.0, 400.0, 640.0, 360.0, SIZE, {})
    checked = check_camera(fisheye, None, pinhole, np.diag([0.1] * 4), np.random.default_rng(1))
    assert not checked.right
    assert checked.worst.offset_px > 50.0


def test_a_camera_of_another_size_is_refused():
    other = CameraModel(3345.0, 3345.5, 320.0, 240.0, (640, 480), {})
    with pytest.raises(InputMismatch, match=r"640 x 480 px, .* 1280 x 720"):
        check_camera(other, None, CAMERA, np.diag(SIGMA**2), np.random.default_rng(1))


# ---------------------------------------------------------------- one view

TRUE = CameraModel(1600.0, 1602.0, 642.0, 363.0, SIZE, {"k1": -0.1, "k2": 0.05})

FRONTAL, TILTED = (2.0, -3.0, 5.0), (25.0, -20.0, 5.0)


def view(camera, turn_deg, seed, sigma=0.05, stated=True):
    grid = np.stack(np.meshgrid(np.arange(11) * 20.0, np.arange(7) * 20.0), -1).reshape(-1, 2)
    rotation = exp_map(np.radians(turn_deg))
    centre = np.array([100.0, 60.0, 0.0]) - rotation.T @ np.array([0.0, 0.0, 300.0])
    points = camera.project((np.column_stack([grid, np.zeros(len(grid))]) - centre) @ rotation.T)
    points = points + np.random.default_rng(seed).normal(0.0, sigma, points.shape)
    covariances = np.tile(np.eye(2) * (sigma**2 if stated else 1.0), (len(grid), 1, 1))
    return View("one", SIZE, np.arange(len(grid)), points, grid, covariances)


def changed(**by):
    values = dict(zip(TRUE.parameter_names, TRUE.values.tolist(), strict=True))
    return TRUE.with_values(np.array([value + by.get(name, 0.0) for name, value in values.items()]))


@pytest.mark.parametrize("turn", [TILTED, slow(FRONTAL)])
def test_false_alarms_are_one_in_twenty(turn):
    found = [check_one_view(TRUE, None, view(TRUE, turn, seed, stated=False)) for seed in range(200)]
    wrong = [not check.right for check in found]
    assert 0.01 <= np.mean(wrong) <= 0.09


@pytest.mark.parametrize(
    ("turn", "name"), [(FRONTAL, "k1"), (TILTED, "k1"), (TILTED, "cx"), (TILTED, "scale")]
)
def test_a_change_of_twice_the_stated_size_is_seen_and_of_a_tenth_is_not(turn, name):
    least = check_one_view(TRUE, None, view(TRUE, turn, 0)).seen_from[name]

    def share_seen(times):
        size = times * least
        by = {"fx": size * TRUE.fx, "fy": size * TRUE.fy} if name == "scale" else {name: size}
        found = [check_one_view(TRUE, None, view(changed(**by), turn, seed)) for seed in range(30)]
        return np.mean([not check.right for check in found])

    assert share_seen(2.0) > 0.9
    assert share_seen(0.1) < 0.2


def test_a_frontal_view_sees_a_change_of_scale_far_worse_than_a_tilted_one():
    checks = (check_one_view(TRUE, None, view(TRUE, turn, 0)) for turn in (FRONTAL, TILTED))
    frontal, tilted = (check.seen_from for check in checks)
    assert frontal["scale"] > 5 * tilted["scale"]
    assert frontal["cx"] > 3 * tilted["cx"]


def test_the_stated_uncertainty_counts_and_gross_errors_do_not():
    moved = view(changed(k1=0.01), TILTED, 3)
    assert not check_one_view(TRUE, None, moved).right
    covariance = np.diag([1.0, 1.0, 1.0, 1.0, 0.02, 0.1]) ** 2
    assert check_one_view(TRUE, covariance, moved).right
    points = shifted(view(TRUE, TILTED, 4), 7, 9.0)
    assert check_one_view(TRUE, None, points).right
    assert 70 <= check_one_view(TRUE, None, points).points <= 76


def test_another_size_and_too_few_points_are_refused():
    other = CameraModel(1600.0, 1602.0, 320.0, 240.0, (640, 480), {})
    with pytest.raises(InputMismatch, match=r"640 x 480 px, .* 1280 x 720"):
        check_one_view(other, None, view(TRUE, FRONTAL, 0))
    with pytest.raises(DegenerateViews, match="9 usable points; at least 20"):
        check_one_view(TRUE, None, view(TRUE, FRONTAL, 0).part(np.arange(77) < 9))


# ---------------------------------------------------------------- halves

POSES = ((-5, 2), (0.5, -2.5, 10), (5, 2.5, -20), (-3, -2, 60), (3, 0, 130), (-1, 1, 200))


def test_a_moving_centre_makes_the_halves_differ_more_than_noise_would(bench):
    rng = np.random.default_rng(3)
    centres = np.array(bench.centre) + rng.normal(scale=0.5, size=(6, 3))
    halves = split_half(bench.views(rng, 0.05, poses=POSES, centres=centres), CalibrationOptions("spherical"))
    steady_views = bench.views(np.random.default_rng(3), 0.05, poses=POSES)
    steady = split_half(steady_views, CalibrationOptions("spherical"))
    assert halves.difference.rms_px > 3 * steady.difference.rms_px
    assert halves.expected_px > 3 * steady.expected_px


def test_three_views_make_no_halves(bench):
    with pytest.raises(DegenerateViews, match="at least 4"):
        split_half(bench.views())
