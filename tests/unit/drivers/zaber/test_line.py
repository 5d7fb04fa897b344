"""The Zaber stage on a line that loses, delays, spoils or invents replies."""

from __future__ import annotations

import pytest

from drivers.errors import PortLost, ReplyError
from tests.unit.drivers.zaber.mid_move import once_moving
from tests.unit.drivers.zaber_peer import close_line


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
