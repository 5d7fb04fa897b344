"""The GRBL stage: what it sends, and that no fault of a move passes for an arrival."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import pytest

from drivers.errors import (
    DeviceRefused,
    DriverError,
    MoveFailed,
    MoveTimeout,
    NotHomed,
    OutsideLimits,
    ReplyError,
    ReplyGarbled,
    ReplyTimeout,
    WrongDevice,
)
from drivers.stage import AxisLimits, grbl_controller
from drivers.stage.grbl import GrblAxis, GrblStage
from drivers.stage.grbl_controller import parse_report
from tests.unit.drivers.grbl_peer import GrblPeer

LIMITS = AxisLimits(-15.0, 15.0, 10.0, 50.0)


def axes(**changes) -> list[GrblAxis]:
    return [
        GrblAxis(name=name, letter=letter, steps_per_deg=100.0, zero_deg=18.0, limits=LIMITS, **changes)
        for name, letter in (("pan", "X"), ("tilt", "Y"))
    ]


@pytest.fixture
def peer(clock) -> GrblPeer:
    return GrblPeer(clock)


@pytest.fixture
def stage(peer, clock) -> GrblStage:
    return GrblStage(peer, axes(), serial="gimbal-7", clock=clock)


@pytest.fixture
def homed(stage, peer) -> GrblStage:
    stage.home()
    peer.sent.clear()
    return stage


# ---------------------------------------------------------------- the protocol
@pytest.mark.parametrize(
    "line",
    [
        b"<Idle|WPos:0.000,0.000|FS:0,0>\r\n",
        b"<Flying|MPos:0.000,0.000|FS:0,0>\r\n",
        b"<Idle|MPos:0.000|FS:0,0>\r\n",
        b"<Idle|MPos:0.0.0,1.000|FS:0,0>\r\n",
    ],
)
def test_a_report_of_another_form_is_refused(line) -> None:
    with pytest.raises(ReplyGarbled, match=r"\$10=1"):
        parse_report(line)


def test_a_cut_report_is_no_report() -> None:
    assert parse_report(b"<Idle|MPos:0.000,0.000|FS:0\r\n") is None
    assert parse_report(b"<Idle|MPos:0.000,0.000|FS:0,0>\n") is None


def test_a_hold_moves_until_it_is_complete() -> None:
    assert parse_report(b"<Hold:1|MPos:0.000,0.000|FS:0,0>\r\n").moving
    assert not parse_report(b"<Hold:0|MPos:0.000,0.000|FS:0,0>\r\n").moving


# ---------------------------------------------------------------- the good case
def test_opening_moves_nothing_and_programs_the_board(stage, peer) -> None:
    assert peer.motions() == []
    assert peer.settings[20] == 1
    assert (peer.settings[110], peer.settings[120], peer.settings[130]) == (600.0, 50.0, 33.0)


def test_settings_that_are_right_already_are_not_written_again(stage, peer, clock) -> None:
    peer.sent.clear()
    GrblStage(peer, axes(), clock=clock)
    assert not any(b"=" in data for data in peer.sent)


def test_identity_is_what_the_board_says(stage) -> None:
    pan, tilt = stage.identify()
    assert (pan.name, pan.maker, pan.serial, pan.firmware) == ("pan", "GRBL", "gimbal-7", "1.1h.20190830")
    assert tilt.name == "tilt"


def test_homing_waits_for_the_board_which_is_silent_meanwhile(stage, clock) -> None:
    assert not stage.is_homed()
    assert stage.faults() == ["board: in alarm (Alarm)", "board: no reference"]
    before_s = clock.now_s
    stage.home()
    assert clock.now_s - before_s >= 2.0
    assert stage.is_homed()
    assert stage.faults() == []
    assert stage.position_deg() == {"pan": 17.0, "tilt": 17.0}


def test_axes_go_together_and_the_slower_one_sets_the_pace(homed, peer, clock) -> None:
    before_s = clock.now_s
    homed.move_to({"pan": 7.0, "tilt": 12.0})
    assert homed.position_deg() == {"pan": 7.0, "tilt": 12.0}
    (sent,) = peer.motions()
    assert sent == b"$J=G21G53X-11.0000Y-6.0000F670.8\n"
    assert 1.0 <= clock.now_s - before_s < 1.2


def test_going_where_it_stands_already_is_a_move_too(homed) -> None:
    homed.move_to({"pan": 5.0})
    homed.move_to({"pan": 5.0})
    assert homed.position_deg()["pan"] == 5.0


# ---------------------------------------------------------------- refused before anything moves
def test_another_board_is_refused_and_nothing_is_set(peer, clock) -> None:
    with pytest.raises(WrongDevice, match=r"gimbal-8, but a board named 'gimbal-7' answers"):
        GrblStage(peer, axes(), serial="gimbal-8", clock=clock)
    assert not any(b"=" in data for data in peer.sent)
    assert peer.closed


def test_a_boards_name_may_be_in_capitals_as_the_board_itself_makes_it(peer, clock) -> None:
    peer.build = "1.1h.20190830:GIMBAL-7"
    stage = GrblStage(peer, axes(), serial="gimbal-7", clock=clock)
    assert {axis.serial.lower() for axis in stage.identify()} == {"gimbal-7"}


def test_a_board_without_homing_is_refused(peer, clock) -> None:
    peer.settings[22] = 0
    with pytest.raises(DeviceRefused, match=r"\$22=0"):
        GrblStage(peer, axes(), clock=clock)


def test_a_scale_that_is_not_the_boards_is_refused(peer, clock) -> None:
    peer.settings[101] = 80.0
    with pytest.raises(OutsideLimits, match=r"100 steps a degree, the board's \$101 is 80"):
        GrblStage(peer, axes(), clock=clock)


def test_limits_beyond_the_boards_travel_are_refused(peer, clock) -> None:
    peer.settings[130] = 30.0
    with pytest.raises(OutsideLimits, match=r"but the controller allows only -12 to 18 deg\."):
        GrblStage(peer, axes(), clock=clock)


def test_a_setting_that_reads_back_otherwise_is_refused(peer, clock) -> None:
    class Deaf(dict):
        def __setitem__(self, key, value) -> None:
            """Take nothing."""

    peer.settings = Deaf(peer.settings)
    with pytest.raises(DeviceRefused, match=r"\$110: asked 600\.000, got 500\.0"):
        GrblStage(peer, axes(), clock=clock)


def test_without_reference_nothing_is_moved(stage, peer) -> None:
    peer.state = "Idle"  # somebody unlocked it with $X
    with pytest.raises(NotHomed):
        stage.move_to({"pan": 1.0})
    assert peer.motions() == []


@pytest.mark.parametrize("state", ["Run", "Hold", "Door", "Check", "Sleep"])
def test_a_board_in_another_state_is_left_alone(homed, peer, state) -> None:
    peer.state = state
    with pytest.raises(MoveFailed, match=state):
        homed.move_to({"pan": 1.0})
    assert peer.motions() == []


# ---------------------------------------------------------------- noticed in mid-move
def once_moving(peer: GrblPeer, event: Callable[[], None], after_s: float = 0.2) -> None:
    """Let an event happen that long after the first jog."""
    state = {"at_s": math.inf, "done": False}

    def before(line: str) -> None:
        if line.startswith("$J"):
            state["at_s"] = peer.clock.now_s + after_s
        if peer.clock.now_s >= state["at_s"] and not state["done"]:
            state["done"] = True
            event()

    peer.before = before


def set_state(state: str) -> Callable[[GrblPeer], None]:
    def change(peer: GrblPeer) -> None:
        peer.halt()
        peer.state = state

    return change


@pytest.mark.parametrize(
    ("event", "message"),
    [
        (GrblPeer.halt, "stopped at .* from its target -9"),
        (GrblPeer.restart, "the board restarted during the move"),
        (lambda peer: peer.alarm(1), r"limit switch hit; position lost \(ALARM:1\)"),
        (set_state("Door"), "safety door"),
        (set_state("Hold"), "held"),
        (set_state("Sleep"), "asleep"),
        (lambda peer: setattr(peer, "share", lambda: 0.5), "busy without progress"),
    ],
)
def test_a_move_that_goes_wrong_is_noticed(homed, peer, event, message) -> None:
    once_moving(peer, lambda: event(peer))
    with pytest.raises(MoveFailed, match=message):
        homed.move_to({"pan": -9.0, "tilt": -9.0})


@pytest.mark.parametrize("code", [1, 2])
def test_a_board_that_waits_for_a_reset_at_a_limit_is_named_at_once_and_homing_resets_it(
    homed, peer, code
) -> None:
    """After these alarms the firmware answers nothing, not even ``?``; the switch was never named."""
    once_moving(peer, lambda: peer.alarm(code))
    begin = time.monotonic()
    with pytest.raises(MoveFailed, match=rf"\(ALARM:{code}\)\. The board stopped all axes") as caught:
        homed.move_to({"pan": -9.0, "tilt": -9.0})
    assert time.monotonic() - begin < 2.0
    assert "limit switch" in caught.value.remedy
    assert b"\x18" not in peer.sent
    homed.stop()  # it has stopped already
    fault, reference = homed.faults()
    assert f"ALARM:{code}" in fault
    assert reference == "board: no reference"
    with pytest.raises(MoveFailed, match=f"ALARM:{code}"):
        homed.move_to({"pan": 0.0})
    homed.home()
    assert peer.sent.count(b"\x18") == 1
    assert homed.faults() == []
    homed.move_to({"pan": -9.0, "tilt": -9.0})


def test_a_reset_that_the_board_forgets_is_sent_again(homed, peer) -> None:
    peer.alarm(1)
    peer.lost_resets = 1
    assert "ALARM:1" in homed.faults()[0]
    homed.home()
    assert peer.sent.count(b"\x18") == 2
    homed.move_to({"pan": -9.0, "tilt": -9.0})


def test_a_board_that_is_mute_at_opening_is_reset(peer, clock) -> None:
    peer.mute = True
    stage = GrblStage(peer, axes(), clock=clock)
    assert peer.sent.count(b"\x18") == 1
    assert "board: no reference" in stage.faults()
    stage.home()
    stage.move_to({"pan": -9.0})


def test_a_board_that_stays_mute_is_told_with_every_cause(peer, clock, monkeypatch) -> None:
    monkeypatch.setattr(grbl_controller, "WAKE_SILENCES", 3)
    monkeypatch.setattr(peer, "write", lambda data: None)
    with pytest.raises(ReplyTimeout, match="a reset brings no welcome message") as caught:
        GrblStage(peer, axes(), clock=clock)
    assert "baud rate" in caught.value.remedy


def test_a_restart_is_noticed_even_when_its_banner_is_lost(homed, peer) -> None:
    def silently(peer: GrblPeer) -> None:
        peer.spoil, before = (lambda line: b""), peer.spoil
        peer.restart()
        peer.spoil = before

    once_moving(peer, lambda: silently(peer))
    with pytest.raises(MoveFailed, match="in alarm"):
        homed.move_to({"pan": 15.0})


def test_an_alarm_since_homing_undoes_the_reference(homed, peer) -> None:
    peer.alarm(3)
    peer.state = "Idle"
    assert not homed.is_homed()
    with pytest.raises(NotHomed):
        homed.move_to({"pan": 1.0})


def test_homing_that_does_not_find_its_switch_has_failed(stage, peer) -> None:
    peer.homes = False
    with pytest.raises(DriverError, match="error:5"):
        stage.home()
    assert not stage.is_homed()


def test_homing_that_never_ends_is_reset(stage, peer) -> None:
    peer.homing_s = 1e6
    with pytest.raises(MoveTimeout, match="homing has not ended"):
        stage.home()
    assert b"\x18" in peer.sent


def test_homing_can_be_interrupted_and_stopped(stage, peer, clock) -> None:
    clock.error = KeyboardInterrupt()
    with pytest.raises(KeyboardInterrupt):
        stage.home()
    stage.stop()
    assert b"\x18" in peer.sent
    assert not stage.is_homed()


# ---------------------------------------------------------------- stopping
def test_a_stop_cancels_the_jog_and_keeps_the_position(homed, peer) -> None:
    peer.go((-20.0, -20.0), 600.0)
    homed.stop()
    assert peer.sent[0] == b"\x85"
    assert b"\x18" not in peer.sent
    assert peer.now() == "Idle"
    assert homed.is_homed()


def test_a_stop_needs_no_reference(stage, peer) -> None:
    stage.stop()
    assert b"\x85" in peer.sent
    assert not stage.is_homed()


def test_a_board_found_moving_is_stopped_before_anything_is_asked_of_it(peer, clock) -> None:
    peer.state = "Idle"
    peer.go((-20.0, -20.0), 600.0)
    GrblStage(peer, axes(), clock=clock)
    assert peer.now() == "Idle"
    assert peer.machine()[0] > -20.0
    assert peer.sent.index(b"\x85") < peer.sent.index(b"$I\n")


def test_a_stop_does_not_wait_for_the_line_to_come_into_step(homed, peer) -> None:
    peer.spoil = lambda line: b""
    with pytest.raises(ReplyError):
        homed.position_deg()
    peer.spoil = lambda line: line
    peer.go((-20.0, -20.0), 600.0)
    peer.sent.clear()
    homed.stop()
    assert peer.sent[0] == b"\x85"


# ---------------------------------------------------------------- a line that lies
MUTATIONS = {
    "LF only": lambda line: line.replace(b"\r", b""),
    "echo": lambda line: b"?" + line,
    "no ok": lambda line: b"" if line == b"ok\r\n" else line,
    "ok twice": lambda line: line + line if line == b"ok\r\n" else line,
    "OK in capitals": lambda line: line.upper(),
    "report twice": lambda line: line + line if line.startswith(b"<") else line,
    "work positions": lambda line: line.replace(b"MPos", b"WPos"),
}


@pytest.mark.parametrize("name", MUTATIONS)
def test_a_board_with_one_thing_wrong_is_refused(peer, clock, name) -> None:
    peer.spoil = MUTATIONS[name]
    with pytest.raises(ReplyError):
        GrblStage(peer, axes(), clock=clock)
    assert peer.motions() == []


def test_a_board_that_tells_no_version_is_refused(peer, clock) -> None:
    peer.spoil = lambda line: line.replace(b"[VER:", b"[NOT:")
    with pytest.raises(ReplyGarbled, match="has no version"):
        GrblStage(peer, axes(), clock=clock)


def test_an_answer_without_end_is_refused(stage, peer) -> None:
    serve = peer.serve
    peer.serve = lambda line: [peer.say("$0=1") for _ in range(200)] if line == "$I" else serve(line)
    with pytest.raises(ReplyGarbled, match="never ends"):
        stage.identify()


def test_an_axis_the_board_does_not_have_is_refused(peer, clock) -> None:
    roll = GrblAxis(name="roll", letter="A", steps_per_deg=100.0, zero_deg=18.0, limits=LIMITS)
    with pytest.raises(DriverError):
        GrblStage(peer, [roll], clock=clock)


def test_half_a_line_from_before_us_is_never_completed_into_a_motion(peer, clock) -> None:
    peer.state = "Idle"
    peer.pending = b"$J=G21G53X-5.0F100.0"
    GrblStage(peer, axes(), clock=clock)
    assert peer.machine() == (0.0, 0.0)


def test_a_refusal_is_not_taken_for_the_ok_that_shows_the_line_in_step(peer, clock) -> None:
    last = []
    peer.before = last.append
    peer.spoil = lambda line: b"error:2\r\n" if line == b"ok\r\n" and last[-1] == "" else line
    with pytest.raises(ReplyGarbled, match="answers an empty line"):
        GrblStage(peer, axes(), clock=clock)


def test_a_lost_ok_to_a_jog_is_not_followed_by_a_second_one(homed, peer) -> None:
    last = []
    peer.before = last.append
    peer.spoil = lambda line: b"" if line == b"ok\r\n" and last[-1].startswith("$J") else line
    with pytest.raises(ReplyError):
        homed.move_to({"pan": 5.0})
    assert len(peer.motions()) == 1
    assert peer.now() == "Idle"
