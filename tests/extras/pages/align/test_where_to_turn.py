"""Where to turn: the simulated bench is turned by the advice, and the tag must then be in the middle."""

import math

import numpy as np
import pytest

from bench.extras.pages.align.live_image import LiveSetting
from bench.extras.pages.align.where_to_turn import (
    rim_poses,
    roll_by_deg,
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
    known = known_bench(
        r_mm=255.0, half_angle_deg=12.0, reading_deg=reading, limits_deg={"pan": (-15, 15), "tilt": (-10, 10)}
    )
    turn = where_to_turn(SIZE, find_beam(image), find_stars_quickly(image, TARGET), *known)
    assert (turn.of, turn.unit) == ("tag", "°")
    assert turn.focal_px == pytest.approx(truth.camera.fx, rel=0.01)
    assert not turn.centred
    there = {"pan": 5.0 + turn.pan, "tilt": -1.5 + turn.tilt}
    assert np.abs(tag_px(truth, there) - MIDDLE).max() < 10.0
    assert turn.beam_off == pytest.approx(turn.tag_off, abs=0.9)
    assert turn.roll_deg == pytest.approx(3.0, abs=0.3)
    rolled = bench(roll_deg=3.0 + turn.roll_by_deg)
    again = where_to_turn(SIZE, FULL, find_stars_quickly(fired(seen(rolled)), TARGET), *known)
    assert abs(again.roll_deg) == pytest.approx(10.0, abs=0.5)
    assert again.roll_by_deg == 0.0


def test_the_beam_alone_shows_where_to_turn():
    truth = bench(circle_px=26.0)
    reading = {"pan": 9.0}
    image = fired(seen(truth, **reading))
    turn = where_to_turn(SIZE, find_beam(image), None, *known_bench(focal_px=3300.0, reading_deg=reading))
    assert turn.of == "beam"
    assert turn.pan == pytest.approx(-9.0, abs=1.0)
    assert turn.pan == round(turn.pan)
    assert turn.tag_off is None
    assert turn.roll_deg is None


def test_a_turn_beyond_a_limit_is_named():
    known = known_bench(
        focal_px=3300.0, reading_deg={"pan": 14.0}, limits_deg={"pan": (-15.0, 15.0), "tilt": (-10.0, 10.0)}
    )
    beam = FULL._replace(rim_in_view=True, centre_px=(400.0, 359.5), radius_px=700.0)
    turn = where_to_turn(SIZE, beam, None, *known)
    assert turn.pan > 0
    assert turn.beyond == {"pan": pytest.approx(14.0 + turn.pan)}


@pytest.mark.parametrize("roll", np.linspace(-22.4, 22.4, 57))
def test_the_wanted_roll_is_far_from_the_pixels(roll):
    by = roll_by_deg(roll)
    after = (roll + by + 22.5) % 45.0 - 22.5
    assert abs(after) >= 4.9
    assert abs(by) <= 10.0


def test_the_poses_said_show_the_rim():
    truth = bench()
    half_angle = math.degrees(math.atan(718.0 / truth.camera.fx))
    known = known_bench(
        half_angle_deg=half_angle, reading_deg=ZERO, limits_deg={"pan": (-15, 15), "tilt": (-15, 15)}
    )
    text = rim_poses(SIZE, truth.camera.fx, (0.0, 0.0), FULL, *known)
    assert text.startswith("The rim of the beam is in view if pan is below -")
    numbers = [
        float(word.strip("°,"))
        for word in text.split()
        if word.strip("°,").lstrip("-").replace(".", "").isdigit()
    ]
    for axis, angle in zip(("pan", "pan", "tilt", "tilt"), numbers, strict=True):
        assert find_beam(fired(seen(truth, **{axis: angle}))).rim_in_view
    none = known_bench(
        half_angle_deg=half_angle, reading_deg=ZERO, limits_deg={"pan": (-1, 1), "tilt": (-1, 1)}
    )
    assert rim_poses(SIZE, truth.camera.fx, (0.0, 0.0), FULL, *none).startswith("No pose")
    assert rim_poses(SIZE, truth.camera.fx, (0.0, 0.0), FULL, *known_bench(half_angle_deg=half_angle)) == ""
    wide = known_bench(half_angle_deg=5.0, reading_deg=ZERO)
    assert (
        rim_poses(SIZE, truth.camera.fx, (0.0, 0.0), FULL, *wide) == "Every pose shows the rim of the beam."
    )
