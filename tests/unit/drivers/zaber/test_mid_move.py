"""The Zaber stage: no fault of a move passes for an arrival."""

from __future__ import annotations

import pytest

from drivers.errors import MoveFailed, MoveTimeout
from drivers.stage.zaber import ZaberStage
from tests.unit.drivers.zaber.mid_move import halt, once_moving
from tests.unit.drivers.zaber_peer import axes


def test_a_move_that_stops_short_is_noticed(homed, peer, clock) -> None:
    once_moving(peer, clock, lambda: halt(peer.pan))
    with pytest.raises(MoveFailed, match=r"pan: stopped at 2.*from its target 9\.0000 deg"):
        homed.move_to({"pan": 9.0, "tilt": 9.0})
    assert not peer.tilt.busy()


def test_a_restart_in_mid_move_is_noticed(homed, peer, clock) -> None:
    once_moving(peer, clock, peer.tilt.restart)
    with pytest.raises(MoveFailed, match="tilt: the controller lost its reference during the move"):
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
        MoveFailed, match=r"pan: slipped: the counter reads 6\.0000 deg, the encoder 5\.9200 deg"
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
    with pytest.raises(
        MoveFailed, match=r"pan: the axis did not stay at its target: it is \+0\.0500 deg away"
    ):
        homed.move_to({"pan": 9.0})
    assert not homed.is_homed()


def test_homing_that_leaves_no_reference_has_failed(stage, peer, clock) -> None:
    answer = peer.tilt.answer
    peer.tilt.answer = lambda words: "0" if words == ["home"] else answer(words)
    with pytest.raises(MoveFailed, match="tilt: homing ended without a reference"):
        stage.home()
    assert not stage.is_homed()
