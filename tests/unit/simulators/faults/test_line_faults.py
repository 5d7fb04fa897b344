"""Faults of a line: each affects as many messages as ordered, and no others."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulators.faults.line_faults import FaultLine, LineFault


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
    tried = Line(fault)
    assert tried.ask(b"abc\n") == answer
    assert tried.ask(b"abc\n") == b"ABC\n"
    assert tried.line.faults == ()


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


def test_an_unsolicited_message_is_sent_once():
    tried = Line()
    tried.line.say(b"!x\n")
    assert tried.line.unsolicited() == b"!x\n"
    assert tried.line.unsolicited() == b""


def test_messages_are_skipped_and_counted():
    tried = Line(LineFault("lost", skip=1, count=2))
    assert [tried.ask(b"a") for _ in range(4)] == [b"A", b"", b"", b"A"]


def test_a_fault_by_chance_affects_a_share_and_the_same_messages_for_the_same_seed():
    def run() -> list[bytes]:
        tried = Line(LineFault("lost", count=None, chance=0.3), seed=7)
        return [tried.ask(b"a") for _ in range(1000)]

    assert run() == run()
    assert 600 < run().count(b"A") < 800
