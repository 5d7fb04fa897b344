"""The contract suite for plug-ins, on one of our own devices of each kind, on its port.

The families without terminals: test_stage_families.py, test_light_families.py.
"""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, closing, contextmanager
from functools import partial
from typing import Any, ClassVar

import pytest

from bench.extras.plugin_tests import CameraContract, FrameCameraContract, LightContract, StageContract
from bench.extras.plugin_tests.stages import DeviceTime
from simulators.assembly import make_light, make_stage
from simulators.cameras.evk4 import SimulatedEvk4
from simulators.cameras.frame_camera import SimulatedFrameCamera
from simulators.config import AxisConfig, LightConfig
from simulators.world.world import LightState, World
from tests.hil.evk4_host import FLICKER, SMALL

STEADY = LightState(low_v=5.0, high_v=5.0, output=True)


@contextmanager
def in_light(light: LightState, camera_of: Callable[[World], Any]) -> Iterator[Any]:
    """A simulated camera that looks at a light."""
    world = World(SMALL, seed=1)
    world.set_light(light)
    with closing(camera_of(world)) as camera:
        camera.start()
        yield camera


def axis(end_deg: float = 15.0, **more: Any) -> Mapping[str, Any]:
    """An axis of a section."""
    return {"limits_deg": [-end_deg, end_deg], "speed_deg_s": 40, "acceleration_deg_s2": 200, **more}


class OurStage(StageContract):
    """A simulated stage of one port, and the section for its driver."""

    of_bench: ClassVar[str]

    def device(self, clock: Callable[[], float]) -> Any:
        ends = {"pan": (15.0, 2.4), "tilt": (10.0, -1.7)}
        axes = {
            name: AxisConfig(f"10010{number}", *ends[name], 6400, settle_s=0.001)
            for number, name in enumerate(ends, start=1)
        }
        stage = make_stage(self.of_bench, axes, clock, lambda *_: None)
        (device,) = stage.dialects.values()
        device.angles_deg = lambda: {
            name: controller.axis.pointing.angle_deg(clock())
            for name, controller in stage.controllers.items()
        }
        return device


def test_a_device_whose_time_is_held_does_not_move_on_while_the_computer_is_busy() -> None:
    device_time = DeviceTime()
    with device_time.held():
        before_s = device_time()
        time.sleep(0.2)
        assert device_time() == before_s
        device_time.step()
        assert device_time() == pytest.approx(before_s + 0.01)
    assert before_s + 0.01 <= device_time() < before_s + 0.1


class FrameCamera(SimulatedFrameCamera):
    def unplug(self) -> None:
        self.inject_fault("unplug")


class TestZaber(OurStage):
    of_bench = "zaber"
    section: ClassVar[Mapping[str, Any]] = {
        "driver": "zaber_ascii",
        "port": "PORT",
        "axes": {
            "pan": axis(device=1, serial="100101", microsteps_per_deg=6400),
            "tilt": axis(10.0, device=2, serial="100102", microsteps_per_deg=6400),
        },
    }


@pytest.mark.slow
class TestKeysight(LightContract):
    section: ClassVar[Mapping[str, Any]] = {"driver": "scpi", "port": "PORT", "serial": "SB7"}
    other_serial = "SB8"

    def device(self, clock: Callable[[], float]) -> Any:
        states = [LightState()]
        device = make_light(LightConfig("keysight", "SB7"), clock, states.append)
        device.is_lit = lambda: states[-1].output and states[-1].high > 0
        return device


class TestSimulatedEvk4(CameraContract):
    section: ClassVar[Mapping[str, Any]] = {
        "driver": "simulated_evk4",
        "address": "PORT",
        "serial": "00050423",
    }
    other_serial = "00050424"
    biases: ClassVar[Mapping[str, int]] = {"bias_diff_on": 5, "bias_fo": -3}
    impossible_biases: ClassVar[Mapping[str, int]] = {"bias_diff_on": 5000}

    def connected(self) -> AbstractContextManager[Any]:
        return in_light(FLICKER, partial(SimulatedEvk4, paced=True))


@pytest.mark.slow
class TestSimulatedFrameCamera(FrameCameraContract):
    """A network camera: it has no serial number, and sets neither exposure nor gain."""

    section: ClassVar[Mapping[str, Any]] = {"driver": "opencv", "source": "PORT"}
    other_serial = "8"
    impossible_settings: ClassVar[Mapping[str, float]] = {"exposure": 0.01}

    def connected(self) -> AbstractContextManager[Any]:
        return in_light(STEADY, FrameCamera)
