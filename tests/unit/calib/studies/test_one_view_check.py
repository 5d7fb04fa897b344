"""One view at an unknown place: false alarms are as rare as stated, and what a pose imitates is not judged."""

import numpy as np
import pytest

from calib.errors import DegenerateViews, InputMismatch
from calib.model.camera import CameraModel
from calib.model.rotation import exp_map
from calib.studies.one_view_check import check_one_view
from calib.view import View

SIZE = (1280, 720)
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


@pytest.mark.parametrize("turn", [FRONTAL, TILTED])
def test_false_alarms_are_one_in_twenty(turn):
    wrong = [
        not check_one_view(TRUE, None, view(TRUE, turn, seed, stated=False)).right for seed in range(200)
    ]
    assert 0.01 <= np.mean(wrong) <= 0.09


@pytest.mark.parametrize(
    ("turn", "name"), [(FRONTAL, "k1"), (TILTED, "k1"), (TILTED, "cx"), (TILTED, "scale")]
)
def test_a_change_of_twice_the_stated_size_is_seen_and_of_a_tenth_is_not(turn, name):
    least = check_one_view(TRUE, None, view(TRUE, turn, 0)).seen_from[name]

    def found(times):
        size = times * least
        by = {"fx": size * TRUE.fx, "fy": size * TRUE.fy} if name == "scale" else {name: size}
        return np.mean(
            [not check_one_view(TRUE, None, view(changed(**by), turn, seed)).right for seed in range(30)]
        )

    assert found(2.0) > 0.9
    assert found(0.1) < 0.2


def test_a_frontal_view_sees_a_change_of_scale_far_worse_than_a_tilted_one():
    frontal, tilted = (
        check_one_view(TRUE, None, view(TRUE, turn, 0)).seen_from for turn in (FRONTAL, TILTED)
    )
    assert frontal["scale"] > 5 * tilted["scale"]
    assert frontal["cx"] > 3 * tilted["cx"]


def test_the_stated_uncertainty_counts_and_gross_errors_do_not():
    moved = view(changed(k1=0.01), TILTED, 3)
    assert not check_one_view(TRUE, None, moved).right
    covariance = np.diag([1.0, 1.0, 1.0, 1.0, 0.02, 0.1]) ** 2
    assert check_one_view(TRUE, covariance, moved).right
    points = view(TRUE, TILTED, 4)
    points.points_px[7] += 9.0
    assert check_one_view(TRUE, None, points).right
    assert 70 <= check_one_view(TRUE, None, points).points <= 76


def test_another_size_and_too_few_points_are_refused():
    other = CameraModel(1600.0, 1602.0, 320.0, 240.0, (640, 480), {})
    with pytest.raises(InputMismatch, match="has 640 x 480 px, this view has 1280 x 720 px"):
        check_one_view(other, None, view(TRUE, FRONTAL, 0))
    one = view(TRUE, FRONTAL, 0)
    few = View("few", SIZE, one.ids[:9], one.points_px[:9], one.target_mm[:9], one.covariances_px2[:9])
    with pytest.raises(DegenerateViews, match="9 usable points; at least 20"):
        check_one_view(TRUE, None, few)
