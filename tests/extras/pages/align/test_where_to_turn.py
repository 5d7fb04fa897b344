"""Where to turn: the simulated bench is turned by the advice, and the tag must then be in the middle."""

import numpy as np
import pytest

from bench.extras.pages.align.where_to_turn import turn_to_centre
from simulators.optics.picture import TARGET, project, true_rotation
from tests.support.live_slices import bench

SIZE = (1280, 720)
MIDDLE = np.array([639.5, 359.5])


def tag_px(truth, angles_deg):
    """Where the tag's centre is in the image."""
    return project(np.array([TARGET.tag_centre_mm]), true_rotation(angles_deg, truth), truth)[0]


@pytest.mark.parametrize(
    "reading", [{"pan": 0.0}, {"pan": 7.0, "tilt": -5.0}, {"pan": -9.0, "tilt": 6.0, "roll": 20.0}]
)
def test_the_turn_brings_the_tag_to_the_middle(reading):
    truth = bench()
    pan, tilt = turn_to_centre(tuple(tag_px(truth, reading)), SIZE, truth.camera.fx, reading)
    there = {**reading, "pan": reading["pan"] + pan, "tilt": reading.get("tilt", 0.0) + tilt}
    assert np.abs(tag_px(truth, there) - MIDDLE).max() < 8.0  # principal point and distortion are left out
    wrong = {**there, "pan": reading["pan"] - pan}
    assert abs(pan) < 0.1 or np.abs(tag_px(truth, wrong) - MIDDLE).max() > 8.0
