"""The XIMC stage: what it sends, and that no fault of a move passes for an arrival."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable

import pytest

from drivers.errors import (
    DeviceRefused,
    MoveFailed,
    OutsideLimits,
    ReplyError,
    ReplyGarbled,
    WrongDevice,
)
from drivers.stage import AxisLimits
from drivers.stage.ximc import XimcAxis, XimcStage
from drivers.stage.ximc_protocol import MoveSettings, Status, check_data, crc16, move_data, request
from tests.unit.drivers.ximc_peer import DIVISION, XimcPeer, crc

SCALE = 80.0
LIMITS = AxisLimits(-15.0, 15.0, 10.0, 50.0)


def axes(**changes) -> list[XimcAxis]:
    pan = XimcAxis(name="pan", port="a", serial="12345", steps_per_deg=SCALE, limits=LIMITS, **changes)
    tilt = XimcAxis(name="tilt", port="b", serial="12346", steps_per_deg=-SCALE, limits=LIMITS, zero_deg=1.0)
    return [pan, tilt]


@pytest.fixture
def peers(clock) -> tuple[XimcPeer, XimcPeer]:
    return XimcPeer(clock, 12345, "a"), XimcPeer(clock, 12346, "b")


@pytest.fixture
def stage(peers, clock) -> XimcStage:
    return XimcStage(peers, axes(), clock=clock)


@pytest.fixture
def homed(stage, peers) -> XimcStage:
    stage.home()
    for peer in peers:
        peer.sent.clear()
    return stage


# ---------------------------------------------------------------- the protocol
def test_the_crc_is_the_makers() -> None:
    assert crc16(b"123456789") == 0x4B37
    assert struct.pack("<H", crc16(bytes(range(200)))) == crc(bytes(range(200)))


def test_a_move_is_what_the_makers_library_sends() -> None:
    sent = b"move" + b"d\0\0\0" + b"\xfb\xff" + b"\xcc" * 6 + b"\xffS"
    assert request("move", move_data(100, -5)) == sent


def test_a_reply_the_makers_library_takes_is_taken() -> None:
    assert check_data("gser", b"90\0\0\x0c\xb7", "port") == struct.pack("<I", 12345)
    with pytest.raises(ReplyGarbled, match="port: wrong CRC"):
        check_data("gser", b"91\0\0\x0c\xb7", "port")


def test_a_status_is_taken_apart() -> None:
    data = struct.pack("<5Bihqih5hIIB4x", 1, 0x81, 3, 4, 0x33, -5, -7, -99, 0, 0, 0, 0, 0, 0, 0, 0x60, 0, 1)
    status = Status.unpack(data)
    assert (status.steps, status.microsteps, status.encoder) == (-5, -7, -99)
    assert status.running
    assert status.homed
    assert status.command == "move"
    assert status.faults == ["alarm"]


def test_settings_keep_what_they_do_not_change() -> None:
    data = bytes(range(24))
    assert MoveSettings.unpack(data).pack() == data


# ---------------------------------------------------------------- the good case
def test_opening_moves_nothing_and_programs_speed_and_borders(stage, peers) -> None:
    assert all(peer.motions() == [] for peer in peers)
    assert struct.unpack("<IBHHIBB9s", peers[0].mov) == (800, 0, 4000, 4000, 50, 0, 0, b"reserved!")
    assert struct.unpack("<BBihih6x", peers[0].eds)[2:6] == (-1200, 0, 1200, 0)
    assert struct.unpack("<BBihih6x", peers[1].eds)[2:6] == (-1120, 0, 1280, 0)


def test_borders_at_limit_switches_are_left_alone(peers, clock) -> None:
    before = peers[0].eds = b"\x06" + peers[0].eds[1:]
    XimcStage(peers, axes(), clock=clock)
    assert peers[0].eds == before


def test_identity_is_what_the_controllers_say(stage) -> None:
    pan, tilt = stage.identify()
    assert (pan.name, pan.maker, pan.model, pan.serial, pan.firmware) == (
        "pan",
        "XIMC",
        "8SMC5",
        "12345",
        "4.7.1",
    )
    assert tilt.serial == "12346"


def test_the_reference_becomes_the_zero(stage) -> None:
    assert not stage.is_homed()
    assert stage.faults() == ["pan: no reference", "tilt: no reference"]
    stage.home()
    assert stage.is_homed()
    assert stage.position_deg() == {"pan": 0.0, "tilt": 1.0}


def test_a_move_arrives_where_it_was_sent(homed, peers) -> None:
    homed.move_to({"pan": -5.1, "tilt": 3.0})
    assert [peer.position() for peer in peers] == [round(-5.1 * SCALE * DIVISION), -2 * SCALE * DIVISION]
    assert homed.position_deg()["pan"] == pytest.approx(-5.1, abs=0.5 / SCALE / DIVISION)
    (sent,) = peers[0].motions()
    assert sent[:10] == b"move" + struct.pack("<ih", -408, 0)


def test_an_alarm_is_cleared_by_homing_when_its_cause_is_gone(homed, peers) -> None:
    peers[0].flags |= 0x40

    def cleared(command: str) -> None:
        if command == "stop":
            peers[0].flags &= ~0x40

    peers[0].before = cleared
    homed.home()
    homed.move_to({"pan": 1.0})
    assert homed.position_deg()["pan"] == pytest.approx(1.0, abs=0.01)


def test_homing_that_leaves_no_reference_has_failed(stage, peers) -> None:
    answer = peers[1].answer
    peers[1].answer = lambda command, data: b"" if command == "home" else answer(command, data)
    with pytest.raises(MoveFailed, match="tilt: homing ended without a reference"):
        stage.home()


# ---------------------------------------------------------------- refused before anything moves
def test_another_controller_is_refused_and_nothing_is_set(peers, clock) -> None:
    peers[1].serial = 999
    with pytest.raises(WrongDevice, match="12346 for tilt, but 999 answers"):
        XimcStage(peers, axes(), clock=clock)
    assert not any(data.startswith((b"smov", b"seds")) for peer in peers for data in peer.sent)
    assert all(peer.closed for peer in peers)


def test_an_axis_in_alarm_is_not_moved(homed, peers) -> None:
    peers[1].flags |= 0x40
    with pytest.raises(MoveFailed, match="tilt: alarm"):
        homed.move_to({"pan": 1.0, "tilt": 1.0})
    assert peers[0].motions() == []


def test_a_speed_beyond_the_controller_is_refused(peers, clock) -> None:
    fast = XimcAxis(
        name="pan", port="a", serial="", steps_per_deg=SCALE, limits=AxisLimits(-1, 1, 10.0, 900.0)
    )
    with pytest.raises(OutsideLimits, match=r"72000 steps/s\^2"):
        XimcStage(peers[:1], [fast], clock=clock)


def test_a_motor_that_is_no_stepper_is_refused(peers, clock) -> None:
    peers[1].engine_type = 1
    with pytest.raises(DeviceRefused, match=r"no stepper motor \(engine type 1\)"):
        XimcStage(peers, axes(), clock=clock)


def test_a_setting_that_reads_back_otherwise_is_refused(peers, clock) -> None:
    answer = peers[0].answer
    peers[0].answer = lambda command, data: b"" if command == "smov" else answer(command, data)
    with pytest.raises(DeviceRefused, match="speed and acceleration read back differently"):
        XimcStage(peers, axes(), clock=clock)


def test_a_value_the_controller_corrects_is_refused(peers, clock) -> None:
    serve = peers[0].serve
    peers[0].serve = lambda command, data, given: (
        b"errv" if command == "smov" else serve(command, data, given)
    )
    with pytest.raises(DeviceRefused, match="out of range"):
        XimcStage(peers, axes(), clock=clock)


# ---------------------------------------------------------------- noticed in mid-move
def once_moving(peer: XimcPeer, event: Callable[[], None], after_s: float = 0.2) -> None:
    """Let an event happen that long after the first move command."""
    state = {"at_s": math.inf, "done": False}

    def before(command: str) -> None:
        if command == "move":
            state["at_s"] = peer.clock.now_s + after_s
        if peer.clock.now_s >= state["at_s"] and not state["done"]:
            state["done"] = True
            event()

    peer.before = before


def restart(peer: XimcPeer) -> None:
    peer.flags = peer.command_state = 0
    peer.start = peer.goal = 0.0


def raise_alarm(peer: XimcPeer) -> None:
    peer.flags |= 0x40


def fail(peer: XimcPeer) -> None:
    peer.halt()
    peer.command_state |= 0x40


@pytest.mark.parametrize(
    ("event", "message"),
    [
        (XimcPeer.halt, "pan: stopped at .* from its target 9"),
        (restart, "pan: the controller lost its reference during the move"),
        (raise_alarm, "pan: alarm"),
        (fail, "pan: the controller reports that its move failed"),
        (lambda peer: peer.go(0.0, 3), r"pan: interrupted by another command \(left\)"),
        (lambda peer: setattr(peer, "busy", lambda: True), "busy without progress"),
        (lambda peer: setattr(peer, "busy", lambda: False), "stopped at"),
    ],
)
def test_a_move_that_goes_wrong_is_noticed_and_all_axes_are_stopped(homed, peers, event, message) -> None:
    once_moving(peers[0], lambda: event(peers[0]))
    with pytest.raises(MoveFailed, match=message):
        homed.move_to({"pan": 9.0, "tilt": 9.0})
    assert not peers[1].busy()


def test_a_slip_between_counter_and_encoder_is_noticed(peers, clock) -> None:
    stage = XimcStage(peers, axes(encoder_counts_per_deg=SCALE * DIVISION / 64), clock=clock)
    stage.home()
    stage.move_to({"pan": 5.0})
    assert stage.encoder_deg()["pan"] == pytest.approx(5.0, abs=0.01)
    peers[0].slip = 100
    with pytest.raises(MoveFailed, match="pan: slipped"):
        stage.move_to({"pan": 6.0})


def test_a_stop_reaches_every_axis_even_when_one_is_silent(homed, peers) -> None:
    peers[0].spoil = lambda reply: b""
    peers[1].go(9000.0, 1)
    with pytest.raises(ReplyError):
        homed.stop()
    assert not peers[1].busy()


# ---------------------------------------------------------------- a line that lies


def test_bytes_left_over_from_before_us_do_no_harm(peers, clock) -> None:
    peers[0].pending = b"smov" + bytes(7)
    peers[0].ready = b"\0\0gets"
    assert len(XimcStage(peers, axes(), clock=clock).identify()) == len(peers)
    assert peers[0].motions() == []


def test_a_move_that_arrived_damaged_is_not_sent_again(homed, peers) -> None:
    serve = peers[0].serve
    peers[0].serve = lambda command, data, given: (
        b"errd" if command == "move" else serve(command, data, given)
    )
    with pytest.raises(ReplyGarbled, match="errd"):
        homed.move_to({"pan": 9.0})
    assert len(peers[0].motions()) == 1
