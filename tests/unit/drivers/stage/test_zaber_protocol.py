"""Zaber's ASCII protocol, byte by byte; the strings are those the maker's own client exchanges."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import ReplyGarbled
from drivers.stage.zaber_protocol import (
    FLAGS,
    describe_flag,
    is_fault,
    is_unsolicited,
    parse_flags,
    parse_reply,
    request,
)

GOOD = b"@01 1 05 OK BUSY -- 0:D2\r\n"


def sealed(body: str) -> bytes:
    """Close a reply's body with its checksum, computed here by hand: the sum must come to zero."""
    total = sum(body.encode()) % 256
    return f"@{body}:{(256 - total) % 256:02X}\r\n".encode()


@pytest.mark.parametrize(
    ("device", "axis", "message_id", "words", "sent"),
    [
        (0, 0, 0, "", b"/0 0 00:00\n"),
        (1, 0, 1, "get comm.packet.size.max", b"/1 0 01 get comm.packet.size.max:CF\n"),
        (1, 1, 3, "home", b"/1 1 03 home:32\n"),
        (1, 1, 5, "move abs 50000", b"/1 1 05 move abs 50000:B7\n"),
        (0, 0, 11, "stop", b"/0 0 11 stop:18\n"),
    ],
)
def test_requests_are_the_makers_clients(device, axis, message_id, words, sent) -> None:
    assert request(device, axis, message_id, words) == sent


@given(
    st.integers(1, 99),
    st.integers(0, 9),
    st.integers(0, 99),
    st.booleans(),
    st.booleans(),
    st.integers(-(10**9), 10**9),
)
def test_every_well_formed_reply_is_understood(device, axis, message_id, accepted, busy, value) -> None:
    verdict, state = "OK" if accepted else "RJ", "BUSY" if busy else "IDLE"
    reply = parse_reply(sealed(f"{device:02d} {axis} {message_id:02d} {verdict} {state} -- {value}"))
    assert (reply.device, reply.axis, reply.message_id) == (device, axis, message_id)
    assert (reply.accepted, reply.busy, int(reply.data)) == (accepted, busy, value)


@given(st.integers(0, len(GOOD) - 1), st.integers(0, 255))
def test_no_reply_with_one_byte_changed_is_taken(place, value) -> None:
    line = bytearray(sealed("01 1 05 OK BUSY -- 31000"))
    if line[place] != value:
        line[place] = value
        with pytest.raises(ReplyGarbled):
            parse_reply(bytes(line))


@pytest.mark.parametrize(
    "line",
    [
        GOOD.replace(b"\r\n", b"\r"),
        GOOD.replace(b"\r\n", b"\n"),
        b"/1 1 05 get pos:28\n" + GOOD,
        GOOD.replace(b":D2", b""),
        *map(sealed, ("01 1 OK BUSY -- 0", "1 1 05 OK BUSY -- 0", "01 1 05 ok BUSY -- 0")),
        *map(sealed, ("01 1 05 OK Busy -- 0", "01 1 05 OK BUSY 0")),
    ],
)
def test_a_reply_of_another_form_is_not_taken(line) -> None:
    with pytest.raises(ReplyGarbled):
        parse_reply(line)


@given(st.binary(max_size=60))
def test_noise_is_refused_and_nothing_else_happens(noise) -> None:
    with pytest.raises(ReplyGarbled):
        parse_reply(noise)
    assert not is_unsolicited(noise)


def test_alerts_and_information_lines_are_told_from_replies() -> None:
    assert is_unsolicited(b"!" + sealed("01 1 IDLE FS")[1:])
    assert not is_unsolicited(GOOD)
    with pytest.raises(ReplyGarbled):
        is_unsolicited(b"!01 1 IDLE FS:00\r\n")


def test_flags_that_are_not_as_many_as_told_are_refused() -> None:
    assert parse_flags("00") == ()
    assert parse_flags("02 WR NI") == ("WR", "NI")
    for wrong in ("01", "00 WR", "2 WR NI", "01 wr", "01  WR", "", "WR"):
        with pytest.raises(ReplyGarbled):
            parse_flags(wrong)


def test_faults_are_those_an_axis_must_not_be_moved_with() -> None:
    assert all(is_fault(flag) for flag in FLAGS if flag.startswith("F"))
    assert is_fault("FX")
    assert is_fault("WM")
    assert not any(map(is_fault, ["--", "NI", "WR", "WT"]))
    assert describe_flag("ZZ") == "unknown warning (ZZ)"
