"""Expected grid of a pose."""

import numpy as np
import pytest

from bench.measure.expected_grid import best_angles_deg, grid_from_earlier_poses, grid_from_journal
from bench.record.history import Attempt, History
from calib.errors import DegenerateViews
from calib.model.homography import apply_homography
from calib.model.rotation import euler_zxy
from calib.stars.pointing import grid_homography
from calib.target import StarTarget

TARGET, SIZE = StarTarget(), (1280, 720)

K = np.array([[3345.0, 0, 639.5], [0, 3345.0, 359.5], [0, 0, 1]])


def grid_at(reading):
    return grid_homography(
        K, euler_zxy(reading["pan"], reading["tilt"]), np.array([97.0, 140.0, -255.0]), TARGET.pitch_mm
    )


def attempt(index, reading, *, named_by="tag", accepted=True):
    measured = {"named_by": named_by, "grid": grid_at(reading).tolist()}
    checked = {"accepted": accepted, "measured": measured}
    return Attempt(index, f"pose {index}", 1, {"measured_deg": reading}, checked)


SEEN = [{"pan": -5.0, "tilt": 1.0}, {"pan": 5.0, "tilt": -1.0}, {"pan": 0.0, "tilt": 3.0}]

HERE = {"pan": 11.0, "tilt": 4.0}


def recorded(**changed):
    history = History()
    for index, reading in enumerate(SEEN, 1):
        history.add(attempt(index, reading, **changed))
    return history


def test_poses_labelled_by_the_tag_predict_the_grid_of_the_next():
    grid = grid_from_earlier_poses(recorded(), {"measured_deg": HERE}, TARGET)(SIZE)
    nodes = np.array([[10.0, 30.0], [15.0, 34.0], [12.0, 28.0]])
    assert np.abs(apply_homography(grid, nodes) - apply_homography(grid_at(HERE), nodes)).max() < 0.1


@pytest.mark.parametrize("changed", [{"named_by": "gimbal"}, {"accepted": False}])
def test_poses_labelled_by_the_gimbal_or_rejected_predict_nothing(changed):
    with pytest.raises(DegenerateViews, match="No earlier view"):
        grid_from_earlier_poses(recorded(**changed), {"measured_deg": HERE}, TARGET)(SIZE)


def test_a_journaled_expected_grid_is_used_again():
    named = attempt(4, HERE, named_by="gimbal")
    named.checked["measured"]["expected_grid"] = grid_at(HERE).tolist()
    assert (grid_from_journal(named)(SIZE) == grid_at(HERE)).all()
    assert grid_from_journal(attempt(1, HERE)) is None


def test_encoder_angles_replace_stated_positions():
    assert best_angles_deg({"pan": 1.0, "pan_encoder": 1.002, "tilt": 2.0}) == {"pan": 1.002, "tilt": 2.0}
