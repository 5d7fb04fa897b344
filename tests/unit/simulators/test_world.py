"""The world: past states of axes and light, and which keys of a configuration set the truth."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulators.errors import ConfigError, SimulationMisuse
from simulators.world.truth import NOISE_LEVELS, Truth
from simulators.world.truth_config import truth_from_config
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


def test_a_state_before_the_last_one_is_refused():
    world = World(clock=lambda: 10.0)
    world.set_light(LightState(), since_s=3.0)
    with pytest.raises(SimulationMisuse):
        world.set_light(LightState(), since_s=2.0)


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


def test_configured_truth_replaces_only_what_is_given():
    truth = truth_from_config({"camera": {"fx": 3000, "width": 640}, "noise": "heavy"})
    assert (truth.camera.fx, truth.camera.width, truth.camera.fy) == (3000.0, 640, Truth().camera.fy)
    assert truth.noise == NOISE_LEVELS["heavy"]


@pytest.mark.parametrize(
    ("config", "key"),
    [
        ({"camera": {"fz": 1}}, "camera.fz"),
        ({"camera": {"fx": 0}}, "camera.fx"),
        ({"camera": {"fx": True}}, "camera.fx"),
        ({"camera": {"width": 12.5}}, "camera.width"),
        ({"camera": 5}, "camera"),
        ({"collimator": {"r": float("nan")}}, "collimator.r"),
        ({"optics": {"mounting_deg": [1, 2]}}, "optics.mounting_deg"),
        ({"optics": {"psf_px": -1}}, "optics.psf_px"),
        ({"noise": "loud"}, "noise"),
        ({"noise": {"hot_hz": "many"}}, "noise.hot_hz"),
    ],
)
def test_a_wrong_configuration_names_its_key(config, key):
    with pytest.raises(ConfigError) as error:
        truth_from_config(config)
    assert error.value.where == key
