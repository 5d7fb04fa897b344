"""XIMC stages: a stop of several controllers, and a homing that is broken off."""

from __future__ import annotations

import time

import pytest

from drivers.errors import NotHomed, ReplyError
from drivers.stage import AxisLimits, ximc
from drivers.stage.ximc import XimcAxis, XimcStage
from tests.unit.drivers.ximc_peer import XimcPeer

LIMITS = AxisLimits(-15.0, 15.0, 10.0, 50.0)


def test_a_silent_controller_does_not_keep_the_others_moving(clock, monkeypatch) -> None:
    monkeypatch.setattr(ximc, "REPLY_S", 0.2)
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
