"""Cameras mounted on their side, and axes of the wrong sign: the motion that was seen leads to the middle."""

import numpy as np
import pytest

from bench.extras.pages.align.where_to_turn import SeenMotion, turn_to_centre
from calib.model.rotation import exp_map
from simulators.optics.picture import TARGET, project, true_rotation
from tests.support.live_slices import bench

SIZE, MIDDLE = (1280, 720), np.array([639.5, 359.5])
TRUTH = bench()
FOCAL = TRUTH.camera.fx


def tag_px(reading, on_head_deg=0.0, signs=(1.0, 1.0)):
    """Where the tag is when the camera is rolled on the gimbal's head, and axes turn against their reading."""
    true = {"pan": signs[0] * reading["pan"], "tilt": signs[1] * reading["tilt"]}
    rotation = exp_map(np.array([0.0, 0.0, np.radians(on_head_deg)])) @ true_rotation(true, TRUTH)
    return tuple(project(np.array([TARGET.tag_centre_mm]), rotation, TRUTH)[0])


@pytest.mark.parametrize(
    ("on_head_deg", "signs"),
    [(90.0, (1, 1)), (180.0, (1, 1)), (-120.0, (1, 1)), (0.0, (-1, 1)), (0.0, (1, -1))],
)
def test_the_motion_seen_leads_to_the_middle(on_head_deg, signs):
    motion, reading = SeenMotion(), {"pan": 4.0, "tilt": -3.0}
    for step in ({"pan": 0.0}, {"pan": 1.0}, {"tilt": 1.0}):
        reading = {axis: angle + step.get(axis, 0.0) for axis, angle in reading.items()}
        motion.add(reading, tag_px(reading, on_head_deg, signs), FOCAL)
    for _ in range(3):
        turn = motion.turn(tag_px(reading, on_head_deg, signs), SIZE, FOCAL)
        assert turn is not None
        reading = {"pan": reading["pan"] + turn[0], "tilt": reading["tilt"] + turn[1]}
    assert np.abs(np.array(tag_px(reading, on_head_deg, signs)) - MIDDLE).max() < 10.0


def test_a_single_jog_is_enough_for_a_camera_on_its_side():
    motion, reading = SeenMotion(), {"pan": 3.0, "tilt": -2.0}
    motion.add(reading, tag_px(reading, 90.0), FOCAL)
    reading = {"pan": 4.0, "tilt": -2.0}
    motion.add(reading, tag_px(reading, 90.0), FOCAL)
    turn = motion.turn(tag_px(reading, 90.0), SIZE, FOCAL)
    there = {"pan": 4.0 + turn[0], "tilt": -2.0 + turn[1]}
    assert np.abs(np.array(tag_px(there, 90.0)) - MIDDLE).max() < 25.0
    by_signs = turn_to_centre(tag_px(reading, 90.0), SIZE, FOCAL, reading)
    wrong = {"pan": 4.0 + by_signs[0], "tilt": -2.0 + by_signs[1]}
    assert np.abs(np.array(tag_px(wrong, 90.0)) - MIDDLE).max() > 100.0


def test_an_upright_camera_keeps_the_signs_of_the_bench():
    motion, reading = SeenMotion(), {"pan": 0.0, "tilt": 0.0}
    for pan, tilt in ((0, 0), (2, 0), (2, 2), (0, 2), (-3, 2)):
        reading = {"pan": float(pan), "tilt": float(tilt)}
        motion.add(reading, tag_px(reading, 10.0), FOCAL)  # rolled by the 10 degrees that the advice asks for
    assert motion.turn(tag_px(reading), SIZE, FOCAL) is None


def test_what_is_no_motion_of_one_axis_teaches_nothing():
    motion = SeenMotion()
    assert motion.turn((0.0, 0.0), SIZE, FOCAL) is None
    motion.add({"pan": 0.0, "tilt": 0.0}, (600.0, 300.0), FOCAL)
    motion.add({"pan": 0.1, "tilt": 0.0}, (500.0, 300.0), FOCAL)  # too short
    motion.add({"pan": 2.1, "tilt": 2.0}, (300.0, 300.0), FOCAL)  # both axes
    motion.add({"pan": 4.1, "tilt": 2.0}, (299.0, 300.0), FOCAL)  # it did not move
    assert motion.turn((0.0, 0.0), SIZE, FOCAL) is None
    motion.add({"pan": 5.1, "tilt": 2.0}, (240.0, 300.0), FOCAL)
    assert motion.turn((0.0, 0.0), SIZE, FOCAL) is not None
    motion.forget()
    assert motion.turn((0.0, 0.0), SIZE, FOCAL) is None
