"""Thorlabs controllers and Dynamixel servos as they are: silent commands, lost power, echoes, two servos on a wire."""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np
import pytest

from drivers.errors import (
    DeviceRefused,
    DriverError,
    MoveFailed,
    NotHomed,
    OutsideLimits,
    ReplyError,
    WrongDevice,
)
from drivers.stage import AxisLimits
from drivers.stage import thorlabs_controller as apt
from drivers.stage.dynamixel import DynamixelAxis, DynamixelStage
from drivers.stage.dynamixel_bus import READ, WRITE, packet
from drivers.stage.thorlabs import ThorlabsAxis, ThorlabsStage
from simulators.faults.line_faults import FaultLine
from simulators.stages.axis_motion import AxisModel, Mechanics
from simulators.stages.dynamixel import DynamixelBus
from simulators.stages.thorlabs_apt import AptController
from tests.hil.direct_stages import (
    FAMILIES,
    K10CR1_COUNTS_PER_DEG,
    LIMITS,
    DirectStage,
    VirtualClock,
    direct_line,
    stop_in_mid_move,
)

pytestmark = pytest.mark.usefixtures("never_late")

TORQUE_ON = bytes([3, 64, 0, 1])
GOAL = bytes([3, 116, 0])


class Gimbal:
    """Two servos on one bus, and the driver for them."""

    def __init__(self, scale: float = 4096 / 360, start_deg: float = 2.4, **more) -> None:
        self.clock = VirtualClock()
        self.more = {"counts_per_deg": scale, "limits": LIMITS, **more}
        mechanics = Mechanics(scale, -170.0, 170.0, start_deg=start_deg)
        self.bus = DynamixelBus({1: AxisModel(mechanics), 2: AxisModel(mechanics)}, self.clock.monotonic)
        self.line = direct_line(self.bus, self.clock)
        self.faults = self.line.device

    def open(self, **more) -> DynamixelStage:
        axes = [
            DynamixelAxis(name=name, id=number, model="XL430-W250", **(self.more | more))
            for name, number in (("pan", 1), ("tilt", 2))
        ]
        return DynamixelStage(self.line, axes, clock=self.clock)

    def start(self, number: int, counts: int) -> None:
        """Move a servo by another program's goal, that many counts further."""
        goal = int.from_bytes(self.table(number)[132:136], "little") + counts
        self.bus.servos[number].write(116, goal.to_bytes(4, "little", signed=True), self.clock.now_s)

    def true_deg(self, number: int = 1) -> float:
        return self.bus.servos[number].axis.pointing.angle_deg(self.clock.now_s + 1.0)

    def table(self, number: int = 1) -> bytes:
        return self.bus.servos[number].table(self.clock.now_s)


@pytest.fixture
def gimbal() -> Gimbal:
    return Gimbal()


# ---------------------------------------------------------------- servos
def test_opening_switches_no_torque_on_and_sets_no_goal(gimbal) -> None:
    stage = gimbal.open()
    assert not stage.is_homed()
    assert stage.position_deg() == pytest.approx({"pan": 2.4, "tilt": 2.4}, abs=0.05)
    with pytest.raises(NotHomed, match="torque of the servo is off"):
        stage.move_to({"pan": 1.0})
    assert not any(part in sent for sent in gimbal.line.sent for part in (TORQUE_ON, GOAL))
    assert gimbal.table()[64] == 0


def test_homing_holds_an_axis_where_it_stands(gimbal) -> None:
    stage = gimbal.open()
    before = gimbal.true_deg()
    stage.home()
    assert stage.is_homed()
    assert gimbal.true_deg() == before
    assert gimbal.table()[64] == 1
    stage.close()
    assert gimbal.table()[64] == 1, "without torque, an axis could fall"
    assert gimbal.open().is_homed()


def cut_power(gimbal: Gimbal, *, restored: bool = False) -> None:
    for servo in gimbal.bus.servos.values():
        servo.emergency_stop(gimbal.clock.now_s, released=restored)


def test_lost_power_is_noticed_and_the_angle_is_right_again_after_homing() -> None:
    gimbal = Gimbal(start_deg=-5.0, zero_count=10)
    # The servo counts 2048 at angle 0 of its own; with zero_count 10, the angle of the axis differs by a constant.
    offset_deg = (2048 - 10) * 360 / 4096
    limits = AxisLimits(offset_deg - 20.0, offset_deg + 20.0, 20.0, 100.0)
    stage = gimbal.open(limits=limits)
    stage.home()
    for _ in range(3):
        for target in (offset_deg - 12.0, offset_deg + 12.0):
            stage.move_to({"pan": target})
            assert gimbal.true_deg() == pytest.approx(target - offset_deg, abs=0.1)
        cut_power(gimbal)
        with pytest.raises(DriverError):
            stage.move_to({"pan": offset_deg})
        cut_power(gimbal, restored=True)
        gimbal.clock.sleep(1.0)
        assert not stage.is_homed()
        assert "pan: the torque is off" in stage.faults()
        stood = gimbal.true_deg()
        with pytest.raises((NotHomed, MoveFailed)):
            stage.move_to({"pan": offset_deg})
        assert gimbal.true_deg() == stood
        stage.home()
        assert int.from_bytes(gimbal.table()[112:116], "little") > 0, "0 would be a profile without limit"


def test_an_angle_across_the_end_of_the_servo_s_turn_is_one_angle() -> None:
    gimbal = Gimbal(start_deg=-179.0 + 10.0)
    # At the servo's own -180 deg its count goes from 0 to 4095; here that is the angle 0 of the axis.
    stage = gimbal.open(zero_count=0)
    assert stage.position_deg()["pan"] == pytest.approx(11.0, abs=0.1)
    mechanics = Mechanics(4096 / 360, -400.0, 400.0, start_deg=-191.0)
    gimbal.bus = DynamixelBus({1: AxisModel(mechanics), 2: AxisModel(mechanics)}, gimbal.clock.monotonic)
    gimbal.line.device = FaultLine(gimbal.bus, gimbal.clock.monotonic, np.random.default_rng(1))
    stage = gimbal.open(zero_count=0)
    assert stage.position_deg()["pan"] == pytest.approx(-11.0, abs=0.1)
    stage.home()
    for target in (-14.0, 14.0, -3.0):
        stage.move_to({"pan": target})
        assert gimbal.true_deg() == pytest.approx(target - 180.0, abs=0.1)


def test_an_overload_is_told_in_words_and_homing_restarts_that_servo_only(gimbal) -> None:
    stage = gimbal.open()
    stage.home()
    stage.move_to({"tilt": 5.0})
    gimbal.bus.servos[1].shut_down(0x20, gimbal.clock.now_s)
    with pytest.raises(MoveFailed, match=r"overload.*switched its torque off") as caught:
        stage.move_to({"pan": 9.0})
    assert "home the stage" in caught.value.remedy
    assert any("overload" in fault for fault in stage.faults())
    stage.home()
    stage.move_to({"pan": 9.0})
    assert gimbal.true_deg() == pytest.approx(9.0, abs=0.05)
    assert gimbal.true_deg(2) == pytest.approx(5.0, abs=0.05)
    assert sum(sent[7:8] == b"\x08" for sent in gimbal.line.sent) == 1


def test_a_fault_that_a_restart_does_not_clear_is_told(gimbal) -> None:
    stage = gimbal.open()
    stage.home()
    gimbal.bus.servos[2].shut_down(
        0x01, gimbal.clock.now_s
    )  # the voltage is not among the reasons to shut down: the torque is on
    with pytest.raises(MoveFailed, match="supply voltage out of range"):
        stage.home()
    assert gimbal.table(2)[64] == 1


def test_torque_in_another_mode_is_refused_and_stays_on(gimbal) -> None:
    gimbal.bus.servos[1].write(64, b"\1", gimbal.clock.now_s)
    with pytest.raises(DeviceRefused, match="torque is on in operating mode 3"):
        gimbal.open()
    assert gimbal.table()[64] == 1
    gimbal.bus.servos[1].write(64, b"\0", gimbal.clock.now_s)
    gimbal.bus.servos[1].write(10, b"\x0c", gimbal.clock.now_s)
    gimbal.open()
    assert gimbal.table()[10:12] == b"\0\4"


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"counts_per_deg": 200.0}, OutsideLimits),
        ({"limits": AxisLimits(-15.0, 15.0, 3000.0, 100.0)}, OutsideLimits),
        ({"limits": AxisLimits(-15.0, 15.0, 20.0, 5.0)}, OutsideLimits),
    ],
)
def test_what_does_not_fit_a_servo_is_refused(gimbal, changes, error) -> None:
    with pytest.raises(error):
        gimbal.open(**changes)


def test_another_model_is_refused(gimbal) -> None:
    gimbal.bus.servos[2].exchange("1020", gimbal.clock.now_s)
    gimbal.clock.sleep(1.0)
    with pytest.raises(WrongDevice, match=r"XL430-W250 for tilt, but the servo with id 2 is a XM430-W350"):
        gimbal.open()


@pytest.mark.parametrize("lost", [0, 1, 2])
def test_a_stop_of_servos_is_confirmed_though_messages_are_lost(gimbal, lost) -> None:
    stage = gimbal.open()
    stage.home()
    stage.move_to({"pan": -14.0, "tilt": 14.0})

    def lose_goals(data: bytes) -> bool:
        if data[7:10] != GOAL or len(goals) >= 2 + lost:
            return False
        goals.append(data)
        return len(goals) > 2

    goals: list[bytes] = []
    gimbal.line.lose = lose_goals
    error = stop_in_mid_move(gimbal.clock, stage, {"pan": 14.0, "tilt": -14.0}, 0.4)
    assert "stopped on request" in error.what
    rest = gimbal.true_deg(), gimbal.true_deg(2)
    assert max(map(abs, rest)) < 12.0
    gimbal.clock.sleep(5.0)
    assert (gimbal.true_deg(), gimbal.true_deg(2)) == pytest.approx(rest, abs=0.02)
    assert gimbal.table()[64] == 1


def test_a_silent_servo_does_not_delay_the_stop_of_the_other(gimbal) -> None:
    stage = gimbal.open()
    stage.home()
    gimbal.start(2, 150)
    gimbal.clock.sleep(0.2)
    gimbal.bus.servos[1].emergency_stop(gimbal.clock.now_s)
    began_s = gimbal.clock.now_s
    with pytest.raises(ReplyError):
        stage.stop()
    rest_s = gimbal.bus.servos[2].axis.commanded.end_s
    assert rest_s - began_s < 1.5
    assert gimbal.true_deg(2) < 12.0


def test_a_stop_of_servos_does_not_wait_for_the_line_to_come_into_step(gimbal) -> None:
    stage = gimbal.open()
    stage.home()
    gimbal.line.lose_step(stage.position_deg)
    for number in (1, 2):
        gimbal.start(number, 130)
    gimbal.clock.sleep(0.2)
    began_s = gimbal.clock.now_s
    stage.stop()
    first = [(data[4], data[7]) for data in gimbal.line.sent[:4]]
    assert first == [(1, READ), (1, WRITE), (2, READ), (2, WRITE)]
    for servo in gimbal.bus.servos.values():
        assert servo.axis.commanded.end_s - began_s < 0.3
    assert gimbal.true_deg() < 10.0
    assert gimbal.true_deg(2) < 10.0


@pytest.mark.parametrize("late_s", [0.04, 0.5])
def test_a_stop_by_an_old_state_is_put_right_once_the_line_is_in_step(gimbal, late_s) -> None:
    stage = gimbal.open()
    stage.home()
    stage.move_to({"pan": -14.0})
    gimbal.line.lose_step(stage.position_deg)
    gimbal.start(1, 300)
    gimbal.clock.sleep(0.2)
    old = gimbal.bus.receive(packet(1, READ, struct.pack("<HH", 64, 83)))
    states = [old]
    gimbal.line.spoil = lambda reply: states.pop() if states and len(reply) == len(old) else reply
    gimbal.clock.sleep(late_s)
    stage.stop()
    assert not states
    rest = gimbal.true_deg()
    assert -14.0 < rest < 5.0
    gimbal.clock.sleep(5.0)
    assert gimbal.true_deg() == pytest.approx(rest, abs=0.02)


# ---------------------------------------------------------------- Thorlabs


@pytest.fixture(params=["thorlabs", "k10cr1"], ids=["KDC101", "K10CR1"])
def rig(request) -> DirectStage:
    return FAMILIES[request.param](VirtualClock(), np.random.default_rng(1))


def test_opening_a_controller_sends_no_motion_and_switches_no_motor_on() -> None:
    clock = VirtualClock()
    model = AxisModel(
        Mechanics(K10CR1_COUNTS_PER_DEG, -17.0, 17.0, start_deg=2.4),
        "55000123",
        speed_deg_s=10.0,
        acceleration_deg_s2=5.0,
    )
    controller = AptController(model, clock.monotonic)
    line = direct_line(controller, clock)
    axis = ThorlabsAxis(
        name="pan", port="", serial="55000123", counts_per_deg=K10CR1_COUNTS_PER_DEG, limits=LIMITS
    )
    stage = ThorlabsStage([line], [axis], clock=clock)
    stage.close()
    numbers = {int.from_bytes(sent[:2], "little") for sent in line.sent}
    assert numbers.isdisjoint({apt.HOME, apt.MOVE_TO, apt.SET_ENABLED, 0x0448, 0x046A, 0x0457})
    assert apt.SET_SPEED in numbers
    for changes, error in (
        ({"counts_per_deg": 1919.64}, OutsideLimits),
        ({"serial": "55000124"}, WrongDevice),
        ({"limits": AxisLimits(-15.0, 15.0, 1e9, 10.0)}, OutsideLimits),
    ):
        with pytest.raises(error):
            ThorlabsStage([line], [ThorlabsAxis(**({**vars(axis), **changes}))], clock=clock)
    controller.model = replace(model, name="PPC001")
    with pytest.raises(DeviceRefused, match="PPC001"):
        ThorlabsStage([line], [axis], clock=clock)


def test_a_command_that_is_lost_is_no_homing_and_no_move(rig) -> None:
    rig.stage.home()
    rig.line.lose_next(apt.short(apt.HOME, 1))
    with pytest.raises(MoveFailed, match="did not begin to home"):
        rig.stage.home()
    assert not rig.stage.is_homed()
    rig.stage.home()
    assert rig.stage.is_homed()
    rig.line.lose_next(b"\x53\x04")
    with pytest.raises(MoveFailed, match="stopped at"):
        rig.stage.move_to({"pan": 5.0})
    assert rig.true_deg() == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("lost", [0, 1])
def test_a_stop_of_a_controller_is_confirmed_though_it_is_lost_once(rig, lost) -> None:
    rig.stage.home()
    rig.line.lose_next(apt.short(apt.STOP, 1, apt.STOP_BY_RAMP), lost)
    error = stop_in_mid_move(rig.line.clock, rig.stage, {"pan": 14.0}, 0.1)
    assert "stopped on request" in error.what
    rest = rig.true_deg()
    assert 0.05 < rest < 13.9
    rig.line.clock.sleep(5.0)
    assert rig.true_deg() == pytest.approx(rest, abs=1e-3)


def test_updates_that_another_program_has_switched_on_are_no_trouble(rig) -> None:
    rig.controller.receive(apt.short(0x0011))
    rig.stage.home()
    rig.controller.receive(apt.short(0x0011))
    rig.stage.move_to({"pan": 3.0})
    assert rig.stage.position_deg()["pan"] == pytest.approx(3.0, abs=1e-3)


def test_a_channel_switched_off_at_the_panel_is_told_and_homing_switches_it_on(rig) -> None:
    rig.stage.home()
    rig.controller.switch_off_channel(rig.line.clock.now_s)
    assert "pan: its channel is switched off" in rig.stage.faults()
    with pytest.raises(MoveFailed, match="channel is switched off"):
        rig.stage.move_to({"pan": 5.0})
    rig.stage.home()
    rig.stage.move_to({"pan": 5.0})
    assert rig.true_deg() == pytest.approx(5.0, abs=1e-3)


def test_a_limit_switch_is_named(rig) -> None:
    rig.stage.home()
    rig.order("pan limit")
    with pytest.raises(MoveFailed, match="stopped at a limit: forward limit switch"):
        rig.stage.move_to({"pan": 9.0})


def test_each_request_to_a_servo_controller_carries_a_sign_of_life() -> None:
    rig = FAMILIES["thorlabs"](VirtualClock(), np.random.default_rng(1))
    rig.stage.home()
    asked = [sent for sent in rig.line.sent if sent.endswith(apt.short(apt.REQUEST_STATUS, 1))]
    assert len(asked) > 20
    assert all(sent.startswith(apt.short(apt.STILL_THERE)) for sent in asked)
