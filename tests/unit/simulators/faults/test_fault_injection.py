"""An order for a fault reaches the part of the bench that it names, and no other."""

from collections.abc import Callable
from unittest.mock import Mock, call

import numpy as np
import pytest

from simulators.assembly import make_light, make_stage
from simulators.cameras.streaming import StreamFaults
from simulators.config import BenchConfig
from simulators.errors import ConfigError
from simulators.faults.camera_hands import CameraHands
from simulators.faults.catalogue import fault_order_from_text
from simulators.faults.fault_injection import BenchParts, fault_action
from simulators.faults.line_faults import FaultLine
from simulators.lights.lamp import Lamp
from simulators.world.truth import MountTruth, Truth
from simulators.world.world import LightState, World


class Port:
    """A port that executes orders at once and stores whether its cable is plugged in."""

    def __init__(self) -> None:
        self.plugged = True

    def between_exchanges(self, act: Callable[[], None]) -> None:
        act()

    def unplug(self) -> None:
        self.plugged = False

    def replug(self) -> None:
        self.plugged = True


class Bench:
    """The parts of a bench without ports, on a clock that the test advances."""

    def __init__(self) -> None:
        self.now_s = 0.0
        config = BenchConfig()
        self.shown: list[LightState] = []
        lamp = Lamp(self.shown.append)
        light = make_light(config.light, lambda: self.now_s, lamp.drive)
        stage = make_stage("zaber", config.axes, lambda: self.now_s, lambda _name, _pointing: None)
        self.dialects = {**stage.dialects, "light": light}
        self.ports = {name: Port() for name in self.dialects}
        self.camera = Mock(stream_faults=StreamFaults())
        self.world = World(Truth(mount=MountTruth(shift_mm=(0.5, 0.0))), clock=lambda: self.now_s)
        self.changes = 0
        self.hands = CameraHands(self.world, self.count_change)
        lines = {
            name: FaultLine(dialect, lambda: self.now_s, np.random.default_rng(1))
            for name, dialect in self.dialects.items()
        }
        self.parts = BenchParts(
            stage.controllers,
            self.ports,
            lines,
            stage.ports,
            light,
            lamp,
            self.camera,
            lambda: self.now_s,
            hands=self.hands,
        )

    def count_change(self) -> None:
        self.changes += 1

    def order(self, text: str) -> None:
        fault_action(fault_order_from_text(text), self.parts)()

    def say(self, request: str) -> str:
        self.now_s += 10.0
        return self.parts.lines["gimbal"].receive(f"{request}\n".encode()).decode()


@pytest.fixture
def bench() -> Bench:
    homed = Bench()
    homed.say("/0 0 home")
    assert homed.say("/1 0").startswith("@01 0 OK IDLE --")
    return homed


@pytest.mark.parametrize(
    ("fault", "after_a_move", "after_mending"),
    [
        ("stuck_busy", "OK BUSY --", "OK IDLE --"),
        ("stall", "OK IDLE FS", "OK IDLE FS"),
        ("limit", "OK IDLE FE", "OK IDLE FE"),
        ("restart", "OK IDLE WR", "OK IDLE WR"),
        ("reboot", "OK IDLE WR", "OK IDLE WR"),
        ("emergency_stop", "OK IDLE FH", "OK IDLE FH"),
        ("exchange serial=5", "OK IDLE WR", "OK IDLE WR"),
    ],
)
def test_a_fault_of_an_axis_affects_that_axis_alone(bench: Bench, fault, after_a_move, after_mending):
    bench.order(f"pan {fault}")
    bench.say("/0 1 move abs 6400")
    bench.say("/0 1")
    assert after_a_move in bench.say("/1 1")
    assert "OK IDLE --" in bench.say("/2 1")
    bench.order("pan mend")
    assert after_mending in bench.say("/1 1")


def test_faults_of_the_camera_reach_it(bench: Bench):
    bench.order("camera unplug")
    bench.order("camera fault message='too hot'")
    assert bench.camera.method_calls == [call.unplug(), call.report_fault("too hot")]
    bench.order("camera frames_lost skip=1 count=2")
    assert [bench.camera.stream_faults.apply(b"ab") for _ in range(4)] == [b"ab", b"", b"", b"ab"]
    bench.order("camera overflow")
    assert bench.camera.stream_faults.overflows
    bench.order("camera silence")
    assert bench.camera.stream_faults.apply(b"ab") == b""
    bench.order("camera mend")
    assert bench.camera.stream_faults.apply(b"ab") == b"ab"
    assert not bench.camera.stream_faults.overflows


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("roll stall", "device"),
        ("mount shift x_mm=nan", "x_mm"),
        ("mount tilt", "fault"),
        ("gimbal-pan lost", "device"),
        ("light dim factor=0", "factor"),
        ("gimbal replaced pattern=(", "pattern"),
        ("gimbal say text='\\x'", "text"),
        ("gimbal preceded replacement=☃", "replacement"),
        ("lens focus distance_m=0.05", "distance_m"),
        ("lens aperture f_number=0.1", "f_number"),
        ("lens zoom", "fault"),
    ],
)
def test_an_order_that_makes_no_sense_here_names_its_key_and_changes_nothing(bench: Bench, text, where):
    with pytest.raises(ConfigError) as caught:
        bench.order(text)
    assert caught.value.where == where
    assert bench.changes == 0
