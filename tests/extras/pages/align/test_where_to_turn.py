"""Where to turn: the simulated bench is turned by the advice, and the tag must then be in the middle."""

import numpy as np
import pytest

from bench.extras.pages.align.live_image import LiveSetting
from bench.extras.pages.align.where_to_turn import (
    turn_to_centre,
    where_to_turn,
)
from calib.stars.beam import Beam, find_beam
from calib.stars.quick import find_stars_quickly
from simulators.optics.picture import TARGET, project, true_rotation
from tests.support.live_slices import bench, fired, seen

SIZE = (1280, 720)
ZERO = {"pan": 0.0, "tilt": 0.0}
MIDDLE = np.array([639.5, 359.5])
FULL = Beam(
    1.0, rim_in_view=False, centre_px=None, radius_px=None, lit=np.ones((9, 16), np.uint8), scale=80.0
)


def known_bench(reading_deg=None, **known):
    """What the bench knows for a turn, and the angles of its stage."""
    return LiveSetting(TARGET, **known), reading_deg or {}


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


def test_figures_of_a_picture_off_centre():
    truth = bench(roll_deg=3.0)
    reading = {"pan": 5.0, "tilt": -1.5}
    image = fired(seen(truth, **reading))
    known = known_bench(r_mm=255.0, half_angle_deg=12.0, reading_deg=reading)
    turn = where_to_turn(SIZE, find_beam(image), find_stars_quickly(image, TARGET), *known)
    assert (turn.of, turn.unit) == ("tag", "°")
    assert not turn.centred
    there = {"pan": 5.0 + turn.pan, "tilt": -1.5 + turn.tilt}
    assert np.abs(tag_px(truth, there) - MIDDLE).max() < 10.0
    assert turn.roll_deg == pytest.approx(3.0, abs=0.3)


def test_the_beam_alone_shows_where_to_turn():
    truth = bench(circle_px=26.0)
    reading = {"pan": 9.0}
    image = fired(seen(truth, **reading))
    turn = where_to_turn(SIZE, find_beam(image), None, *known_bench(focal_px=3300.0, reading_deg=reading))
    assert turn.of == "beam"
    assert turn.pan == pytest.approx(-9.0, abs=1.0)
    assert turn.pan == round(turn.pan)
    assert turn.roll_deg is None
