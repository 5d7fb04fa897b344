"""Temperature: the camera warms up once; focal length and light follow it by the law of the truth."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulators.config import bench_config
from simulators.world.drift import lamp_brightness, temperature_c, truth_at_temperature
from simulators.world.truth import REFERENCE_C, ThermalTruth, Truth
from simulators.world.world import LightState, World

WARMING = ThermalTruth(
    room_c=21.0,
    room_c_per_h=0.5,
    self_heating_c=20.0,
    warm_up_min=12.0,
    focal_ppm_per_c=18.0,
    lamp_percent_per_c=-0.4,
)


class Clock:
    now_s = 1000.0

    def __call__(self):
        return self.now_s


@given(on_s=st.floats(0.0, 20_000.0))
def test_the_camera_warms_by_the_law_of_the_truth(on_s):
    law = Truth(thermal=WARMING).to_dict()["thermal"]["law"]["temperature_c"]
    assert law == "room_c + room_c_per_h t / 3600 s + self_heating_c (1 - exp(-t / (60 s warm_up_min)))"
    expected = 21.0 + 0.5 * on_s / 3600.0 + 20.0 * (1.0 - math.exp(-on_s / 720.0))
    assert temperature_c(WARMING, on_s) == pytest.approx(expected, abs=0.0051)


def test_by_default_the_camera_is_warm_from_the_start_and_nothing_changes():
    truth = Truth()
    assert temperature_c(truth.thermal, 0.0) == temperature_c(truth.thermal, 1e5) == REFERENCE_C
    assert truth_at_temperature(truth, 12.0) is truth
    assert lamp_brightness(truth.thermal, 12.0) == 1.0


def test_focal_length_and_light_follow_the_temperature_of_the_moment():
    clock = Clock()
    world = World(Truth(thermal=WARMING), clock=clock)
    world.set_light(LightState(output=True, high_v=4.0))
    camera = world.truth.camera
    for on_s in (0.0, 300.0, 7200.0):
        warmth = world.temperature_c(1000.0 + on_s) - REFERENCE_C
        there = world.truth_at(1000.0 + on_s)
        assert there.camera.fx == pytest.approx(camera.fx * (1.0 + 18e-6 * warmth), rel=1e-12)
        assert there.camera.fy / there.camera.fx == pytest.approx(camera.fy / camera.fx, rel=1e-12)
        assert there.camera.cx == camera.cx
        assert world.light(1000.0 + on_s).high == pytest.approx(0.8 * (1.0 - 0.004 * warmth))
    assert world.truth_at(1000.0).camera.fx < world.truth_at(8200.0).camera.fx


def test_the_law_is_set_in_the_simulation_section_of_a_station():
    config = bench_config({"thermal": {"warm_up_min": 8, "focal_ppm_per_c": 12, "room_c": 20}})
    assert config.truth.thermal == ThermalTruth(room_c=20.0, warm_up_min=8.0, focal_ppm_per_c=12.0)
