"""The Zaber stage: what it sends, and that no fault of a move passes for an arrival.

A small model of two chained controllers answers in memory, on a clock that only the driver's own waits turn;
each test breaks one thing about it.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable

import pytest

from drivers.errors import (
    DeviceRefused,
    MoveFailed,
    MoveTimeout,
    NotHomed,
    OutsideLimits,
    PortLost,
    ReplyError,
    WrongDevice,
)
from drivers.stage import AxisLimits
from drivers.stage.zaber import ZaberAxis, ZaberStage
from tests.unit.drivers.zaber_peer import SCALE, Controller, ZaberPeer, axes, close_line


@pytest.fixture
def peer(clock) -> ZaberPeer:
    return ZaberPeer(clock)


@pytest.fixture
def stage(peer, clock) -> ZaberStage:
    return ZaberStage(peer, axes(), clock=clock)


@pytest.fixture
def homed(stage, peer) -> ZaberStage:
    stage.home()
    peer.sent.clear()
    return stage


# ---------------------------------------------------------------- the good case
def test_opening_moves_nothing(stage, peer) -> None:
    assert peer.motions() == []
    assert stage.axes == ("pan", "tilt")
    assert not stage.is_homed()


def test_opening_programs_limits_speed_and_acceleration(stage, peer) -> None:
    assert peer.pan.settings["limit.min"] == "-15000"
    assert peer.pan.settings["maxspeed"] == "16384"
    assert peer.pan.settings["accel"] == "8"


def test_an_axis_found_moving_is_stopped_at_opening(peer, clock) -> None:
    peer.tilt.go(9000.0)
    ZaberStage(peer, axes(), clock=clock)
    assert not peer.tilt.busy()
    assert peer.tilt.position() < 9000
    assert peer.motions() == []


def test_settings_that_are_right_already_are_not_written_again(stage, peer, clock) -> None:
    peer.sent.clear()
    ZaberStage(peer, axes(), clock=clock)
    assert not any(b" set " in line for line in peer.sent)


def test_identity_is_what_the_controllers_say(stage) -> None:
    pan, tilt = stage.identify()
    assert (pan.name, pan.maker, pan.model, pan.serial, pan.firmware) == (
        "pan",
        "Zaber",
        "device id 50958",
        "100101",
        "7.38",
    )
    assert tilt.serial == "100102"


def test_a_move_arrives_where_it_was_sent(homed, peer, clock) -> None:
    before_s = clock.now_s
    homed.move_to({"pan": 5.0, "tilt": -3.25})
    assert homed.position_deg() == {"pan": 5.0, "tilt": -3.25}
    assert [line.rsplit(b" ", 1)[1].split(b":")[0] for line in peer.motions()] == [b"5000", b"-3250"]
    assert 0.5 <= clock.now_s - before_s < 0.7


def test_an_angle_is_rounded_to_the_nearest_count(homed) -> None:
    homed.move_to({"pan": 1.23456})
    assert homed.position_deg()["pan"] == 1.235


def test_counter_zero_and_direction_are_the_station_files(peer, clock) -> None:
    limits = AxisLimits(-5.0, 5.0, 10.0, 50.0)
    pan = ZaberAxis(
        name="pan", device=1, serial="100101", microsteps_per_deg=-SCALE, zero_deg=2.0, limits=limits
    )
    stage = ZaberStage(peer, [pan], clock=clock)
    assert (peer.pan.settings["limit.min"], peer.pan.settings["limit.max"]) == ("-3000", "7000")
    stage.home()
    assert stage.position_deg() == {"pan": 2.0}
    stage.move_to({"pan": 3.0})
    assert peer.pan.position() == -1000


def test_faults_are_told_in_plain_words(stage, peer) -> None:
    peer.tilt.flags = ["WT"]
    assert stage.faults() == ["pan: no reference position (WR)", "tilt: controller too hot (WT)"]


def test_what_is_only_history_is_no_fault(homed, peer) -> None:
    peer.pan.go(9000.0)
    homed.stop()
    assert peer.pan.flags == ["NI"]
    assert homed.faults() == []


def test_a_move_to_nowhere_sends_nothing(homed, peer) -> None:
    homed.move_to({})
    assert peer.sent == []


def test_parking_is_told_to_each_axis_and_refuses_moves(homed, peer) -> None:
    homed.park()
    assert [line for line in peer.sent if b" park:" in line] == peer.sent
    assert len(peer.sent) == 2
    with pytest.raises(DeviceRefused, match="the axis is parked"):
        homed.move_to({"pan": 1.0})
    homed.unpark()
    homed.move_to({"pan": 1.0})


def test_closing_gives_the_port_back(stage, peer) -> None:
    stage.close()
    assert peer.closed


# ---------------------------------------------------------------- refused before anything moves
def test_another_serial_number_is_refused_and_nothing_is_set(peer, clock) -> None:
    peer.tilt.settings["system.serial"] = "999999"
    with pytest.raises(WrongDevice, match="100102 for tilt, but device 2 says 999999"):
        ZaberStage(peer, axes(), clock=clock)
    assert not any(b" set " in line for line in peer.sent)
    assert peer.closed


def test_a_target_outside_the_limits_sends_nothing_at_all(homed, peer) -> None:
    with pytest.raises(OutsideLimits):
        homed.move_to({"pan": 1.0, "tilt": 15.5})
    assert peer.sent == []


def test_without_reference_nothing_is_moved(stage, peer) -> None:
    with pytest.raises(NotHomed, match="pan: the axis has no reference"):
        stage.move_to({"pan": 1.0})
    assert peer.motions() == []


@pytest.mark.parametrize("flag", ["FS", "FH", "FE", "WM", "FX"])
def test_an_axis_with_a_fault_is_not_moved_until_it_is_homed_again(homed, peer, flag) -> None:
    peer.tilt.flags = [flag]
    with pytest.raises(MoveFailed, match=f"tilt: .*{flag}.* Nothing was moved"):
        homed.move_to({"pan": 1.0, "tilt": 1.0})
    assert peer.motions() == []
    homed.home()
    homed.move_to({"pan": 1.0, "tilt": 1.0})


def test_an_axis_that_somebody_else_moves_is_left_alone(homed, peer) -> None:
    peer.pan.go(9000.0)
    with pytest.raises(MoveFailed, match="moving already"):
        homed.move_to({"pan": 1.0})
    assert peer.motions() == []


def test_what_is_only_history_is_cleared_before_a_move(homed, peer) -> None:
    peer.pan.flags = ["NI"]
    homed.move_to({"pan": 1.0})
    assert peer.pan.flags == []


def test_limits_beyond_the_controllers_travel_are_refused(peer, clock) -> None:
    peer.pan.settings["limit.max"] = "9000"
    with pytest.raises(
        OutsideLimits, match=r"-15000 to 15000 microsteps, reach beyond the controller's, -15000 to 9000"
    ):
        ZaberStage(peer, axes(), clock=clock)


def test_a_scale_that_is_not_the_controllers_is_refused(peer, clock) -> None:
    peer.tilt.settings["limit.cycle.dist"] = str(360 * SCALE * 2)
    with pytest.raises(OutsideLimits, match="360000 microsteps a turn, the controller says 720000"):
        ZaberStage(peer, axes(), clock=clock)


def test_a_setting_that_reads_back_otherwise_is_refused(peer, clock) -> None:
    answer = peer.pan.answer
    peer.pan.answer = lambda words: "777" if words == ["get", "maxspeed"] else answer(words)
    with pytest.raises(DeviceRefused, match="maxspeed was set to 16384, but reads 777"):
        ZaberStage(peer, axes(), clock=clock)


# ---------------------------------------------------------------- noticed in mid-move
def once_moving(peer: ZaberPeer, clock, event: Callable[[], None], after_s: float = 0.2) -> None:
    """Let an event happen that long after the first move command."""
    state = {"at_s": math.inf, "done": False}

    def before(request: str) -> None:
        if " move " in request:
            state["at_s"] = clock.now_s + after_s
        if clock.now_s >= state["at_s"] and not state["done"]:
            state["done"] = True
            event()

    peer.before = before


def halt(controller: Controller) -> None:
    controller.start = controller.goal = float(controller.position())


def test_a_move_that_stops_short_is_noticed(homed, peer, clock) -> None:
    once_moving(peer, clock, lambda: halt(peer.pan))
    with pytest.raises(MoveFailed, match=r"pan: stopped at 2.*from its target 9\.0000 deg"):
        homed.move_to({"pan": 9.0, "tilt": 9.0})
    assert not peer.tilt.busy()


def test_a_restart_in_mid_move_is_noticed(homed, peer, clock) -> None:
    once_moving(peer, clock, peer.tilt.restart)
    with pytest.raises(MoveFailed, match="tilt: the controller lost its reference in mid-move"):
        homed.move_to({"pan": 9.0, "tilt": 9.0})
    assert not peer.pan.busy()


def test_a_restart_is_noticed_even_when_the_target_is_the_restarts_position(homed, peer, clock) -> None:
    homed.move_to({"tilt": 9.0})
    once_moving(peer, clock, peer.tilt.restart)
    with pytest.raises(MoveFailed, match="lost its reference"):
        homed.move_to({"tilt": 0.0})


@pytest.mark.parametrize("flag", ["FS", "FE", "FH", "WL", "NI", "NC"])
def test_a_flag_in_mid_move_ends_it(homed, peer, clock, flag) -> None:
    once_moving(peer, clock, lambda: peer.pan.flags.append(flag))
    with pytest.raises(MoveFailed, match=flag):
        homed.move_to({"pan": 9.0})
    assert not peer.pan.busy()


def test_a_flag_hidden_behind_a_more_urgent_one_is_found_at_the_end(homed, peer, clock) -> None:
    once_moving(peer, clock, lambda: peer.pan.flags.extend(["WT", "NI"]))
    with pytest.raises(MoveFailed, match="NI"):
        homed.move_to({"pan": 9.0})


def test_a_controller_that_stays_busy_is_stopped(homed, peer, clock) -> None:
    peer.pan.busy = lambda: True
    with pytest.raises(MoveFailed, match="already") as caught:
        homed.move_to({"pan": 9.0})
    del peer.pan.busy
    once_moving(peer, clock, lambda: setattr(peer.pan, "busy", lambda: True))
    before_s = clock.now_s
    with pytest.raises(MoveFailed, match="busy without progress") as caught:
        homed.move_to({"pan": 9.0})
    assert clock.now_s - before_s < 4.0
    assert "The stop that followed failed too" in str(caught.value)
    assert "Cut the stage's power" in str(caught.value)


def test_a_controller_that_is_never_busy_is_refused(homed, peer) -> None:
    peer.pan.busy = lambda: False
    with pytest.raises(MoveFailed, match="stopped at"):
        homed.move_to({"pan": 9.0})


def test_a_move_slower_than_its_speed_allows_meets_its_deadline(homed, peer) -> None:
    halt(peer.pan)
    peer.pan.speed = 500.0
    with pytest.raises(MoveTimeout, match="still moving after"):
        homed.move_to({"pan": 9.0})
    assert not peer.pan.busy()


def test_a_slip_between_counter_and_encoder_is_noticed(peer, clock) -> None:
    peer.pan.encoder = 0
    stage = ZaberStage(peer, axes(), clock=clock)
    stage.home()
    stage.move_to({"pan": 5.0})
    assert stage.encoder_deg() == {"pan": 5.0}
    peer.pan.encoder = -80
    with pytest.raises(
        MoveFailed, match=r"pan: slipped: the counter says 6\.0000 deg, the encoder 5\.9200 deg"
    ):
        stage.move_to({"pan": 6.0})


def test_an_axis_that_does_not_stay_where_it_arrived_is_noticed(homed, peer) -> None:
    idle_looks = []

    def before(request: str) -> None:
        if request.endswith("get pos") and peer.pan.goal == 9000.0 and not peer.pan.busy():
            idle_looks.append(request)
            if len(idle_looks) == 3:
                peer.pan.start = peer.pan.goal = 9050.0

    peer.before = before
    with pytest.raises(MoveFailed, match=r"pan: did not stay where it had arrived: \+0\.0500 deg"):
        homed.move_to({"pan": 9.0})
    assert not homed.is_homed()


def test_homing_that_leaves_no_reference_has_failed(stage, peer, clock) -> None:
    answer = peer.tilt.answer
    peer.tilt.answer = lambda words: "0" if words == ["home"] else answer(words)
    with pytest.raises(MoveFailed, match="tilt: homing ended without a reference"):
        stage.home()
    assert not stage.is_homed()


# ---------------------------------------------------------------- stopping
def test_a_stop_reaches_all_axes_with_one_line(homed, peer) -> None:
    peer.pan.go(9000.0)
    peer.tilt.go(9000.0)
    homed.stop()
    assert peer.sent[0].startswith(b"/0 0 ")
    assert b" stop:" in peer.sent[0]
    assert not peer.pan.busy()
    assert not peer.tilt.busy()


def test_a_stop_ends_the_move_that_another_thread_waits_for(homed, peer, clock) -> None:
    once_moving(peer, clock, homed.stop)
    with pytest.raises(MoveFailed, match=r"NI|stopped on request"):
        homed.move_to({"pan": 9.0, "tilt": 9.0})
    assert not peer.pan.busy()


def test_a_stop_between_two_axes_keeps_the_second_from_starting(homed, peer) -> None:
    seen = []

    def before(request: str) -> None:
        if " move " in request and not seen:
            seen.append(request)
            homed._stops += 1

    peer.before = before
    with pytest.raises(MoveFailed, match="stopped on request"):
        homed.move_to({"pan": 9.0, "tilt": 9.0})
    assert len(peer.motions()) == 1
    assert not peer.pan.busy()


def test_a_stop_that_comes_while_a_move_is_sent_goes_out_after_it(homed, peer) -> None:
    command = homed._chain.command
    stopper = threading.Thread(target=homed.stop)

    def stop_meanwhile(device: int, axis: int, words: str):
        if words.startswith("move"):
            stopper.start()
            stopper.join(0.2)
        return command(device, axis, words)

    homed._chain.command = stop_meanwhile
    with pytest.raises(MoveFailed, match="stopped on request"):
        homed.move_to({"pan": 9.0})
    stopper.join()
    kinds = [word for line in peer.sent for word in ("move", "stop") if f" {word}".encode() in line]
    assert kinds[0] == "move"
    assert "stop" in kinds
    assert not peer.pan.busy()


def test_a_stop_does_not_wait_for_the_line_to_come_into_step(homed, peer) -> None:
    peer.spoil = lambda line: b""
    with pytest.raises(ReplyError):
        homed.position_deg()
    peer.spoil = lambda line: line
    peer.pan.go(9000.0)
    peer.sent.clear()
    homed.stop()
    assert b" stop:" in peer.sent[0]


def test_a_stop_that_one_device_did_not_hear_is_sent_again(homed, peer) -> None:
    lost = []

    def lose_one(line: bytes) -> bytes:
        if line.startswith(b"@02 0") and not lost:
            lost.append(line)
            return b""
        return line

    peer.spoil = lose_one
    homed.stop()
    assert sum(b" stop:" in line for line in peer.sent) == 2


def test_an_interrupting_clock_ends_a_move_and_leaves_the_stop_to_its_owner(homed, peer, clock) -> None:
    class Interrupted(Exception):
        pass

    def interrupted(seconds: float) -> None:
        raise Interrupted

    clock.sleep = interrupted
    with pytest.raises(Interrupted):
        homed.move_to({"pan": 9.0})
    assert not any(b" stop:" in line for line in peer.sent)
    homed.stop()
    assert not peer.pan.busy()


# ---------------------------------------------------------------- a line that lies
def test_a_lost_reply_to_a_query_is_asked_for_again(homed, peer) -> None:
    lost = []

    def lose_one(line: bytes) -> bytes:
        if not lost:
            lost.append(line)
            return b""
        return line

    peer.spoil = lose_one
    assert homed.position_deg() == {"pan": 0.0, "tilt": 0.0}


def test_a_lost_reply_to_a_move_is_not_followed_by_a_second_move(homed, peer) -> None:
    last = []
    peer.before = last.append
    peer.spoil = lambda line: b"" if " move " in last[-1] else line
    with pytest.raises(ReplyError):
        homed.move_to({"pan": 9.0})
    assert len(peer.motions()) == 1
    assert not peer.pan.busy()


def test_a_late_reply_is_never_taken_for_a_position(homed, peer) -> None:
    homed.move_to({"pan": 7.0, "tilt": 2.0})
    held = []

    def hold_one(line: bytes) -> bytes:
        if not held:
            held.append(line)
            return b""
        return line

    peer.spoil = hold_one
    before = peer.before

    def release(request: str) -> None:
        before(request)
        if held and held[0]:
            peer.ready += held[0]
            held[0] = b""

    peer.before = release
    assert homed.position_deg() == {"pan": 7.0, "tilt": 2.0}


def test_an_alert_between_request_and_reply_is_kept_apart(homed, peer) -> None:
    alert = b"!" + close_line("01 1 IDLE FS")[1:]
    peer.spoil = lambda line: alert + line
    assert homed.position_deg() == {"pan": 0.0, "tilt": 0.0}
    assert homed._chain.unsolicited[-1].text == "IDLE FS"


def test_a_port_lost_in_mid_move_is_told_as_such(homed, peer, clock) -> None:
    def gone() -> None:
        raise PortLost("the port is gone.", where="gimbal")

    once_moving(peer, clock, gone)
    with pytest.raises(PortLost):
        homed.move_to({"pan": 9.0})


@pytest.mark.parametrize(
    ("words", "data"), [(["get", "pos"], "12.5"), (["get", "pos"], "1_0"), (["warnings"], "02 WR")]
)
def test_well_formed_nonsense_is_refused(homed, peer, words, data) -> None:
    answer = peer.pan.answer
    peer.pan.answer = lambda asked: data if asked == words else answer(asked)
    with pytest.raises(ReplyError):
        homed.move_to({"pan": 1.0})
    assert peer.motions() == []


def test_a_stop_among_the_ruins_of_a_reply_is_heard(homed, peer) -> None:
    peer.spoil = lambda line: b"@01 1 4" + line if line.startswith(b"@01 0") else line
    peer.pan.go(9000.0)
    with pytest.raises(ReplyError):
        homed.stop()
    assert not peer.pan.busy()
    assert sum(b" stop:" in line for line in peer.sent) == 3


MUTATIONS = {
    "wrong checksum": lambda line: line.replace(line[-4:-2], b"%02X" % (int(line[-4:-2], 16) ^ 1)),
    "missing checksum": lambda line: line[:-5] + b"\r\n",
    "CR only": lambda line: line[:-1],
    "LF only": lambda line: line[:-2] + b"\n",
    "no id": lambda line: close_line((line[1:6] + line[9:-5]).decode()),
    "wrong id": lambda line: close_line(
        f"{line[1:6].decode()}{(int(line[6:8]) + 1) % 100:02d}{line[8:-5].decode()}"
    ),
    "wrong device": lambda line: close_line(f"{int(line[1:3]) + 1:02d}{line[3:-5].decode()}"),
    "wrong axis": lambda line: close_line(f"{line[1:4].decode()}{int(line[4:5]) + 1}{line[5:-5].decode()}"),
    "lower-case ok": lambda line: close_line(line[1:-5].decode().replace("OK", "ok")),
    "no flag field": lambda line: close_line((line[1:17] + line[20:-5]).decode()),
    "state word Idle": lambda line: close_line(line[1:-5].decode().replace("IDLE", "Idle")),
    "one-digit address": lambda line: close_line(line[2:-5].decode()),
    "always idle": lambda line: close_line(line[1:-5].decode().replace("BUSY", "IDLE")),
    "never idle": lambda line: close_line(line[1:-5].decode().replace("IDLE", "BUSY")),
    "echo": lambda line: b"/1 1 00 get pos:2C\n" + line,
}


@pytest.mark.parametrize("name", MUTATIONS)
def test_a_controller_with_one_thing_wrong_is_refused_at_opening_or_moving(peer, clock, name) -> None:
    peer.spoil = MUTATIONS[name]

    def open_home_and_move() -> None:
        stage = ZaberStage(peer, axes(), clock=clock)
        stage.home()
        stage.move_to({"pan": 9.0})

    with pytest.raises((ReplyError, MoveFailed, MoveTimeout)):
        open_home_and_move()
    if name not in {"always idle", "never idle"}:
        assert peer.motions() == []
