"""An order for a fault reaches the part of the bench that it names, and no other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from simulators.assembly import make_light, make_stage
from simulators.cameras.streaming import StreamFaults
from simulators.config import BenchConfig
from simulators.errors import ConfigError
from simulators.faults.camera_hands import CameraHands
from simulators.faults.catalogue import fault_order, fault_order_from_text, faults_of
from simulators.faults.fault_injection import BenchParts, fault_action
from simulators.faults.line_faults import REPLY_FAULTS, REQUEST_FAULTS, FaultLine, LineFault
from simulators.lights.driver import Lamp
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


class Camera:
    def __init__(self) -> None:
        self.calls: list[str] = []
        self.stream_faults = StreamFaults()

    def unplug(self) -> None:
        self.calls.append("unplugged")

    def report_fault(self, message: str) -> None:
        self.calls.append(message)


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
        self.camera = Camera()
        self.world = World(Truth(mount=MountTruth(shift_mm=(0.5, 0.0))), clock=lambda: self.now_s)
        self.changes = 0
        self.hands = CameraHands(self.world, self.count_change)
        lines = {
            name: FaultLine(one, lambda: self.now_s, np.random.default_rng(1))
            for name, one in self.dialects.items()
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
    one = Bench()
    one.say("/0 0 home")
    assert one.say("/1 0").startswith("@01 0 OK IDLE --")
    return one


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


def test_an_emergency_stop_is_released(bench: Bench):
    bench.order("tilt emergency_stop")
    assert "FH" in bench.say("/2 1")
    bench.order("tilt release")
    assert "FH" not in bench.say("/2 1")


@pytest.mark.parametrize(
    ("fault", "counter", "encoder"), [("slip", 6400, 3200), ("push deg=0.5", 6400, 9600)]
)
def test_a_fault_that_the_counter_does_not_see_shows_in_the_encoder(bench: Bench, fault, counter, encoder):
    bench.order(f"pan {fault}")
    bench.say("/1 1 move abs 6400")
    assert f" {counter}:" in bench.say("/1 1 get pos")
    assert f" {encoder}:" in bench.say("/1 1 get encoder.pos")


def test_a_mended_axis_has_no_faults_to_come(bench: Bench):
    for fault in ("stop_short", "idle_flicker times=100"):
        bench.order(f"pan {fault}")
    bench.order("pan mend")
    bench.parts.lines["gimbal"].receive(b"/1 1 move abs 6400\n")
    assert b"BUSY" in bench.parts.lines["gimbal"].receive(b"/1 1\n")
    assert " 6400:" in bench.say("/1 1 get pos")


def test_faults_of_a_line_stay_on_it(bench: Bench):
    bench.order("light lost count=0")
    assert bench.parts.lines["light"].receive(b"*IDN?\n") == b""
    assert bench.say("/1 0") != ""
    bench.order("light mend")
    assert bench.parts.lines["light"].receive(b"*IDN?\n") != b""
    bench.order("gimbal unplug")
    assert (bench.ports["gimbal"].plugged, bench.ports["light"].plugged) == (False, True)
    bench.order("gimbal replug")
    assert bench.ports["gimbal"].plugged


def test_mending_the_light_mends_lamp_and_line(bench: Bench):
    bench.parts.lines["light"].receive(b"OUTP ON\n")
    bench.order("light lamp_open")
    assert bench.shown[-1].high == 0.0
    bench.order("light mend")
    assert bench.shown[-1].high > 0.0
    bench.order("light trip")
    assert not bench.shown[-1].output


def test_faults_of_the_camera_reach_it(bench: Bench):
    bench.order("camera unplug")
    bench.order("camera fault message='too hot'")
    assert bench.camera.calls == ["unplugged", "too hot"]
    bench.order("camera frames_lost skip=1 count=2")
    assert [bench.camera.stream_faults.apply(b"ab") for _ in range(4)] == [b"ab", b"", b"", b"ab"]
    bench.order("camera overflow")
    assert bench.camera.stream_faults.overflows
    bench.order("camera silence")
    assert bench.camera.stream_faults.apply(b"ab") == b""
    bench.order("camera mend")
    assert bench.camera.stream_faults.apply(b"ab") == b"ab"
    assert not bench.camera.stream_faults.overflows


def test_somebody_moves_the_camera_across_the_beam_and_back(bench: Bench):
    bench.order("mount shift x_mm=3 y_mm=-0.5")
    assert bench.world.truth_at(bench.now_s).mount.shift_mm == (3.0, -0.5)
    bench.order("mount shift x_mm=1")
    assert bench.hands.seen()["shift_mm"] == [1.0, 0.0]
    bench.order("mount mend")
    assert bench.hands.seen()["shift_mm"] == [0.5, 0.0]
    assert bench.changes == 3


def test_the_camera_is_turned_in_its_mount_step_by_step(bench: Bench):
    bench.order("mount turn roll_deg=4")
    bench.order("mount turn roll_deg=6 pan_deg=-1.5")
    assert bench.hands.seen()["turn_deg"] == [-1.5, 0.0, 10.0]
    bench.order("mount mend")
    assert bench.hands.seen()["turn_deg"] == [0.0, 0.0, 0.0]


def test_the_lens_is_focused_by_distance_and_by_its_ring(bench: Bench):
    def seen() -> dict[str, Any]:
        return bench.hands.seen()

    assert (seen()["focus_distance_m"], seen()["ring_deg"]) == ("infinity", 0.0)
    bench.order("lens focus distance_m=1")
    assert seen()["focus_distance_m"] == 1.0
    at_1_m = seen()["ring_deg"]
    bench.order("lens turn deg=-3.5")
    assert seen()["ring_deg"] == pytest.approx(at_1_m - 3.5)
    assert seen()["focus_distance_m"] > 1.0
    bench.order("lens turn deg=3.5")
    assert seen()["focus_distance_m"] == pytest.approx(1.0)
    bench.order("lens ring deg=1000")
    assert (seen()["ring_deg"], seen()["focus_distance_m"]) == (pytest.approx(180.0), pytest.approx(0.2))
    bench.order("lens aperture f_number=8")
    assert seen()["f_number"] == 8.0
    bench.order("lens focus")
    assert seen()["focus_distance_m"] == "infinity"
    bench.order("lens mend")
    assert bench.world.truth_at(bench.now_s) == bench.world.truth


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("lens focus distance_m=0.05", "distance_m"),
        ("lens focus distance_m=near", "distance_m"),
        ("lens aperture f_number=0.1", "f_number"),
        ("lens ring deg=nan", "deg"),
        ("mount turn roll_deg=inf", "roll_deg"),
        ("lens zoom", "fault"),
    ],
)
def test_what_a_hand_cannot_do_is_refused(bench: Bench, text, where):
    with pytest.raises(ConfigError) as error:
        bench.order(text)
    assert error.value.where == where
    assert bench.changes == 0


def test_a_bench_without_a_mount_that_moves_says_so(bench: Bench):
    fixed = replace(bench.parts, hands=None)
    with pytest.raises(ConfigError, match="no device 'mount'"):
        fault_action(fault_order_from_text("mount shift x_mm=3"), fixed)


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("roll stall", "device"),
        ("mount shift x_mm=nan", "x_mm"),
        ("mount shift x_mm=far", "x_mm"),
        ("mount tilt", "fault"),
        ("gimbal-pan lost", "device"),
        ("light dim factor=0", "factor"),
        ("gimbal replaced pattern=(", "pattern"),
        ("gimbal say text='\\x'", "text"),
        ("gimbal preceded replacement=☃", "replacement"),
    ],
)
def test_an_order_that_makes_no_sense_here_names_its_key(bench: Bench, text, where):
    with pytest.raises(ConfigError) as caught:
        bench.order(text)
    assert caught.value.where == where


@pytest.mark.parametrize("kind", ["stall", "limit", "restart", "stop_short", "slip", "creep"])
def test_a_fault_of_a_motion_waits_for_it(bench: Bench, kind):
    fault_action(fault_order({"device": "tilt", "fault": kind, "skip": 2}), bench.parts)()
    armed = bench.parts.axes["tilt"].axis.armed
    assert armed is not None
    assert (armed.kind, armed.skip) == (kind, 2)
    assert bench.parts.axes["pan"].axis.armed is None


@pytest.mark.parametrize("kind", [*REPLY_FAULTS, *REQUEST_FAULTS, "stale", "any"])
def test_a_fault_of_messages_waits_for_them(bench: Bench, kind):
    fault_action(fault_order({"device": "gimbal", "fault": kind, "count": 3, "delay_s": 2}), bench.parts)()
    (waiting,) = bench.parts.lines["gimbal"].faults
    assert waiting == LineFault(kind, count=3, delay_s=2.0)
    assert bench.parts.lines["light"].faults == ()


ORDERS = [
    f"{device} {fault}" for device in ("pan", "gimbal", "light", "camera") for fault in faults_of(device)
]


@pytest.mark.parametrize("text", ORDERS)
def test_every_fault_of_the_catalogue_can_be_ordered_and_mended(bench: Bench, text):
    bench.order(text)
    for request in (b"/0 1 move abs 6400\n", b"/0 1 get pos\n"):
        bench.parts.lines["gimbal"].receive(request)
        bench.now_s += 10.0
    bench.parts.lines["light"].receive(b"OUTP ON\n")
    for device in ("pan", "gimbal", "light", "camera"):
        bench.order(f"{device} mend")
    assert bench.parts.lines["gimbal"].faults == bench.parts.lines["light"].faults == ()
    assert bench.parts.lines["gimbal"].baud == 115_200


@pytest.mark.parametrize(("fault", "plugged", "flag"), [("unplug", False, "--"), ("press_stop", True, "FH")])
def test_a_fault_from_outside_happens_during_a_move(bench: Bench, fault, plugged, flag):
    bench.order(f"pan {fault}")
    bench.parts.lines["gimbal"].receive(b"/1 1 move abs 6400\n")
    assert bench.ports["gimbal"].plugged
    assert f" {flag} " in bench.say("/1 1")
    assert bench.ports["gimbal"].plugged is plugged


def test_a_twist_raises_its_flag_and_no_progress_stays_busy(bench: Bench):
    bench.order("pan twist")
    bench.order("tilt no_progress")
    bench.say("/0 1 move abs 6400")
    assert "FT" in bench.say("/1 1")
    assert "BUSY" in bench.say("/2 1")
    assert " 3200:" in bench.say("/2 1 get pos")


def test_a_device_may_listen_at_another_rate_until_mended(bench: Bench):
    bench.order("gimbal baud rate=9600")
    assert bench.parts.lines["gimbal"].baud == 9600
    bench.order("gimbal mend")
    assert bench.parts.lines["gimbal"].baud == 115_200


def test_levels_are_clipped_until_mended(bench: Bench):
    light = bench.parts.lines["light"]
    for text, held in (("light clip most_v=2", b"+2"), ("light mend", b"+4")):
        bench.order(text)
        light.receive(b"OUTP:LOAD INF\nVOLT:HIGH 4\n")
        assert light.receive(b"VOLT:HIGH?\n").startswith(held)
