"""Stages that a user describes from the maker's manual: answers in hexadecimal, late, of several axes, or none at all."""

from __future__ import annotations

import re

import pytest

from bench.stations.station_text import read_stage_protocol
from drivers.errors import DriverError, MoveFailed, OutsideLimits
from drivers.stage import AxisLimits
from drivers.stage.text import TextAxis, TextStage
from tests.hil.direct_stages import VirtualClock
from tests.hil.text_wire import LINES, SPEED, Motor, Wire

HEAD = "format: starbench/stage-protocol/1\nmaker: Maker\nmodel: Model\n"


def opened(
    wire: Wire, tmp_path, description: str, *axes: tuple[str, float], serial: str = "", **limits: float
) -> TextStage:
    """Open a stage of these axes: addresses and counts per degree."""
    (tmp_path / "stage.yaml").write_text(HEAD + description)
    protocol = read_stage_protocol(tmp_path / "stage.yaml").value.for_driver()
    limit = AxisLimits(
        **{"lowest_deg": -15.0, "highest_deg": 15.0, "speed_deg_s": SPEED, "acceleration_deg_s2": 1e3}
        | limits
    )
    described = [
        TextAxis(name=name, limits=limit, address=address, counts_per_deg=scale)
        for name, (address, scale) in zip(("pan", "tilt"), axes, strict=False)
    ]
    return TextStage(wire, described, protocol, serial=serial, clock=wire.clock)


@pytest.fixture
def clock() -> VirtualClock:
    return VirtualClock()


# ------------------------------------------------------------ commands without a reply

SMC100 = """
line: {baudrate: 57600, request_end: CRLF, reply_end: CRLF}
identity: {send: 1VE, reply: "1VE {firmware:text}"}
stop: {send: 1ST}
axis:
  position: {send: "{address}TP", reply: "{address}TP{counts:number}"}
  idle: {send: "{address}TS", reply: "{address}TS{errors:hex.4}{state:word}", when: ["0A", "0B", "32", "33", "34", "35"]}
  reference: {send: "{address}TS", reply: "{address}TS{errors:hex.4}{state:word}", when: ["32", "33", "34", "35", "28"]}
  faults: {send: "{address}TS", reply: "{address}TS{state:hex.4}{rest:word}", when: [0], bits: [0, 1, 2, 3, 4, 5, 6, 7, 8, 9]}
  move: {send: "{address}PA{target:number.4}"}
  home: {send: "{address}OR"}
  settings:
    - quantity: speed
      set: {send: "{address}VA{value:number.3}"}
      query: {send: "{address}VA?", reply: "{address}VA{value:number}"}
"""
"""Newport SMC100CC/PP, User's Manual, commands TS, TP, PA, OR, ST, VA: only queries are answered; 4 + 2 hexadecimal digits."""


def smc100(clock: VirtualClock) -> tuple[Wire, Motor]:
    wire, motor = Wire(clock, LINES), Motor(clock)
    known = wire.known = {"VA": "5", "errors": "0000", "state": "0A"}

    def answer(request: str) -> str:
        verb, value = request[1:3], request[3:]
        if verb == "VE":
            return "1VE SMC_CC v2.0.0\r\n"
        if verb == "PA" and known["state"] != "0A":
            motor.move(float(value))
            known["state"] = "28"
        if verb == "OR":
            motor.move(0.0)
            known["state"] = "1E"
        if verb == "VA" and value != "?":
            known["VA"] = value
        if verb == "ST":
            motor.stop()
        if known["state"] in {"1E", "28"} and not motor.is_busy:
            known["state"] = "32" if known["state"] == "1E" else "33"
        shown = {"TP": f"{motor.position_deg:.5g}", "TS": known["errors"] + known["state"], "VA": known["VA"]}
        return f"1{verb}{shown[verb]}\r\n" if verb in {"TP", "TS"} or value == "?" else ""

    wire.answer = answer
    return wire, motor


def test_commands_that_are_not_answered_are_checked_by_what_follows(tmp_path, clock) -> None:
    wire, motor = smc100(clock)
    stage = opened(wire, tmp_path, SMC100, ("1", 1.0))
    assert not stage.is_homed()
    stage.home()
    assert stage.is_homed()
    stage.move_to({"pan": -12.5})
    assert motor.position_deg == -12.5
    assert stage.position_deg() == {"pan": -12.5}
    assert "1VA20.000" in wire.sent


def test_bits_of_an_answer_tell_a_fault(tmp_path, clock) -> None:
    wire, _ = smc100(clock)
    stage = opened(wire, tmp_path, SMC100, ("1", 1.0))
    stage.home()
    wire.known["errors"] = "0400"  # a bit that does not count
    assert stage.faults() == []
    wire.known["errors"] = "0020"  # motion time out
    assert stage.faults() == ["pan: 32"]
    with pytest.raises(DriverError, match="32"):
        stage.move_to({"pan": 1.0})


def test_a_command_that_the_device_ignored_in_silence_is_a_failed_move(tmp_path, clock) -> None:
    wire, _ = smc100(clock)
    stage = opened(wire, tmp_path, SMC100, ("1", 1.0))
    stage.home()
    answer = wire.answer
    wire.answer = lambda request: "" if "PA" in request else answer(request)
    with pytest.raises(MoveFailed, match="stopped at 0"):
        stage.move_to({"pan": 5.0})


# ------------------------------------------------------------ a target, then a start; one answer of two axes

GSC02 = """
line: {baudrate: 9600, rtscts: true, request_end: CRLF, reply_end: CRLF}
identity: {send: "?:V", reply: "{firmware:text}"}
refusals: [{reply: NG, means: the controller does not take this command now}]
stop: {send: "L:W", reply: OK}
axis:
  position: {send: "Q:", reply: "{counts_1:integer},{counts_2:integer},{command:word},{stop:word},{ready:word}"}
  idle: {send: "!:", reply: "{state:word}", when: [R]}
  move: {send: "A:{address}{target:sign}P{target:size}", reply: OK}
  start: {send: "G:", reply: OK}
  home: {send: "H:{address}-", reply: OK}
  settings:
    - quantity: speed
      set: {send: "D:{address}S100F{value:integer}R50", reply: OK}
      query: {send: "?:D{address}", reply: "S100F{value:integer}R50"}
"""
"""OptoSigma and Sigma Koki GSC-02, User's Manual, commands A, G, Q, !, H, L, D; PySigmaKoki shows an answer to Q."""


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


def test_a_target_is_set_and_then_started_and_each_axis_finds_its_own_value(tmp_path, clock) -> None:
    wire, motors = gsc02(clock)
    stage = opened(wire, tmp_path, GSC02, ("1", 400.0), ("2", 400.0))
    stage.home()
    stage.move_to({"pan": -10.0, "tilt": 4.0})
    assert [motor.position_deg for motor in motors.values()] == [-10.0, 4.0]
    assert stage.position_deg() == {"pan": -10.0, "tilt": 4.0}
    assert {"A:1-P4000", "A:2+P1600"} <= set(wire.sent)


# ------------------------------------------------------------ hexadecimal positions, and an answer when the move has ended

ELL14 = """
line: {baudrate: 9600, request_end: none, reply_end: CRLF}
identity: {send: "0in", reply: "0IN{firmware:word}"}
stop: {send: "0st", reply: "0GS{state:hex.2}"}
axis:
  position: {send: "{address}gp", reply: "{address}PO{counts:signed_hex.8}"}
  idle: {send: "{address}gs", reply: "{address}GS{state:hex.2}", when: [0]}
  move: {send: "{address}ma{target:signed_hex.8}", reply: "{address}PO{counts:signed_hex.8}", reply_comes: at_end}
  home: {send: "{address}ho0", reply: "{address}PO{counts:signed_hex.8}", reply_comes: at_end}
  settings:
    - quantity: constant
      value: 100
      set: {send: "{address}sv{value:hex.2}", reply: "{address}GS00"}
      query: {send: "{address}gv", reply: "{address}GV{value:hex.2}"}
"""
"""Thorlabs ELLx modules, Protocol Manual, commands in, gs, gp, ma, ho, sv, gv: positions are signed numbers of 32 bits; no end
of a request; the position comes once the move has ended. An ELL14 has 143360 counts a turn."""
ELL14_COUNTS_PER_DEG = 143360 / 360


def ell14(clock: VirtualClock) -> tuple[Wire, Motor]:
    wire, motor = Wire(clock, re.compile(rb"(0(?:in|gs|gp|st|gv|ho0|sv..|ma.{8}))")), Motor(clock)
    told = {"late": False, "speed": "32"}

    def position() -> str:
        return f"0PO{round(motor.position_deg * ELL14_COUNTS_PER_DEG) % 2**32:08X}\r\n"

    def answer(request: str) -> str:
        verb, value = request[1:3], request[3:]
        if verb in {"ma", "ho"}:
            counts = int(value, 16) if verb == "ma" else 0
            motor.move((counts - (2**32 if counts >= 2**31 else 0)) / ELL14_COUNTS_PER_DEG)
            told["late"] = True
            return ""
        if verb == "sv":
            told["speed"] = value
        if verb == "st":
            motor.stop()
        answers = {
            "in": "0IN0E1140005120231601016800023000\r\n",
            "gp": position(),
            "gv": f"0GV{told['speed']}\r\n",
        }
        return answers.get(verb, "0GS09\r\n" if motor.is_busy else "0GS00\r\n")

    def unasked() -> str:
        if motor.is_busy or not told["late"]:
            return ""
        told["late"] = False
        return position()

    wire.answer, wire.unasked = answer, unasked
    return wire, motor


def test_positions_in_hexadecimal_digits_come_when_the_move_has_ended(tmp_path, clock) -> None:
    wire, motor = ell14(clock)
    stage = opened(wire, tmp_path, ELL14, ("0", ELL14_COUNTS_PER_DEG))
    stage.home()
    stage.move_to({"pan": -10.0})
    assert motor.position_deg == pytest.approx(-10.0, abs=2e-3)
    assert stage.position_deg()["pan"] == pytest.approx(-10.0, abs=2e-3)
    assert {"0maFFFFF072", "0sv64"} <= set(wire.sent)


def test_a_position_that_has_more_digits_than_the_device_takes_is_not_sent(tmp_path, clock) -> None:
    wire, _ = ell14(clock)
    stage = opened(
        wire,
        tmp_path,
        ELL14.replace("{target:signed_hex.8}", "{target:signed_hex.3}"),
        ("0", ELL14_COUNTS_PER_DEG),
    )
    stage.home()
    with pytest.raises(OutsideLimits, match="3 hexadecimal digits"):
        stage.move_to({"pan": -10.0})
    assert not any(request.startswith("0ma") for request in wire.sent)


# ------------------------------------------------------------ PI's general command set

MERCURY = """
line: {baudrate: 115200, request_end: LF, reply_end: LF}
identity: {send: "*IDN?", reply: "{firmware:text}"}
stop: {send: STP}
axis:
  position: {send: "POS? {address}", reply: "{address}={counts:number}"}
  idle: {send: "ONT? {address}", reply: "{address}={state:integer}", when: [1]}
  reference: {send: "FRF? {address}", reply: "{address}={state:integer}", when: [1]}
  faults: {send: "ERR?", reply: "{state:integer}", when: [0, 10]}   # 10: stopped by command
  move: {send: "MOV {address} {target:number.4}"}
  home: {send: "FRF {address}"}
  lowest: {send: "TMN? {address}", reply: "{address}={counts:number}"}
  highest: {send: "TMX? {address}", reply: "{address}={counts:number}"}
  settings:
    - quantity: constant
      value: 1
      set: {send: "SVO {address} {value:integer}"}
      query: {send: "SVO? {address}", reply: "{address}={value:integer}"}
"""
"""PI C-863 Mercury, User Manual (GCS 2.0), commands MOV, POS?, ONT?, FRF, ERR?, SVO, STP, TMN?, TMX?."""


def test_a_controller_of_pi_moves_by_its_general_command_set(tmp_path, clock) -> None:
    wire, motor = Wire(clock, LINES), Motor(clock)
    known = {"SVO": "0", "FRF": "0", "ERR": "0"}

    def answer(request: str) -> str:
        verb, _, value = request.partition(" 1")
        if verb in {"MOV", "FRF"} and known["SVO"] == "0":
            known["ERR"] = "5"
        elif verb == "MOV":
            motor.move(float(value))
        elif verb == "FRF":
            motor.move(0.0)
            known["FRF"] = "1"
        elif verb == "SVO":
            known["SVO"] = value.strip()
        elif verb == "STP":
            motor.stop()
            known["ERR"] = "10"
        if request == "*IDN?":
            return "(c)2013 Physik Instrumente(PI) Karlsruhe, C-863.11,0,1.2.1.0\n"
        if request == "ERR?":
            code, known["ERR"] = known["ERR"], "0"
            return f"{code}\n"
        shown = {
            "POS?": f"{motor.position_deg:.4f}", "ONT?": str(int(not motor.is_busy)), "FRF?": known["FRF"],
            "SVO?": known["SVO"], "TMN?": "-170.0000", "TMX?": "170.0000",
        }  # fmt: skip
        return f"1={shown[verb]}\n" if verb in shown else ""

    wire.answer = answer
    stage = opened(wire, tmp_path, MERCURY, ("1", 1.0))
    stage.home()
    stage.move_to({"pan": -7.25})
    assert stage.position_deg() == {"pan": -7.25}
    assert stage.faults() == []
    known["ERR"] = "1024"  # motion error: the position error became too large
    assert stage.faults() == ["pan: 1024"]


# ------------------------------------------------------------ a code in each reply, and lines that nobody asked for

MCS = """
line: {baudrate: 9600, request_end: LF, reply_end: LF}
identity: {send: ":GSI", reply: ":ID{firmware:text}"}
refusals: [{reply: ":E{channel:integer},{code:integer}", fine: ["0"], codes: {"140": no sensor}}]
unasked: ["T={celsius:number}"]
stop: {send: ":S0", reply: ":E0,0"}
axis:
  position: {send: ":GA{address}", reply: ":A{address},{counts:integer},{turns:integer}"}
  idle: {send: ":GS{address}", reply: ":S{address},{state:integer}", when: [0, 3]}
  reference: {send: ":GPPK{address}", reply: ":PPK{address},{state:integer}", when: [1]}
  move: {send: ":MAA{address},{target:integer},0,0", reply: ":E{address},0"}
  home: {send: ":FRM{address},2,0,1", reply: ":E{address},0"}
"""
"""SmarAct MCS, ASCII Programming Guide: a command is answered by its channel and an error code, of which 0 is none. The lines of a
temperature are those of many a board of one's own."""


def test_a_code_of_success_is_no_refusal_and_lines_that_nobody_asked_for_are_left_out(
    tmp_path, clock
) -> None:
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
    stage = opened(wire, tmp_path, MCS, ("0", 1e6))
    stage.home()
    stage.move_to({"pan": -4.25})
    assert stage.position_deg() == {"pan": -4.25}
    assert wire.sent.count(":GSI") == 1  # nothing brought the line out of step
    state["referenced"] = 0
    with pytest.raises(DriverError):
        stage.move_to({"pan": 1.0})


# ------------------------------------------------------------ a prompt behind each reply

GALIL = """
line: {baudrate: 19200, request_end: CR, prompt: ":"}
identity: {send: "ID", reply: "{firmware:word} :"}
stop: {send: ST, reply: ":"}
axis:
  position: {send: "TP{address}", reply: "{counts:integer} :"}
  idle: {send: "MG _BG{address}", reply: "{state:number} :", when: [0]}
  move: {send: "PA{address}={target:integer}", reply: ":"}
  start: {send: "BG{address}", reply: ":"}
  home: {send: "HM{address};BG{address}", reply: ":"}
  settings:
    - quantity: speed
      set: {send: "SP{address}={value:integer.6}", reply: ":"}
      query: {send: "MG _SP{address}", reply: "{value:number} :"}
"""
"""Galil DMC-40x0, User Manual, "Controller Response to Commands": data, CR, LF and a colon; a question mark for what it refuses."""


def test_a_prompt_ends_each_reply(tmp_path, clock) -> None:
    wire, motor = Wire(clock, LINES), Motor(clock)
    known = {"SP": 25000.0, "PA": 0.0}

    def answer(request: str) -> str:
        if request == "ID":
            return "DMC4020\r\n:"
        if request == "TPA":
            return f" {round(motor.position_deg * 1000)}\r\n:"
        if request.startswith("MG"):
            return f" {known['SP'] if 'SP' in request else float(motor.is_busy):.4f}\r\n:"
        if request.startswith(("PAA=", "SPA=")):
            known[request[:2]] = float(request[4:])
        elif request == "BGA":
            motor.move(known["PA"] / 1000)
        elif request == "HMA;BGA":
            motor.move(0.0)
        elif request == "ST":
            motor.stop()
        else:
            return "?"
        return ":"

    wire.answer = answer
    stage = opened(wire, tmp_path, GALIL, ("A", 1000.0))
    stage.home()
    stage.move_to({"pan": -3.5})
    assert motor.position_deg == -3.5
    assert "SPA=020000" in wire.sent


XPS = """
line: {baudrate: 115200, request_end: none, prompt: ",EndOfAPI"}
identity: {send: "FirmwareVersionGet(char *)", reply: "0,{firmware:text}"}
refusals: [{reply: "{code:integer},,EndOfAPI", fine: ["0"], codes: {"-22": the group is in another state}}]
stop: {send: "GroupMoveAbort(Gimbal)", reply: "0,,EndOfAPI"}
axis:
  position: {send: "GroupPositionCurrentGet(Gimbal.{address},double *)", reply: "0,{counts:number},EndOfAPI"}
  idle: {send: "GroupStatusGet(Gimbal,int *)", reply: "0,{state:integer},EndOfAPI", when: [11, 12, 42]}
  reference: {send: "GroupStatusGet(Gimbal,int *)", reply: "0,{state:integer},EndOfAPI", when: [11, 12]}
  move: {send: "GroupMoveAbsolute(Gimbal.{address},{target:number.5})", reply: "0,,EndOfAPI", reply_comes: at_end}
  home: {send: "GroupHomeSearch(Gimbal)", reply: "0,,EndOfAPI", reply_comes: at_end}
"""
"""Newport XPS-C and XPS-D, Programmer's Manual: an error, the values, and EndOfAPI; a move is answered when it has ended."""


def test_a_word_ends_each_reply_and_a_refused_move_has_its_reason(tmp_path, clock) -> None:
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
    stage = opened(wire, tmp_path, XPS, ("Pan", 1.0))
    stage.home()
    stage.move_to({"pan": -6.125})
    assert stage.position_deg() == {"pan": -6.125}
    wire.answer = lambda request: "-22,,EndOfAPI" if "Move" in request else answer(request)
    with pytest.raises(DriverError, match="the group is in another state"):
        stage.move_to({"pan": 1.0})
