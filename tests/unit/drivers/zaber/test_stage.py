"""The Zaber stage: what it sends, and what it refuses before anything moves."""

from __future__ import annotations

import pytest

from drivers.errors import DeviceRefused, MoveFailed, OutsideLimits, WrongDevice
from drivers.stage import AxisLimits
from drivers.stage.zaber import ZaberAxis, ZaberStage
from tests.unit.drivers.zaber_peer import SCALE, axes


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


def test_an_axis_that_somebody_parked_refuses_moves_and_says_so(homed, peer) -> None:
    peer.pan.parked = True
    with pytest.raises(DeviceRefused, match="the axis is parked"):
        homed.move_to({"pan": 1.0})


# ---------------------------------------------------------------- refused before anything moves
def test_another_serial_number_is_refused_and_nothing_is_set(peer, clock) -> None:
    peer.tilt.settings["system.serial"] = "999999"
    with pytest.raises(WrongDevice, match="100102 for tilt, but device 2 has 999999"):
        ZaberStage(peer, axes(), clock=clock)
    assert not any(b" set " in line for line in peer.sent)
    assert peer.closed


def test_a_target_outside_the_limits_sends_nothing_at_all(homed, peer) -> None:
    with pytest.raises(OutsideLimits):
        homed.move_to({"pan": 1.0, "tilt": 15.5})
    assert peer.sent == []


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
    with pytest.raises(MoveFailed, match="already moving"):
        homed.move_to({"pan": 1.0})
    assert peer.motions() == []


def test_what_is_only_history_is_cleared_before_a_move(homed, peer) -> None:
    peer.pan.flags = ["NI"]
    homed.move_to({"pan": 1.0})
    assert peer.pan.flags == []


def test_limits_beyond_the_controllers_travel_are_refused(peer, clock) -> None:
    peer.pan.settings["limit.max"] = "9000"
    with pytest.raises(
        OutsideLimits,
        match=r"allows -15 to 15 deg, but the controller allows only -15 to 9 deg \(-15000 to 9000 microsteps\)",
    ):
        ZaberStage(peer, axes(), clock=clock)


def test_a_scale_that_is_not_the_controllers_is_refused(peer, clock) -> None:
    peer.tilt.settings["limit.cycle.dist"] = str(360 * SCALE * 2)
    with pytest.raises(OutsideLimits, match="360000 microsteps a turn, the controller has 720000"):
        ZaberStage(peer, axes(), clock=clock)


def test_a_setting_that_reads_back_otherwise_is_refused(peer, clock) -> None:
    answer = peer.pan.answer
    peer.pan.answer = lambda words: "777" if words == ["get", "maxspeed"] else answer(words)
    with pytest.raises(DeviceRefused, match="maxspeed was set to 16384, but reads 777"):
        ZaberStage(peer, axes(), clock=clock)
