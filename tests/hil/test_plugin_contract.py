"""The contract suite for plug-ins, on two of our own devices: it passes, and fails for a driver that does wrong."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, ClassVar

import pytest

from bench.plugin_tests import CameraContract, FrameCameraContract, LightContract, StageContract
from simulators.cameras.evk4 import SimulatedEvk4
from simulators.cameras.frame_camera import SimulatedFrameCamera
from simulators.lights.microcontroller import MicrocontrollerLight
from simulators.stages.axis_motion import Mechanics
from simulators.stages.dynamixel import DynamixelBus, ServoModel
from simulators.stages.flir_ptu import PtuAxisModel, PtuController
from simulators.stages.thorlabs_apt import AptController, AptModel
from simulators.world.world import LightState, World
from tests.hil.direct_stages import K10CR1_COUNTS_PER_DEG
from tests.hil.evk4_host import FLICKER, SMALL

STEADY = LightState(low_v=5.0, high_v=5.0, output=True)
AXIS = {"counts_per_deg": 800, "limits_deg": [-15, 15], "speed_deg_s": 40, "acceleration_deg_s2": 200}


class Unit(PtuController):
    def angles_deg(self) -> Mapping[str, float]:
        names = {"P": "pan", "T": "tilt"}
        return {
            names[letter]: one.axis.pointing.angle_deg(time.monotonic()) for letter, one in self.axes.items()
        }


class Rotator(AptController):
    def angles_deg(self) -> Mapping[str, float]:
        return {"pan": self.axis.pointing.angle_deg(time.monotonic())}


class Servos(DynamixelBus):
    def angles_deg(self) -> Mapping[str, float]:
        names = {1: "pan", 2: "tilt"}
        return {
            names[number]: one.axis.pointing.angle_deg(time.monotonic())
            for number, one in self.servos.items()
        }


class Lamp(MicrocontrollerLight):
    def is_lit(self) -> bool:
        return self._light.output and self._light.high > 0


class FrameCamera(SimulatedFrameCamera):
    def unplug(self) -> None:
        self.inject_fault("unplug")


@pytest.mark.slow
class TestFlirPtu(StageContract):
    section: ClassVar[Mapping[str, Any]] = {
        "driver": "text",
        "protocol": "flir_ptu",
        "port": "PORT",
        "serial": "E1042",
        "baudrate": 57600,
        "axes": {"pan": {"address": "P", **AXIS}, "tilt": {"address": "T", **AXIS}},
    }
    other_serial = "E9"

    def device(self, clock: Callable[[], float]) -> Unit:
        model = PtuAxisModel(Mechanics(800.0, -17.0, 17.0, start_deg=2.4, stall_detection=False), 15.0)
        return Unit({"P": model, "T": model}, "E1042", clock, baud=57_600)


@pytest.mark.slow
class TestThorlabs(StageContract):
    """One axis: the suite has one port."""

    section: ClassVar[Mapping[str, Any]] = {
        "driver": "thorlabs_apt",
        "axes": {
            "pan": {
                "port": "PORT",
                "serial": "55000123",
                "counts_per_deg": K10CR1_COUNTS_PER_DEG,
                "limits_deg": [-15, 15],
                "speed_deg_s": 40,
                "acceleration_deg_s2": 200,
            }
        },
    }

    def device(self, clock: Callable[[], float]) -> Rotator:
        mechanics = Mechanics(
            K10CR1_COUNTS_PER_DEG, -17.0, 17.0, start_deg=2.4, settle_s=0.001, stall_detection=False
        )
        return Rotator(AptModel(mechanics, 55000123), clock)


@pytest.mark.slow
class TestDynamixel(StageContract):
    section: ClassVar[Mapping[str, Any]] = {
        "driver": "dynamixel",
        "port": "PORT",
        "axes": {
            name: {
                "id": number,
                "model": "XL430-W250",
                "counts_per_deg": 4096 / 360,
                "limits_deg": [-15, 15],
                "speed_deg_s": 40,
                "acceleration_deg_s2": 200,
            }
            for name, number in (("pan", 1), ("tilt", 2))
        },
    }
    tolerance_deg = 0.05

    def device(self, clock: Callable[[], float]) -> Servos:
        model = ServoModel(Mechanics(4096 / 360, -17.0, 17.0, start_deg=2.4))
        return Servos({1: model, 2: model}, clock)


@pytest.mark.slow
class TestMicrocontrollerLight(LightContract):
    section: ClassVar[Mapping[str, Any]] = {
        "driver": "text",
        "protocol": "microcontroller_light",
        "port": "PORT",
        "serial": "SB7",
    }
    other_serial = "SB8"

    def device(self, clock: Callable[[], float]) -> Lamp:
        return Lamp("SB7", clock)


@pytest.mark.slow
class TestSimulatedEvk4(CameraContract):
    section: ClassVar[Mapping[str, Any]] = {
        "driver": "simulated_evk4",
        "address": "PORT",
        "serial": "00050423",
    }
    other_serial = "00050424"
    biases: ClassVar[Mapping[str, int]] = {"bias_diff_on": 5, "bias_fo": -3}
    impossible_biases: ClassVar[Mapping[str, int]] = {"bias_diff_on": 5000}

    @contextmanager
    def connected(self) -> Iterator[SimulatedEvk4]:
        world = World(SMALL, seed=1)
        world.set_light(FLICKER)
        camera = SimulatedEvk4(world, paced=True)
        camera.start()
        try:
            yield camera
        finally:
            camera.close()


@pytest.mark.slow
class TestSimulatedFrameCamera(FrameCameraContract):
    """A network camera: it has no serial number, and sets neither exposure nor gain."""

    section: ClassVar[Mapping[str, Any]] = {"driver": "opencv", "source": "PORT"}
    other_serial = "8"
    impossible_settings: ClassVar[Mapping[str, float]] = {"exposure": 0.01}

    @contextmanager
    def connected(self) -> Iterator[FrameCamera]:
        world = World(SMALL, seed=1)
        world.set_light(STEADY)
        camera = FrameCamera(world)
        camera.start()
        try:
            yield camera
        finally:
            camera.close()
