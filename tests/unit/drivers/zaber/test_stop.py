"""The Zaber stage: a stop reaches all axes, whatever else goes on."""

from __future__ import annotations

import threading

import pytest

from drivers.errors import MoveFailed, ReplyError
from tests.unit.drivers.zaber.mid_move import once_moving


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


def test_a_stop_while_a_move_is_sent_goes_out_after_it_and_keeps_the_second_axis_from_starting(
    homed, peer
) -> None:
    stopper = threading.Thread(target=homed.stop)

    def stop_meanwhile(request: str) -> None:
        if " move " in request:
            stopper.start()
            stopper.join(0.2)

    peer.before = stop_meanwhile
    with pytest.raises(MoveFailed, match="stopped on request"):
        homed.move_to({"pan": 9.0, "tilt": 9.0})
    stopper.join()
    assert len(peer.motions()) == 1
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
    clock.error = KeyboardInterrupt()
    with pytest.raises(KeyboardInterrupt):
        homed.move_to({"pan": 9.0})
    assert not any(b" stop:" in line for line in peer.sent)
    homed.stop()
    assert not peer.pan.busy()
