"""Stages that a user describes from the maker's manual: answers in hexadecimal, late, of several axes, or none at all."""

import re
from pathlib import Path

import pytest

from bench.stations.text_descriptions import StageProtocol
from drivers.errors import DeviceRefused, DriverError, MoveFailed, MoveTimeout, OutsideLimits
from drivers.stage import AxisLimits
from drivers.stage.text import TextAxis, TextStage
from sequences.reader import read_document
from tests.hil.direct_stages import VirtualClock
from tests.hil.text_wire import LINES, SPEED, Motor, Wire, described


def opened(wire: Wire, description: Path, *axes: tuple[str, float], serial: str = "") -> TextStage:
    """Open a stage of these axes: addresses and counts per degree."""
    protocol = read_document(description, StageProtocol).value.for_driver()
    limits = AxisLimits(-15.0, 15.0, SPEED, 1e3)
    described = [
        TextAxis(name=name, limits=limits, address=address, counts_per_deg=scale)
        for name, (address, scale) in zip(("pan", "tilt"), axes, strict=False)
    ]
    return TextStage(wire, described, protocol, serial=serial, clock=wire.clock)


def changed(folder: Path, device: str, old: str, new: str) -> Path:
    """Change the description of a device, in a file of its own."""
    path = folder / "changed.yaml"
    path.write_text(described(device).read_text().replace(old, new))
    return path


# ------------------------------------------------------------ commands without a reply


def smc100(clock: VirtualClock) -> tuple[Wire, Motor]:
    wire, motor = Wire(clock, LINES), Motor(clock)
    known = wire.known = {"VA": "5", "errors": "0000", "state": "0A", "TE": "@"}
    awake_s = [0.0]

    def answer(request: str) -> str:
        verb, value = request[1:3], request[3:]
        if clock.now_s < awake_s[0]:
            return ""
        if verb == "RS":
            awake_s[0], known["state"] = clock.now_s + 3.0, "0A"
        if verb == "VE":
            return "1VE SMC_CC v2.0.0\r\n"
        if verb == "PA" and known["state"] != "0A":
            motor.move(float(value))
            known["state"] = "28"
        if verb == "OR" and known["state"] == "0A":
            motor.move(0.0)
            known["state"] = "1E"
        elif verb == "OR":
            known["TE"] = "K"  # not allowed in the state READY
        if verb == "VA" and value != "?":
            known["VA"] = value
        if verb == "ST":
            motor.stop()
        if known["state"] in {"1E", "28"} and not motor.is_busy:
            known["state"] = "32" if known["state"] == "1E" else "33"
        if verb == "TE":
            error, known["TE"] = known["TE"], "@"
            return f"1TE{error}\r\n"
        shown = {"TP": f"{motor.position_deg:.5g}", "TS": known["errors"] + known["state"], "VA": known["VA"]}
        return f"1{verb}{shown[verb]}\r\n" if verb in {"TP", "TS"} or value == "?" else ""

    wire.answer = answer
    return wire, motor


def test_commands_that_are_not_answered_are_checked_by_what_follows(clock) -> None:
    wire, motor = smc100(clock)
    stage = opened(wire, described("smc100"), ("1", 1.0))
    assert not stage.is_homed()
    stage.home()
    assert stage.is_homed()
    stage.move_to({"pan": -12.5})
    assert motor.position_deg == -12.5
    assert stage.position_deg() == {"pan": -12.5}
    assert "1VA20.000" in wire.sent


def test_bits_of_an_answer_tell_a_fault(clock) -> None:
    wire, _ = smc100(clock)
    stage = opened(wire, described("smc100"), ("1", 1.0))
    stage.home()
    wire.known["errors"] = "0400"  # a bit that does not count
    assert stage.faults() == []
    wire.known["errors"] = "0020"  # motion time out
    assert stage.faults() == ["pan: 32"]
    with pytest.raises(DriverError, match="32"):
        stage.move_to({"pan": 1.0})


def test_a_command_that_the_device_ignored_in_silence_is_a_failed_move(clock) -> None:
    wire, _ = smc100(clock)
    stage = opened(wire, described("smc100"), ("1", 1.0))
    stage.home()
    answer = wire.answer
    wire.answer = lambda request: "" if "PA" in request else answer(request)
    with pytest.raises(MoveFailed, match="stopped at 0"):
        stage.move_to({"pan": 5.0})


def test_a_homing_that_was_refused_in_silence_is_told_with_the_state(clock) -> None:
    wire, _ = smc100(clock)
    answer = wire.answer
    wire.answer = lambda request: "" if "OR" in request else answer(request)
    stage = opened(wire, described("smc100"), ("1", 1.0))
    with pytest.raises(MoveFailed, match=r"without a reference: '1TS' .* '0A'"):
        stage.home()
    assert not stage.is_homed()


def test_a_command_that_the_device_refuses_is_named_at_once(clock) -> None:
    wire, _ = smc100(clock)
    stage = opened(wire, described("smc100"), ("1", 1.0))
    answer = wire.answer

    def refusing(request: str) -> str:
        if request != refused:
            return answer(request)
        wire.known["TE"] = "C"
        return ""

    wire.answer, refused = refusing, "1VA20.000"
    with pytest.raises(DeviceRefused, match=r"'1VA20\.000': '1TE' .* 'C'"):
        stage.home()
    refused = "none"
    stage.home()
    refused, began_s = "1PA5.0000", clock.now_s
    with pytest.raises(DeviceRefused, match=r"'1PA5\.0000': '1TE' .* 'C'"):
        stage.move_to({"pan": 5.0})
    assert clock.now_s - began_s < 0.5  # after a stop, nothing is waited for that may still begin


def test_a_motion_that_begins_late_is_waited_for(clock) -> None:
    wire, motor = smc100(clock)
    stage = opened(wire, described("smc100"), ("1", 1.0))
    answer, asked_s = wire.answer, [0.0]
    held: list[str] = []

    def late(request: str) -> str:
        if "OR" in request or "PA" in request:
            held[:] = [request]
            asked_s[0] = clock.now_s
            return ""
        if held and clock.now_s > asked_s[0] + 0.5:
            answer(held.pop())
        return answer(request)

    wire.answer = late
    motor.move(2.0)
    clock.sleep(1.0)
    stage.home()
    assert stage.is_homed()
    assert motor.position_deg == 0.0
    stage.move_to({"pan": 7.5})
    assert motor.position_deg == 7.5
    wire.answer = lambda request: "" if "RS" in request else late(request)
    with pytest.raises(DeviceRefused, match="'1TE' is answered by 'K'"):  # told late, too
        stage.home()
    assert not stage.is_homed()


def test_a_state_that_is_neither_idle_nor_a_motion_is_named(clock) -> None:
    wire, _ = smc100(clock)
    wire.known["state"] = "14"  # configuration
    with pytest.raises(MoveTimeout, match=r"'1TS' .* '14'"):
        opened(wire, described("smc100"), ("1", 1.0))


# ------------------------------------------------------------ a target, then a start; one answer of two axes


def gsc02(clock: VirtualClock) -> tuple[Wire, dict[str, Motor]]:
    wire, motors = Wire(clock, LINES), {"1": Motor(clock), "2": Motor(clock)}
    targets, speeds = dict[str, float](), {"1": "500", "2": "500"}

    def answer(request: str) -> str:
        if request == "?:V":
            return "V1.23\r\n"
        if request == "Q:":
            counts = (round(motor.position_deg * 400) for motor in motors.values())
            return ",".join(f"{'-' if count < 0 else ' '}{abs(count):9d}" for count in counts) + ",K,K,R\r\n"
        if request == "!:":
            return "B\r\n" if any(motor.is_busy for motor in motors.values()) else "R\r\n"
        if request == "L:W":
            for motor in motors.values():
                motor.stop()
            return "OK\r\n"
        if request.startswith("?:D"):
            return f"S100F{speeds[request[3]]}R50\r\n"
        if target := re.fullmatch(r"A:([12])([+-])P([0-9]+)", request):
            targets[target[1]] = float(target[2] + target[3]) / 400
            return "OK\r\n"
        if speed := re.fullmatch(r"D:([12])S100F([0-9]+)R50", request):
            speeds[speed[1]] = speed[2]
            return "OK\r\n"
        if request == "G:":
            for name, target_deg in targets.items():
                motors[name].move(target_deg)
            targets.clear()
            return "OK\r\n"
        if request.startswith("H:"):
            motors[request[2]].move(0.0)
            return "OK\r\n"
        return "NG\r\n"

    wire.answer = answer
    return wire, motors


def test_a_target_is_set_and_then_started_and_each_axis_finds_its_own_value(clock) -> None:
    wire, motors = gsc02(clock)
    stage = opened(wire, described("gsc02"), ("1", 400.0), ("2", 400.0))
    stage.home()
    stage.move_to({"pan": -10.0, "tilt": 4.0})
    assert [motor.position_deg for motor in motors.values()] == [-10.0, 4.0]
    assert stage.position_deg() == {"pan": -10.0, "tilt": 4.0}
    assert {"A:1-P4000", "A:2+P1600"} <= set(wire.sent)


# ------------------------------------------------------------ hexadecimal positions, and an answer when the move has ended

ELL14_COUNTS_PER_DEG = 143360 / 360


def ell14(clock: VirtualClock) -> tuple[Wire, Motor]:
    wire, motor = Wire(clock, re.compile(rb"(0(?:in|gs|gp|st|gv|ho0|sv..|ma.{8}))")), Motor(clock)
    state = {"late": False, "speed": "32"}

    def position() -> str:
        return f"0PO{round(motor.position_deg * ELL14_COUNTS_PER_DEG) % 2**32:08X}\r\n"

    def answer(request: str) -> str:
        verb, value = request[1:3], request[3:]
        if verb in {"ma", "ho"}:
            counts = int(value, 16) if verb == "ma" else 0
            motor.move((counts - (2**32 if counts >= 2**31 else 0)) / ELL14_COUNTS_PER_DEG)
            state["late"] = True
            return ""
        if verb == "sv":
            state["speed"] = value
        if verb == "st":
            motor.stop()
        answers = {
            "in": "0IN0E1140005120231601016800023000\r\n",
            "gp": position(),
            "gv": f"0GV{state['speed']}\r\n",
        }
        return answers.get(verb, "0GS09\r\n" if motor.is_busy else "0GS00\r\n")

    def unasked() -> str:
        if motor.is_busy or not state["late"]:
            return ""
        state["late"] = False
        return position()

    wire.answer, wire.unasked = answer, unasked
    return wire, motor


def test_positions_in_hexadecimal_digits_come_when_the_move_has_ended(clock) -> None:
    wire, motor = ell14(clock)
    stage = opened(wire, described("ell14"), ("0", ELL14_COUNTS_PER_DEG))
    stage.home()
    stage.move_to({"pan": -10.0})
    assert motor.position_deg == pytest.approx(-10.0, abs=2e-3)
    assert stage.position_deg()["pan"] == pytest.approx(-10.0, abs=2e-3)
    assert {"0maFFFFF072", "0sv64"} <= set(wire.sent)


@pytest.mark.parametrize(
    ("status", "fault"), [("0GS02", "mechanical time-out"), ("0GS0D", "too much current")]
)
def test_a_status_in_the_place_of_the_position_is_told_and_the_stage_must_be_homed(
    clock, status, fault
) -> None:
    """A mount that is blocked, or has too weak a power supply, ends its move by a status."""
    wire, motor = ell14(clock)
    stage = opened(wire, described("ell14"), ("0", ELL14_COUNTS_PER_DEG))
    stage.home()
    position = wire.unasked
    wire.unasked = lambda: f"{status}\r\n" if position() else ""
    with pytest.raises(DriverError, match=fault):
        stage.move_to({"pan": -10.0})
    assert not stage.is_homed()
    assert not motor.is_busy


def test_a_position_that_has_more_digits_than_the_device_takes_is_not_sent(tmp_path, clock) -> None:
    wire, _ = ell14(clock)
    short = changed(tmp_path, "ell14", "{target:signed_hex.8}", "{target:signed_hex.3}")
    stage = opened(wire, short, ("0", ELL14_COUNTS_PER_DEG))
    stage.home()
    with pytest.raises(OutsideLimits, match="3 hexadecimal digits"):
        stage.move_to({"pan": -10.0})
    assert not any(request.startswith("0ma") for request in wire.sent)


# ------------------------------------------------------------ a code in each reply, and lines that nobody asked for


def test_a_code_of_success_is_no_refusal_and_lines_that_nobody_asked_for_are_left_out(clock) -> None:
    wire, motor = Wire(clock, LINES), Motor(clock)
    state = {"referenced": 0, "told_s": clock.now_s}

    def answer(request: str) -> str:
        if request == ":GSI":
            return ":ID2270127130\n"
        if request == ":GA0":
            return f":A0,{round(motor.position_deg * 1e6)},0\n"
        if request == ":GS0":
            return f":S0,{4 if motor.is_busy else 0}\n"
        if request == ":GPPK0":
            return f":PPK0,{state['referenced']}\n"
        if request.startswith(":MAA0,"):
            if not state["referenced"]:
                return ":E0,140\n"
            motor.move(float(request.split(",")[1]) / 1e6)
        elif request.startswith(":FRM0"):
            motor.move(0.0)
            state["referenced"] = 1
        elif request == ":S0":
            motor.stop()
        return ":E0,0\n"

    def unasked() -> str:
        if clock.now_s - state["told_s"] < 0.4:
            return ""
        state["told_s"] = clock.now_s
        return "T=24.5\n"

    wire.answer, wire.unasked = answer, unasked
    stage = opened(wire, described("mcs"), ("0", 1e6))
    stage.home()
    stage.move_to({"pan": -4.25})
    assert stage.position_deg() == {"pan": -4.25}
    assert wire.sent.count(":GSI") == 1  # nothing brought the line out of step
    state["referenced"] = 0
    with pytest.raises(DriverError):
        stage.move_to({"pan": 1.0})


# ------------------------------------------------------------ a prompt behind each reply


def test_a_word_ends_each_reply_and_a_refused_move_has_its_reason(clock) -> None:
    wire, motor = Wire(clock, re.compile(rb"(\w+\([^()]*\))")), Motor(clock)
    known = {"state": "42", "awaited": ""}

    def answer(request: str) -> str:
        name = request.partition("(")[0]
        if name in {"GroupMoveAbsolute", "GroupHomeSearch"}:
            if name == "GroupMoveAbsolute" and known["state"] == "42":
                return "-22,,EndOfAPI"
            motor.move(float(request[:-1].partition(",")[2] or 0.0))
            known["awaited"] = name
            return ""
        if name == "GroupMoveAbort":
            motor.stop()
        values = {"FirmwareVersionGet": "XPS-C8 Firmware V2.6.2", "GroupStatusGet": known["state"]}
        values["GroupPositionCurrentGet"] = f"{motor.position_deg:.6f}"
        return f"0,{values.get(name, '')},EndOfAPI"

    def unasked() -> str:
        if motor.is_busy or not known["awaited"]:
            return ""
        known["awaited"], known["state"] = "", "11" if known["awaited"] == "GroupHomeSearch" else "12"
        return "0,,EndOfAPI"

    wire.answer, wire.unasked = answer, unasked
    stage = opened(wire, described("xps"), ("Pan", 1.0))
    stage.home()
    stage.move_to({"pan": -6.125})
    assert stage.position_deg() == {"pan": -6.125}
    wire.answer = lambda request: "-22,,EndOfAPI" if "Move" in request else answer(request)
    with pytest.raises(DriverError, match="in another state"):
        stage.move_to({"pan": 1.0})
