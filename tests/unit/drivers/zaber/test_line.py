"""The Zaber stage on a line that loses, delays, spoils or invents replies."""

from __future__ import annotations

import pytest

from drivers.errors import MoveFailed, MoveTimeout, PortLost, ReplyError
from drivers.stage.zaber import ZaberStage
from tests.unit.drivers.zaber.mid_move import once_moving
from tests.unit.drivers.zaber_peer import axes, close_line


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
