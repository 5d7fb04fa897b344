"""Faults of a line: each affects as many messages as ordered, and no others."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulators.errors import SimulatorError
from simulators.faults.line_faults import REPLY_FAULTS, FaultLine, LineFault


class Parrot:
    """A device that answers every request in capitals, and sends the unsolicited bytes in ``spoken`` once."""

    baud = 9600

    def __init__(self) -> None:
        self.heard = b""
        self.spoken = b""

    def receive(self, data: bytes) -> bytes:
        self.heard += data
        return data.upper()

    def unsolicited(self) -> bytes:
        spoken, self.spoken = self.spoken, b""
        return spoken


class Line:
    """A parrot at the end of a faulty line, on a clock that the test advances."""

    def __init__(self, *faults: LineFault, seed: int = 1) -> None:
        self.now_s = 0.0
        self.parrot = Parrot()
        self.line = FaultLine(self.parrot, lambda: self.now_s, np.random.default_rng(seed))
        for fault in faults:
            self.line.inject(fault)

    def ask(self, data: bytes) -> bytes:
        return self.line.receive(data) + self.line.unsolicited()


@pytest.mark.parametrize(
    ("fault", "answer"),
    [
        (LineFault("lost"), b""),
        (LineFault("doubled"), b"ABC\nABC\n"),
        (LineFault("replaced", pattern=rb"\n", replacement=rb"\r\n"), b"ABC\r\n"),
        (LineFault("preceded", replacement=b"!x\n"), b"!x\nABC\n"),
        (LineFault("echo"), b"abc\nABC\n"),
        (LineFault("request_lost"), b""),
    ],
)
def test_a_fault_affects_one_message_and_then_no_more(fault, answer):
    one = Line(fault)
    assert one.ask(b"abc\n") == answer
    assert one.ask(b"abc\n") == b"ABC\n"
    assert one.line.faults == ()


def test_a_late_reply_comes_after_its_delay_before_the_next():
    one = Line(LineFault("late", delay_s=0.5))
    assert one.ask(b"a\n") == b""
    assert one.ask(b"b\n") == b"B\n"
    one.now_s = 0.5
    assert one.ask(b"") == b"A\n"
    assert one.ask(b"") == b""


def test_a_split_reply_comes_in_two_parts():
    one = Line(LineFault("split", delay_s=0.1))
    assert one.ask(b"abcd") == b"AB"
    one.now_s = 0.2
    assert one.ask(b"") == b"CD"


def test_a_garbled_reply_differs_in_one_bit():
    answer = Line(LineFault("garbled")).ask(b"abcdef\n")
    differing = [(a ^ b).bit_count() for a, b in zip(answer, b"ABCDEF\n", strict=True)]
    assert sorted(differing) == [0, 0, 0, 0, 0, 0, 1]


def test_a_garbled_request_reaches_the_device_garbled():
    one = Line(LineFault("request_garbled"))
    one.ask(b"abc\n")
    assert one.parrot.heard != b"abc\n"
    assert len(one.parrot.heard) == 4


@given(st.sampled_from(["truncated", "nul"]), st.binary(min_size=1, max_size=50), st.integers(0, 1000))
def test_a_cut_or_padded_reply_keeps_the_rest(kind, data, seed):
    answer = Line(LineFault(kind), seed=seed).ask(data)
    if kind == "truncated":
        assert data.upper().startswith(answer)
        assert len(answer) < len(data)
    else:
        assert len(answer) == len(data) + 1
        assert any(
            answer[:i] + answer[i + 1 :] == data.upper() and answer[i] == 0 for i in range(len(answer))
        )


def test_a_stale_reply_is_the_one_before():
    one = Line(LineFault("stale", skip=1))
    assert [one.ask(b"a"), one.ask(b"b"), one.ask(b"c")] == [b"A", b"A", b"C"]


def test_an_unsolicited_message_is_sent_once():
    one = Line()
    one.line.say(b"!x\n")
    assert one.line.unsolicited() == b"!x\n"
    assert one.line.unsolicited() == b""


def test_messages_are_skipped_and_counted():
    one = Line(LineFault("lost", skip=1, count=2))
    assert [one.ask(b"a") for _ in range(4)] == [b"A", b"", b"", b"A"]


def test_a_lasting_fault_lasts_until_cleared():
    one = Line(LineFault("lost", count=None))
    assert [one.ask(b"a") for _ in range(3)] == [b"", b"", b""]
    one.line.clear()
    assert one.ask(b"a") == b"A"


def test_a_fault_by_chance_affects_a_share_and_the_same_messages_for_the_same_seed():
    def run() -> list[bytes]:
        one = Line(LineFault("lost", count=None, chance=0.3), seed=7)
        return [one.ask(b"a") for _ in range(1000)]

    assert run() == run()
    assert 600 < run().count(b"A") < 800


def test_any_draws_from_every_fault_that_needs_no_text():
    one = Line(LineFault("any", count=None))
    answers = {one.ask(b"abcdefgh") for _ in range(300)}
    assert {b"", b"ABCDEFGHABCDEFGH", b"ABCD"} <= answers
    assert b"ABCDEFGH" not in answers


def test_a_fault_affects_unsolicited_messages_too():
    one = Line(LineFault("lost"))
    one.parrot.spoken = b"!alert\n"
    assert one.line.unsolicited() == b""


def test_silence_does_not_use_up_a_fault():
    one = Line(LineFault("lost"))
    assert one.line.unsolicited() == b""
    assert one.ask(b"a") == b""


def test_an_unknown_fault_is_refused_with_the_known_ones():
    with pytest.raises(SimulatorError, match=", ".join(REPLY_FAULTS)):
        Line(LineFault("nonsense"))
