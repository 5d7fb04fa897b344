"""A device that talks without a pause or a line's end: no stop and no wait may be caught in it."""

from __future__ import annotations

import threading

import pytest

from drivers.errors import ReplyError, ReplyGarbled
from drivers.link import LONGEST_LINE, Link, ReplyReader
from drivers.stage import zaber
from drivers.stage.zaber import ZaberChain

PATIENCE_S = 10.0


class Babbler:
    """Says the same bytes whenever it is read."""

    name = "babbler"

    def __init__(self, says: bytes) -> None:
        self.says = says
        self.sent: list[bytes] = []
        self.silent = threading.Event()

    def write(self, data: bytes) -> None:
        self.sent.append(data)

    def read(self, timeout_s: float) -> bytes:
        if self.silent.wait(min(timeout_s, 0.001)):
            return b""
        return self.says

    def close(self) -> None:
        self.silent.set()


@pytest.mark.parametrize(
    "says", [b"\xf8" * 512, b"\xf8" * LONGEST_LINE + b"\n"], ids=["no end", "long lines"]
)
def test_a_stop_ends_within_its_deadlines_on_a_line_without_end(clock, says, monkeypatch) -> None:
    monkeypatch.setattr(zaber, "REPLY_S", 0.1)
    port = Babbler(says)
    chain = ZaberChain(port, [1, 2], clock=clock)
    ended: list[BaseException] = []

    def stop() -> None:
        try:
            chain.stop_all()
        except ReplyError as error:
            ended.append(error)

    thread = threading.Thread(target=stop, daemon=True)
    thread.start()
    thread.join(PATIENCE_S)
    hangs = thread.is_alive()
    port.says = b"@01 0 00 OK IDLE -- 0\n"  # what lets a hanging one go on
    assert not hangs
    assert len(ended) == 1
    assert [data[:8] for data in port.sent].count(b"/0 0 00 ") == 1
    assert len(port.sent) == 3  # tries


def test_a_line_too_long_is_thrown_away_with_its_refusal(scripted, clock) -> None:
    port = scripted([(b"a\n", b"x" * (LONGEST_LINE + 1)), (b"sync\n", b"in step\n"), (b"b\n", b"good\n")])

    def resynchronise() -> None:
        link.exchange(b"sync\n", ReplyReader.read_line, deadline_s=0.1, urgent=True)

    link = Link(port, clock=clock, resynchronise=resynchronise)
    with pytest.raises(ReplyGarbled):
        link.exchange(b"a\n", ReplyReader.read_line, deadline_s=0.1)
    assert link.unread == b""
    assert link.exchange(b"b\n", ReplyReader.read_line, deadline_s=0.1) == b"good\n"
