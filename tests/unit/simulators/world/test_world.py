"""The simulated world and its temperature."""

import math
import struct
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st
from waiting import wait_until

from simulators.bench import Pulse
from simulators.world.drift import temperature_c
from simulators.world.truth import REFERENCE_C, ThermalTruth, Truth
from simulators.world.world import AxisMotion, LightState, World


def test_the_past_stays_as_it_was():
    world = World(clock=lambda: 10.0)
    world.set_axis("pan", AxisMotion.resting(1.0, 6400), since_s=0.0)
    world.set_axis("pan", AxisMotion(lambda t: t, 7.0, 44800), since_s=5.0)
    world.set_light(LightState(output=True), since_s=6.0)
    assert world.angles_deg(4.9)["pan"] == 1.0
    assert world.angles_deg(6.5) == {"pan": 6.5, "tilt": 0.0, "roll": 0.0}
    assert [world.is_settled(t) for t in (4.0, 6.0, 7.0)] == [True, False, True]
    assert dict(world.resting_microsteps(4.0)) == {"pan": 6400}
    assert [world.light(t).output for t in (5.9, 6.1)] == [False, True]


def test_light_is_dark_without_output():
    light = LightState(low_v=1.0, high_v=5.0)
    assert (light.low, light.high) == (0.0, 0.0)
    on = LightState(low_v=1.0, high_v=5.0, output=True)
    assert (on.low, on.high) == (0.2, 1.0)


@given(st.floats(-50, 50), st.floats(0.1, 1000), st.floats(-50, 50))
def test_phase_counts_periods_from_the_origin(t_s, frequency_hz, origin_s):
    light = LightState(frequency_hz=frequency_hz, origin_s=origin_s)
    phase = light.phase_at(t_s)
    assert 0.0 <= phase < 1.0
    periods = (t_s - origin_s) * frequency_hz - phase
    assert math.isclose(periods, round(periods), abs_tol=1e-6)


# ---------------------------------------------------------------- temperature

WARMING = ThermalTruth(
    room_c=21.0, room_c_per_h=0.5, self_heating_c=20.0, warm_up_min=12.0, focal_ppm_per_c=18.0
)


@given(on_s=st.floats(0.0, 20_000.0))
def test_the_camera_warms_to_its_own_heat_on_top_of_the_room(on_s):
    expected = 21.0 + 0.5 * on_s / 3600.0 + 20.0 * (1.0 - math.exp(-on_s / 720.0))
    assert temperature_c(WARMING, on_s) == pytest.approx(expected, abs=0.0051)


def test_the_focal_length_follows_the_temperature_of_the_moment():
    world = World(Truth(thermal=WARMING), clock=lambda: 1000.0)
    camera = world.truth.camera
    for on_s in (0.0, 300.0, 7200.0):
        warmth = world.temperature_c(1000.0 + on_s) - REFERENCE_C
        there = world.truth_at(1000.0 + on_s)
        assert there.camera.fx == pytest.approx(camera.fx * (1.0 + 18e-6 * warmth), rel=1e-12)
        assert there.camera.fy / there.camera.fx == pytest.approx(camera.fy / camera.fx, rel=1e-12)
        assert there.camera.cx == camera.cx
    assert world.truth_at(1000.0).camera.fx < world.truth_at(8200.0).camera.fx


# ---------------------------------------------------------------- pulses


def test_the_pulse_runs_and_never_faster_than_the_clock(tmp_path):
    path = tmp_path / "pulse"
    began_s = time.monotonic()
    pulse = Pulse(path)
    wait_until(lambda: struct.unpack("<d", path.read_bytes())[0] >= 0.05, 10.0)
    lived_s = struct.unpack("<d", path.read_bytes())[0]
    assert lived_s <= time.monotonic() - began_s
    pulse.close()
