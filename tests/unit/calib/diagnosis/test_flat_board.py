"""A flat board given to the model of a collimator is told at once; no bench with a collimator is taken for one."""

import numpy as np
import pytest
from drawn_benches import POSES, draw_bench

from calib import CalibrationOptions, View, calibrate
from calib.diagnosis import flat_board
from calib.diagnosis.flat_board import require_turns
from calib.errors import DegenerateViews
from calib.model.camera import CameraModel
from calib.model.rotation import exp_map
from simulators.world.truth import COLLIMATORS
from tests.unit.calib.conftest import Bench

SIZE = (1280, 720)
CAMERA = CameraModel(905.0, 903.0, 633.0, 355.0, SIZE, {"k1": -0.1, "k2": 0.02})
BOARD_MM = np.stack(np.meshgrid(30.0 * np.arange(8), 30.0 * np.arange(6)), axis=-1).reshape(-1, 2)
TURNS = [(0, 0, 4), (25, 4, 0), (-22, 8, 12), (5, 26, 30), (8, -24, 60), (18, 18, 0)]


def board_views(turns, noise_px=0.1):
    """Views of a board from some 450 mm, at which the camera looks wherever it is."""
    chance = np.random.default_rng(2)
    views = []
    for number, turn in enumerate(turns):
        rotation = exp_map(np.radians(np.array([turn], float)))[0]
        flat = np.column_stack([BOARD_MM - BOARD_MM.mean(axis=0), np.zeros(len(BOARD_MM))])
        points = CAMERA.project(flat @ rotation.T + [0.0, 0.0, 450.0 + 20.0 * number])
        points += noise_px * chance.normal(size=points.shape)
        views.append(View(f"v{number}", SIZE, np.arange(len(points)), points, BOARD_MM, noise_px))
    return views


@pytest.mark.parametrize(("n", "noise_px"), [(3, 0.02), (4, 0.5), (6, 0.1)])
def test_views_of_a_flat_board_are_told_with_the_model_that_is_right(n, noise_px):
    with pytest.raises(DegenerateViews, match="flat board") as caught:
        calibrate(board_views(TURNS[:n], noise_px))
    assert "planar" in caught.value.remedy
    planar = calibrate(board_views(TURNS, noise_px), CalibrationOptions(model="planar"))
    assert planar.camera.fx == pytest.approx(CAMERA.fx, abs=3 * planar.U["fx"])


def test_of_points_without_errors_rounding_tells_no_flat_board(monkeypatch):
    # Turns leave seven times the residuals of places, both far below a thousandth of a star's sigma.
    monkeypatch.setattr(flat_board, "orbits", lambda _: True)
    poses = (-5, 2), (0.5, -2.5, 10), (5, 2.5, -20), (3, -4, 60), (-2, 4, 130), (4, 4, 45)
    require_turns(Bench(k=(0.06, -0.9, 1e-3, 5e-4)).views(poses=poses))


@pytest.mark.parametrize("profile", COLLIMATORS)
@pytest.mark.parametrize(
    ("n", "other", "passing"), [(9, "orbits", lambda _: True), (3, "_LEVEL", 2.0)], ids=["F-test", "ways"]
)
def test_views_through_a_collimator_are_none_of_a_flat_board_by_either_sign(
    profile, n, other, passing, monkeypatch
):
    monkeypatch.setattr(flat_board, other, passing)
    require_turns(draw_bench(profile, POSES[n], seed=5).views)
