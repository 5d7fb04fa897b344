"""Stars in the rendered picture itself, without events: they are where the ray model puts them, at any roll."""

import numpy as np
import pytest

from calib import CalibrationOptions, calibrate, detect_view
from simulators.optics.picture import TARGET, pose_rotation, project, render, star_centres
from simulators.world.truth import CameraTruth, OpticsTruth, Truth
from simulators.world.truth_config import truth_from_config

LEVEL = OpticsTruth(mounting_deg=(0.0, 0.0, 0.0))


@pytest.mark.parametrize("roll", [0.0, 7.0, 22.5, 45.0])
def test_the_picture_shows_stars_in_their_true_places_at_any_roll(roll):
    truth = Truth(camera=CameraTruth(cx=322.0, cy=183.0, width=640, height=360), optics=LEVEL)
    rotation = pose_rotation({"pan": 1.3, "tilt": -0.7, "roll": roll}, truth.optics)
    view = detect_view(render(truth, rotation), TARGET)
    inside, _ = star_centres(truth, rotation, clearance=2.0, border_px=32.0)
    kept = np.isin(view.ids, inside)
    error = view.points_px[kept] - project(np.asarray(TARGET.positions_mm(view.ids[kept])), rotation, truth)
    assert kept.sum() > 30
    # A few stars next to the tag are wrong by up to 0.01 px, because their white surroundings are not symmetric.
    assert np.median(np.abs(error)) < 0.0005
    assert np.sqrt((error**2).mean()) < 0.006


@pytest.mark.slow
def test_a_fisheye_is_calibrated_from_its_pictures():
    truth = truth_from_config(
        {
            "camera": {"projection": "fisheye", "k1": -0.05, "k2": 0.02, "k3": 0.0},
            "optics": {"mounting_deg": [0, 0, 5]},
        }
    )
    views = []
    for pan, tilt, roll in ((0, 0, 7), (9, 4, 7), (-9, -4, 97), (7, -5, 7)):
        rotation = pose_rotation({"pan": pan, "tilt": tilt, "roll": roll}, truth.optics)
        views.append(detect_view(render(truth, rotation), TARGET, name=f"{pan} {tilt} {roll}"))
    calibration = calibrate(views, CalibrationOptions(model="spherical", distortion=("kb1", "kb2")))
    assert calibration.rms_px < 0.02
    true_values = truth.to_dict()["camera"]
    for name, bound in (("fx", 0.2), ("fy", 0.2), ("cx", 0.1), ("cy", 0.1), ("kb1", 0.001), ("kb2", 0.01)):
        value = calibration.values[name]
        assert abs(value - true_values[name]) < bound, name
