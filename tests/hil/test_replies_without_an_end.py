"""Controllers some of whose replies have no end: Velmex VXM and Ludl answer a question for the state by one letter."""

from __future__ import annotations

import re

import pytest

from bench.stations.station_text import read_stage_protocol
from drivers.described.line import DescribedLine
from drivers.errors import DeviceRefused, DriverError
from drivers.stage import AxisLimits
from drivers.stage.text import TextAxis, TextStage
from tests.hil.direct_stages import VirtualClock
from tests.hil.text_wire import LINES, SPEED, Motor, Wire, described

pytestmark = pytest.mark.usefixtures("never_late")

SCALE = {"vxm": 80.0, "ludl": 1000.0}


def vxm(clock: VirtualClock) -> tuple[Wire, Motor]:
    wire, motor, begun = Wire(clock, LINES), Motor(clock), [False]

    def answer(request: str) -> str:
        if request == "getM1M":
            return "4\r"
        if request == "V":
            return "B" if motor.is_busy else "R"
        if request == "X":
            return f"{round(motor.position_deg * SCALE['vxm']):+08d}\r"
        if request == "K":
            motor.stop()
            begun[0] = False
        if move := re.fullmatch(r"C,S1M2000,IA1M(-?\d+),R", request):
            motor.move(int(move[1]) / SCALE["vxm"])
            begun[0] = True
        if request == "C,S1M2000,I1M-0,IA1M-0,R":
            motor.from_deg = motor.to_deg = 0.0
            begun[0] = True
        return ""

    def done() -> str:
        if begun[0] and not motor.is_busy:
            begun[0] = False
            return "^"
        return ""

    wire.answer, wire.unasked = answer, done
    return wire, motor


def ludl(clock: VirtualClock) -> tuple[Wire, Motor]:
    wire, motor = Wire(clock, LINES), Motor(clock)

    def answer(request: str) -> str:
        if request == "VER":
            return "Vers: 6.02\n"
        if request == "STATUS X":
            return "B" if motor.is_busy else "N"
        if request == "WHERE X":
            return f":A {round(motor.position_deg * SCALE['ludl'])} \n"
        if request == "HALT":
            motor.stop()
        elif request == "HOME X":
            motor.move(0.0)
        elif request.startswith("MOVE X="):
            if int(request[7:]) > 14_000:
                return ":N -4 \n"
            motor.move(int(request[7:]) / SCALE["ludl"])
        return ":A \n"

    wire.answer = answer
    return wire, motor


DEVICES = {"vxm": vxm, "ludl": ludl}


def opened(device: str) -> tuple[TextStage, Wire, Motor]:
    wire, motor = DEVICES[device](VirtualClock())
    axis = TextAxis(
        name="pan",
        limits=AxisLimits(-15.0, 15.0, SPEED, 1e3),
        address="X",
        counts_per_deg=SCALE[device],
        tolerance_deg=0.01,
    )
    protocol = read_stage_protocol(described(device)).value.for_driver()
    return TextStage(wire, [axis], protocol, clock=wire.clock), wire, motor


@pytest.mark.parametrize("device", DEVICES)
def test_a_stage_whose_state_is_a_letter_without_an_end_is_driven(device) -> None:
    stage, wire, motor = opened(device)
    assert motor.position_deg == 2.0  # opening moves nothing
    assert not any("M" in request and "," in request for request in wire.sent)
    stage.home()
    stage.move_to({"pan": -7.5})
    assert motor.position_deg == -7.5
    assert stage.position_deg() == {"pan": -7.5}
    stage.stop()


@pytest.mark.parametrize("device", DEVICES)
def test_a_reply_that_comes_in_two_pieces_is_one_reply(device) -> None:
    """The pause between two packets of a USB adapter is shorter than a silence."""
    stage, wire, _ = opened(device)
    stage.home()
    whole, held = wire.read, [b""]

    def in_pieces(timeout_s: float) -> bytes:
        if held[0]:
            data, held[0] = held[0], b""
            return data
        data = whole(timeout_s)
        data, held[0] = data[:3], data[3:]
        return data

    wire.read = in_pieces
    stage.move_to({"pan": 3.25})
    assert stage.position_deg() == {"pan": 3.25}


@pytest.mark.parametrize("device", DEVICES)
def test_a_cut_position_gives_no_wrong_angle(device) -> None:
    stage, wire, motor = opened(device)
    stage.home()
    stage.move_to({"pan": 12.0})
    whole, cuts = wire.answer, [1]

    def cut(request: str) -> str:
        reply = whole(request)
        if "12000" in reply or "0960" in reply:
            cuts[0] -= 1
            return reply[:-4] if cuts[0] >= 0 else reply
        return reply

    wire.answer = cut
    assert stage.position_deg() == {"pan": 12.0}
    assert stage.is_homed()
    stage.move_to({"pan": 1.0})
    assert motor.position_deg == 1.0


def test_a_refusal_of_ludl_is_told_and_nothing_moves() -> None:
    stage, _, motor = opened("ludl")
    stage.home()
    with pytest.raises(DeviceRefused, match="value out of range"):
        stage.move_to({"pan": 14.5})
    assert motor.position_deg == 0.0


def test_a_device_that_never_ends_a_reply_is_refused(monkeypatch) -> None:
    monkeypatch.setattr(DescribedLine, "longest_drain_s", 0.2)
    wire, _ = vxm(VirtualClock())
    wire.unasked = lambda: "0123456789" * 50
    axis = TextAxis(name="pan", limits=AxisLimits(-15.0, 15.0, SPEED, 1e3), address="X", counts_per_deg=80.0)
    protocol = read_stage_protocol(described("vxm")).value.for_driver()
    with pytest.raises(DriverError, match=r"without pause|as described|not a reply"):
        TextStage(wire, [axis], protocol, clock=wire.clock)
