"""Stages of two axes: what befalls the second one is neither lost nor covered by the first one."""

from __future__ import annotations

import time

import pytest

from drivers.errors import MoveFailed, NotHomed, ReplyError
from drivers.stage import AxisLimits, ximc
from drivers.stage.esp import EspAxis, EspStage
from drivers.stage.ximc import XimcAxis, XimcStage
from tests.unit.drivers.esp_peer import EspPeer
from tests.unit.drivers.ximc_peer import XimcPeer

LIMITS = AxisLimits(-15.0, 15.0, 10.0, 50.0)


@pytest.fixture
def esp(clock) -> EspPeer:
    return EspPeer(clock)


@pytest.fixture
def esp_stage(esp, clock) -> EspStage:
    axes = [
        EspAxis(name=name, number=number, serial="", limits=LIMITS)
        for name, number in (("pan", 1), ("tilt", 2))
    ]
    return EspStage(esp, axes, clock=clock)


def test_an_error_of_the_second_axis_is_not_lost_by_asking_about_the_first(esp_stage, esp) -> None:
    esp_stage.home()

    def late_error(command: str) -> None:
        if command == "1MO?" and esp.axes[2].goal == 5.0 and not esp.axes[2].busy():
            esp.errors.append((203, "FOLLOWING ERROR THRESHOLD EXCEEDED"))
            esp.before = lambda command: None

    esp.before = late_error
    with pytest.raises(MoveFailed, match="following error beyond its threshold"):
        esp_stage.move_to({"pan": 5.0, "tilt": 5.0})
    assert not esp_stage.is_homed()


def test_an_error_of_an_axis_that_is_not_ours_is_none_of_ours(esp_stage, esp) -> None:
    esp_stage.home()

    def always_one(command: str) -> None:
        esp.errors = esp.errors or [(308, "STAGE NOT CONNECTED")] * (command == "2TP")

    esp.before = always_one
    esp_stage.move_to({"pan": 5.0, "tilt": 5.0})
    assert esp_stage.position_deg() == {"pan": 5.0, "tilt": 5.0}


def test_the_first_axis_alone_is_no_reference(esp_stage, esp) -> None:
    """The line fails while the second axis's homing is looked at: nobody knows how that one ended."""
    looks = 0

    def dies_at_the_last_look(line: bytes) -> bytes:
        nonlocal looks
        at_rest = not any(axis.busy() for axis in esp.axes.values())
        looks += at_rest and esp.sent[-1] == "2MD?"
        return b"" if looks > 2 else line

    esp.spoil = dies_at_the_last_look
    with pytest.raises(ReplyError):
        esp_stage.home()
    esp.spoil = lambda line: line
    assert not esp_stage.is_homed()
    with pytest.raises(NotHomed):
        esp_stage.move_to({"pan": 1.0})


def test_a_silent_controller_does_not_keep_the_others_moving(clock, monkeypatch) -> None:
    monkeypatch.setattr(ximc, "_REPLY_S", 0.2)
    peers = [XimcPeer(clock, 1, "a"), XimcPeer(clock, 2, "b")]
    axes = [
        XimcAxis(name=name, port="", serial="", steps_per_deg=80.0, limits=LIMITS) for name in ("pan", "tilt")
    ]
    stage = XimcStage(peers, axes, clock=clock)
    peers[0].spoil = lambda reply: b""
    read, heard_s = peers[0].read, []

    def slowly(timeout_s: float) -> bytes:
        time.sleep(timeout_s)
        return read(timeout_s)

    peers[0].read = slowly
    peers[1].before = lambda command: heard_s.append(time.monotonic()) if command == "sstp" else None
    peers[1].go(9e6, 1)
    began_s = time.monotonic()
    with pytest.raises(ReplyError):
        stage.stop()
    first_s, all_s = heard_s[0] - began_s, time.monotonic() - began_s
    assert all_s > 0.6  # three waits for the silent one
    assert first_s < 0.5 * all_s
    assert not peers[1].busy()


def test_a_homing_that_is_broken_off_leaves_no_reference(clock) -> None:
    """The controller says that it is homed before its counter has been set to zero there."""

    class Interrupted(Exception):
        pass

    peer = XimcPeer(clock, 1, "a")
    axis = XimcAxis(name="pan", port="", serial="", steps_per_deg=80.0, limits=LIMITS)
    stage = XimcStage([peer], [axis], clock=clock)

    def interrupt(command: str) -> None:
        if command == "home":
            clock.error = Interrupted()

    peer.before = interrupt
    with pytest.raises(Interrupted):
        stage.home()
    clock.error = None
    stage.stop()
    assert stage.faults() == []  # the controller sees nothing wrong
    assert not stage.is_homed()
    with pytest.raises(NotHomed, match="homing did not end"):
        stage.move_to({"pan": 1.0})
    peer.before = lambda command: None
    stage.home()
    stage.move_to({"pan": 1.0})


def test_a_position_beyond_all_numbers_is_no_position(esp_stage, esp) -> None:
    esp.spoil = lambda line: b"9.0e999\r\n" if esp.sent[-1] == "1TP" else line
    with pytest.raises(ReplyError, match="not a number with decimals"):
        esp_stage.position_deg()


def test_every_axis_of_ours_is_stopped_by_its_number_as_well(esp_stage, esp) -> None:
    """Should a controller take ``ST`` without a number for a mistake, it moves on for no longer than a line lasts."""
    esp_stage.home()
    serve = esp.serve
    esp.serve = lambda text: None if text == "ST" else serve(text)
    for axis in esp.axes.values():
        axis.go(9e6)
    esp.sent.clear()
    esp_stage.stop()
    assert not any(axis.busy() for axis in esp.axes.values())
    assert esp.sent[:3] == ["ST", "1ST", "2ST"]
