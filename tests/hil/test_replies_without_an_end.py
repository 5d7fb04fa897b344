"""Controllers some of whose replies have no end: Velmex VXM answers a question for the state by one letter."""

import re

import pytest

from drivers.described.line import DescribedLine
from drivers.errors import DriverError
from drivers.stage.text import TextStage
from tests.hil.direct_stages import VirtualClock
from tests.hil.test_described_stages_of_users import opened
from tests.hil.text_wire import LINES, Motor, Wire, described

pytestmark = pytest.mark.usefixtures("never_late")

SCALE = 80.0


def vxm(clock: VirtualClock) -> tuple[Wire, Motor]:
    wire, motor, begun = Wire(clock, LINES), Motor(clock), [False]

    def answer(request: str) -> str:
        if request == "getM1M":
            return "4\r"
        if request == "V":
            return "B" if motor.is_busy else "R"
        if request == "X":
            return f"{round(motor.position_deg * SCALE):+08d}\r"
        if request == "K":
            motor.stop()
            begun[0] = False
        if move := re.fullmatch(r"C,S1M2000,IA1M(-?\d+),R", request):
            motor.move(int(move[1]) / SCALE)
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


def opened_vxm() -> tuple[TextStage, Wire, Motor]:
    wire, motor = vxm(VirtualClock())
    return opened(wire, described("vxm"), ("X", SCALE)), wire, motor


def test_a_stage_whose_state_is_a_letter_without_an_end_is_driven() -> None:
    stage, wire, motor = opened_vxm()
    assert motor.position_deg == 2.0  # opening moves nothing
    assert not any("M" in request and "," in request for request in wire.sent)
    stage.home()
    stage.move_to({"pan": -7.5})
    assert motor.position_deg == -7.5
    assert stage.position_deg() == {"pan": -7.5}
    stage.stop()


def test_a_reply_that_comes_in_two_pieces_is_one_reply() -> None:
    """The pause between two packets of a USB adapter is shorter than a silence."""
    stage, wire, _ = opened_vxm()
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


def test_a_cut_position_gives_no_wrong_angle() -> None:
    stage, wire, motor = opened_vxm()
    stage.home()
    stage.move_to({"pan": 12.0})
    whole, cuts = wire.answer, [1]

    def cut(request: str) -> str:
        reply = whole(request)
        if "0960" in reply:
            cuts[0] -= 1
            return reply[:-4] if cuts[0] >= 0 else reply
        return reply

    wire.answer = cut
    assert stage.position_deg() == {"pan": 12.0}
    assert stage.is_homed()
    stage.move_to({"pan": 1.0})
    assert motor.position_deg == 1.0


def test_a_device_that_never_ends_a_reply_is_refused(monkeypatch) -> None:
    monkeypatch.setattr(DescribedLine, "longest_drain_s", 0.2)
    wire, _ = vxm(VirtualClock())
    wire.unasked = lambda: "0123456789" * 50
    with pytest.raises(DriverError, match=r"without pause|as described|not a reply"):
        opened(wire, described("vxm"), ("X", SCALE))
