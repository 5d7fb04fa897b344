"""Focus, aperture and mount of a running simulated bench: hands turn them, and the camera sees it at once."""

import json
import math

import pytest

from bench.base.errors import SimulationError
from bench.simulated import SimulatedBench
from simulators.config import bench_config
from simulators.pixels.biases import FACTORY
from simulators.pixels.sensor_stream import CameraState, SensorStream
from simulators.world.world import LightState, World, setup_of

SMALL = {"fx": 836, "fy": 836, "cx": 160, "cy": 90, "width": 320, "height": 180}


@pytest.fixture(scope="module")
def bench():
    with SimulatedBench({"camera": SMALL, "noise": "clean", "paced": False}, 3) as running:
        yield running


def set_up(bench, device, what, **numbers):
    """Do at once what a person's hands would do; return what can then be read at lens and mount."""
    answer = json.loads(bench.order(json.dumps({"device": device, "fault": what, **numbers})))
    assert answer["ok"], answer
    return answer["now"]


def test_hands_turn_ring_aperture_and_camera_and_read_them_back(bench):
    start = set_up(bench, "lens", "turn", deg=0.0)
    assert (start["focus_distance_m"], start["ring_deg"], start["f_number"]) == ("infinity", 0.0, 2.8)
    near = set_up(bench, "lens", "turn", deg=30.0)
    assert near["ring_deg"] == pytest.approx(30.0)
    assert 0.2 < near["focus_distance_m"] < 3.0
    assert float(set_up(bench, "lens", "turn", deg=-30.0)["focus_distance_m"]) == pytest.approx(math.inf)
    assert set_up(bench, "lens", "focus", distance_m=1.5)["focus_distance_m"] == 1.5
    assert set_up(bench, "lens", "ring", deg=999.0)["ring_deg"] == pytest.approx(180.0)
    assert set_up(bench, "lens", "aperture", f_number=8)["f_number"] == 8.0
    assert set_up(bench, "mount", "turn", roll_deg=4.0)["turn_deg"] == [0.0, 0.0, 4.0]
    assert set_up(bench, "mount", "turn", roll_deg=6.0, pan_deg=-1.0)["turn_deg"] == [-1.0, 0.0, 10.0]
    assert set_up(bench, "mount", "shift", x_mm=1.0, y_mm=-2.0)["shift_mm"] == [1.0, -2.0]
    set_up(bench, "mount", "mend")
    assert set_up(bench, "lens", "mend") == start
    assert bench.truth()["lens"]["focus"] == "on the pattern"  # what does nothing turns nothing


def test_orders_after_the_end_are_refused_with_a_sentence():
    with SimulatedBench({"camera": SMALL}, 3) as ended:
        pass
    with pytest.raises(SimulationError, match="has ended"):
        ended.order("lens turn deg=0")


def words(turn=None, *, seed=3):
    """EVT3 words of 40 ms under a flickering light; ``turn`` changes the setup after 20 ms."""
    truth = bench_config(
        {"camera": {**SMALL, "width": 128, "height": 72, "cx": 64, "cy": 36}, "noise": "none"}
    ).truth
    now = [0.0]
    world = World(truth, seed=seed, clock=lambda: now[0])
    world.set_light(LightState(output=True))
    now[0] = 1.0
    stream = SensorStream(world, CameraState(dict(FACTORY)), {})
    first = [stream.next_frame() for _ in range(10)]
    if turn is not None:
        world.change_setup(turn, since_s=stream.covered_s)
    return first + [stream.next_frame() for _ in range(10)]


def test_a_turn_of_the_ring_is_seen_in_the_middle_of_a_recording():
    still, turned = (
        words(),
        words(lambda _: setup_of(bench_config({"lens": {"focus_distance_m": 0.4}}).truth)),
    )
    assert turned[:10] == still[:10]
    assert turned[10] != still[10]
    assert sum(map(len, turned[10:])) != sum(map(len, still[10:]))
