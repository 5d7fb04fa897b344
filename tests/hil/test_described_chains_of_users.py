"""Described stages with a stop command for each axis: modules with several motors, and controllers in a chain."""

import pytest

from drivers.errors import DriverError, WrongDevice
from tests.hil.direct_stages import VirtualClock
from tests.hil.test_described_stages_of_users import changed, opened
from tests.hil.text_wire import LINES, Motor, Wire, described


def module(clock: VirtualClock) -> tuple[Wire, list[Motor]]:
    wire, motors = Wire(clock, LINES), [Motor(clock), Motor(clock)]
    deaf = wire.known = {}

    def answer(request: str) -> str:
        verb, *words = request.replace(",", "").split() or [""]
        status, value = 100, 0
        if request in deaf:
            return ""
        if verb == "AGGP":
            value = {"66": 1140, "76": 4711}[words[0]]
        elif verb == "AMVP":
            value = int(words[2])
            motors[int(words[1])].move(value / 1000)
        elif verb == "AGAP":
            motor = motors[int(words[1])]
            value = round(1000 * motor.position_deg) if words[0] == "1" else int(not motor.is_busy)
        elif verb == "ARFS":
            motors[int(words[1])].move(0.0)
        elif verb == "AMST":
            motors[int(words[0])].stop()
        else:
            status = 2
        return f"{request}\rBA {status} {value}\r"

    wire.answer = answer
    return wire, motors


def test_each_motor_of_a_module_is_moved_and_stopped(clock) -> None:
    wire, motors = module(clock)
    stage = opened(wire, described("tmcl"), ("0", 1000.0), ("1", 1000.0))
    stage.home()
    stage.move_to({"pan": -7.25, "tilt": 3.5})
    assert [motor.position_deg for motor in motors] == [-7.25, 3.5]
    for motor in motors:
        motor.move(10.0)
    stage.stop()
    assert wire.sent.count("AMST 0") == wire.sent.count("AMST 1") == 1
    assert not any(motor.is_busy for motor in motors)


def test_a_motor_that_does_not_answer_its_stop_keeps_no_other_one_from_stopping(clock) -> None:
    wire, motors = module(clock)
    stage = opened(wire, described("tmcl"), ("0", 1000.0), ("1", 1000.0))
    stage.home()
    for motor in motors:
        motor.move(14.0)
    wire.known["AMST 0"] = "is not heard"
    with pytest.raises(DriverError):
        stage.stop()
    assert not motors[1].is_busy
    assert motors[1].position_deg < 14.0


def test_a_stop_of_all_axes_is_sent_once(tmp_path, clock) -> None:
    wire, motors = module(clock)
    stage = opened(wire, changed(tmp_path, "tmcl", "AMST {address}", "AMST 0"), ("0", 1000.0), ("1", 1000.0))
    stage.home()
    motors[0].move(10.0)
    stage.stop()
    assert wire.sent.count("AMST 0") == 1


def test_a_serial_number_and_a_firmware_in_digits_have_no_decimal_point(clock) -> None:
    wire, _ = module(clock)
    stage = opened(wire, described("tmcl"), ("0", 1000.0), serial="4711")
    (axis,) = stage.identify()
    assert (axis.serial, axis.firmware) == ("4711", "1140")
    with pytest.raises(WrongDevice, match="the device answers '4711'"):
        opened(wire, described("tmcl"), ("0", 1000.0), serial="4712")
