"""The ESP stage: what it sends, and that no fault of a move passes for an arrival."""

from __future__ import annotations

import math
from collections.abc import Callable

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
from drivers.stage.esp import EspAxis, EspStage
from tests.unit.drivers.esp_peer import EspPeer

LIMITS = AxisLimits(-15.0, 15.0, 10.0, 50.0)


def axes() -> list[EspAxis]:
    return [
        EspAxis(name="pan", number=1, serial="SN1263", limits=LIMITS),
        EspAxis(name="tilt", number=2, serial="1264", limits=LIMITS, direction=-1, zero_deg=2.0),
    ]


@pytest.fixture
def peer(clock) -> EspPeer:
    return EspPeer(clock)


@pytest.fixture
def stage(peer, clock) -> EspStage:
    return EspStage(peer, axes(), clock=clock)


@pytest.fixture
def homed(stage, peer) -> EspStage:
    stage.home()
    peer.sent.clear()
    return stage


# ---------------------------------------------------------------- the good case
def test_opening_moves_nothing_and_programs_the_controller(stage, peer) -> None:
    assert peer.motions() == []
    assert peer.axes[1].values == {"SN": 7.0, "SL": -15.0, "SR": 15.0, "VA": 10.0, "AC": 50.0, "AG": 50.0}
    assert (peer.axes[2].values["SL"], peer.axes[2].values["SR"]) == (-13.0, 17.0)
    assert not peer.axes[1].motor


def test_identity_is_what_the_controller_says(stage) -> None:
    pan, tilt = stage.identify()
    assert (pan.name, pan.maker, pan.model, pan.serial) == ("pan", "Newport", "URS75CC", "SN1263")
    assert pan.firmware == "ESP301 Version 3.0.1 6/1/99"
    assert tilt.serial == "SN1264"


def test_homing_powers_the_motors_first(stage, peer) -> None:
    assert not stage.is_homed()
    assert stage.faults() == ["pan: motor off", "tilt: motor off"]
    stage.home()
    assert stage.is_homed()
    assert stage.faults() == []
    assert stage.position_deg() == {"pan": 0.0, "tilt": 2.0}
    assert peer.motions() == ["1OR1", "2OR1"]


def test_a_move_arrives_where_it_was_sent(homed, peer) -> None:
    homed.move_to({"pan": 5.25, "tilt": 3.0})
    assert homed.position_deg() == {"pan": 5.25, "tilt": 3.0}
    assert peer.motions() == ["1PA5.25000", "2PA-1.00000"]


# ---------------------------------------------------------------- refused before anything moves
def test_another_stage_is_refused_and_nothing_is_set(peer, clock) -> None:
    peer.axes[2].identity = "URS75CC, SN9"
    with pytest.raises(WrongDevice, match="1264 for tilt, but axis 2 answers 'URS75CC, SN9'"):
        EspStage(peer, axes(), clock=clock)
    assert peer.axes[1].values["VA"] == 1.0
    assert peer.closed


def test_an_axis_that_counts_in_millimetres_is_refused(peer, clock) -> None:
    peer.axes[1].values["SN"] = 2.0
    with pytest.raises(OutsideLimits, match="1SN7"):
        EspStage(peer, axes(), clock=clock)


def test_limits_beyond_the_controllers_are_refused(peer, clock) -> None:
    peer.axes[1].values["SR"] = 12.0
    with pytest.raises(OutsideLimits, match=r"-15 to 15 deg, but the controller allows only -20 to 12 deg\."):
        EspStage(peer, axes(), clock=clock)


def test_a_speed_the_controller_does_not_take_is_refused(peer, clock) -> None:
    class Slow(dict):
        def __setitem__(self, key, value) -> None:
            if key == "VA":
                peer.errors.append((110, "MAXIMUM VELOCITY EXCEEDED"))
            else:
                super().__setitem__(key, value)

    peer.axes[1].values = Slow(peer.axes[1].values)
    with pytest.raises(DeviceRefused, match=r"'1VA10\.00000': speed beyond its maximum \(error 110\)"):
        EspStage(peer, axes(), clock=clock)


def test_a_setting_that_reads_back_otherwise_is_refused(peer, clock) -> None:
    class Deaf(dict):
        def __setitem__(self, key, value) -> None:
            """Take nothing."""

    peer.axes[1].values = Deaf(peer.axes[1].values)
    with pytest.raises(DeviceRefused, match="SL was set to -15, but reads -20"):
        EspStage(peer, axes(), clock=clock)


def test_a_motor_that_does_not_go_on_is_not_homed(stage, peer) -> None:
    serve = peer.serve
    peer.serve = lambda text: None if text == "1MO" else serve(text)
    with pytest.raises(MoveFailed, match="the motor stays off"):
        stage.home()
    assert peer.motions() == []


@pytest.mark.parametrize("answer", ["no error", "0", "0, x, NO ERROR DETECTED", "204, 1, POSITIVE LIMIT"])
def test_an_error_buffer_of_another_form_or_without_end_is_refused(stage, peer, answer) -> None:
    serve = peer.serve
    peer.serve = lambda text: answer if text == "TB?" else serve(text)
    with pytest.raises(ReplyError):
        stage.faults()


def test_the_controllers_errors_are_told_once_in_plain_words(homed, peer) -> None:
    peer.errors.append((209, "FEEDBACK SIGNAL FAULT DETECTED"))
    peer.errors.append((7, "PARAMETER OUT OF RANGE"))
    assert homed.faults() == ["feedback signal lost (error 209)", "parameter out of range (error 7)"]
    assert homed.faults() == []


def test_a_motor_switched_off_undoes_the_reference(homed, peer) -> None:
    peer.axes[2].motor = False
    assert not homed.is_homed()
    with pytest.raises(NotHomed):
        homed.move_to({"pan": 1.0})
    assert peer.motions() == []


# ---------------------------------------------------------------- noticed in mid-move
def once_moving(peer: EspPeer, event: Callable[[], None], after_s: float = 0.2) -> None:
    """Let an event happen that long after the first move command."""
    state = {"at_s": math.inf, "done": False}

    def before(command: str) -> None:
        if command[1:3] == "PA":
            state["at_s"] = peer.clock.now_s + after_s
        if peer.clock.now_s >= state["at_s"] and not state["done"]:
            state["done"] = True
            event()

    peer.before = before


def hit_limit(peer: EspPeer) -> None:
    peer.axes[1].halt()
    peer.errors.append((104, "POSITIVE HARDWARE TRAVEL LIMIT"))


def restart_with_motors_on(peer: EspPeer) -> None:
    peer.restart()
    for axis in peer.axes.values():
        axis.motor = True


def complain(peer: EspPeer) -> None:
    peer.errors.append((103, "FOLLOWING ERROR"))


@pytest.mark.parametrize(
    ("event", "message"),
    [
        (lambda peer: peer.axes[1].halt(), "pan: stopped at .* from its target 9"),
        (EspPeer.restart, "motor went off, as after a fault or a restart"),
        (hit_limit, "stopped at"),
        (complain, r"following error beyond its threshold \(error 103\)"),
        (lambda peer: setattr(peer.axes[1], "stuck", True), "busy without progress"),
    ],
)
def test_a_move_that_goes_wrong_is_noticed_and_all_axes_are_stopped(homed, peer, event, message) -> None:
    once_moving(peer, lambda: event(peer))
    with pytest.raises(MoveFailed, match=message):
        homed.move_to({"pan": 9.0, "tilt": 9.0})
    assert "ST" in peer.sent
    assert peer.axes[2].start == peer.axes[2].goal


def test_a_restart_is_noticed_by_the_controllers_clock_even_at_its_own_zero(homed, peer) -> None:
    homed.move_to({"pan": 9.0})
    once_moving(peer, lambda: restart_with_motors_on(peer))
    with pytest.raises(MoveFailed, match="restarted during the move"):
        homed.move_to({"pan": 0.0})
    assert not homed.is_homed()


def test_homing_that_is_aborted_has_failed(stage, peer) -> None:
    peer.homes = False
    with pytest.raises(DriverError, match="homing aborted"):
        stage.home()
    assert not stage.is_homed()


def test_a_stop_goes_out_before_the_line_comes_into_step(homed, peer) -> None:
    peer.spoil = lambda line: b""
    with pytest.raises(ReplyError):
        homed.position_deg()
    peer.spoil = lambda line: line
    peer.axes[1].go(15.0)
    peer.sent.clear()
    homed.stop()
    assert peer.sent[0] == "ST"
    assert not peer.axes[1].busy()


# ---------------------------------------------------------------- a line that lies
MUTATIONS = {
    "echo": lambda line: b"1TP\r" + line,
    "twice": lambda line: line + line,
    "a byte too many": lambda line: line + b"x",
    "no line end": lambda line: line[:-2],
    "eighth bit": lambda line: bytes(byte | 0x80 for byte in line),
}


@pytest.mark.parametrize("name", MUTATIONS)
def test_a_controller_with_one_thing_wrong_is_refused(peer, clock, name) -> None:
    peer.spoil = MUTATIONS[name]
    with pytest.raises(ReplyError):
        EspStage(peer, axes(), clock=clock)
    assert peer.motions() == []


def test_the_answer_to_another_question_is_no_position(homed, peer) -> None:
    homed.move_to({"pan": -1.0})
    peer.spoil = lambda line: b"1\r\n" if b"." in line else line
    with pytest.raises(ReplyError, match="not a number with decimals"):
        homed.position_deg()
