"""The link: lines in step, what was sent, devices that babble."""

import errno
import io
import json
import os
import threading
from types import SimpleNamespace

import pytest

from drivers.errors import ReplyError, ReplyGarbled, ReplyTimeout
from drivers.link import LONGEST_LINE, ReplyReader
from drivers.stage.zaber import ZaberChain
from drivers.wire_log import WireLogFault, WireLogFile
from tests.unit.drivers.conftest import CountedLink


def line(reader: ReplyReader) -> bytes:
    return reader.read_line()


def test_a_timeout_brings_the_line_into_step_before_the_next_request(scripted, clock) -> None:
    link = CountedLink(scripted([(b"a\n", b""), (b"b\n", b"2\n")]), clock)
    with pytest.raises(ReplyTimeout, match=r"scripted: .* 1 s"):
        link.exchange(b"a\n", line, deadline_s=1.0)
    assert link.resynchronised == 0
    assert link.exchange(b"b\n", line, deadline_s=1.0) == b"2\n"
    assert link.resynchronised == 1


def test_a_cut_reply_is_a_timeout_that_shows_what_came(scripted, clock) -> None:
    link = CountedLink(scripted([(b"a\n", b"12")]), clock)
    with pytest.raises(ReplyTimeout, match="only b'12' came"):
        link.exchange(b"a\n", line, deadline_s=1.0)


def test_whatever_ends_an_exchange_early_leaves_the_line_out_of_step(scripted, clock) -> None:
    link = CountedLink(scripted([(b"a\n", b"1\n"), (b"b\n", b"2\n")]), clock)

    def interrupted(reader: ReplyReader) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        link.exchange(b"a\n", interrupted, deadline_s=1.0)
    link.exchange(b"b\n", line, deadline_s=1.0)
    assert link.resynchronised == 1


def test_an_urgent_exchange_does_not_wait_for_the_line_and_does_not_heal_it(scripted, clock) -> None:
    link = CountedLink(scripted([(b"a\n", b""), (b"stop\n", b"ok\n"), (b"b\n", b"2\n")]), clock)
    with pytest.raises(ReplyTimeout):
        link.exchange(b"a\n", line, deadline_s=1.0)
    with link.urgently():
        link.exchange(b"stop\n", line, deadline_s=1.0)
    assert link.resynchronised == 0
    link.exchange(b"b\n", line, deadline_s=1.0)
    assert link.resynchronised == 1


def test_unsolicited_lines_go_to_their_handler_wherever_they_come(scripted, clock) -> None:
    port = scripted([(b"a\n", b"!1\n1\n"), (b"b\n", b"2\n")])
    link = CountedLink(port, clock)
    assert link.exchange(b"a\n", line, deadline_s=1.0) == b"1\n"
    port.ready = b"!2\n"
    assert link.exchange(b"b\n", line, deadline_s=1.0) == b"2\n"
    assert link.heard == [b"!1\n", b"!2\n"]
    assert link.resynchronised == 0


def test_every_byte_is_logged_with_its_time_and_direction(scripted, clock) -> None:
    lines = []
    log = SimpleNamespace(record=lambda *line: lines.append(line))
    link = CountedLink(scripted([(b"a\n", b"1\n")]), clock, wire_log=log)
    clock.sleep(2.5)
    link.exchange(b"a\n", line, deadline_s=1.0)
    assert lines == [(2.5, "scripted", ">", b"a\n"), (2.5, "scripted", "<", b"1\n")]


# ---------------------------------------------------------------- the wire log


def entries(path) -> list[dict]:
    return [json.loads(text) for text in path.read_text().splitlines()]


def test_any_byte_can_be_read_back(tmp_path) -> None:
    log = WireLogFile(tmp_path / "wire.jsonl")
    data = bytes(range(256))
    log.record(1.25, "port", ">", data)
    log.close()
    (entry,) = entries(log.path)
    assert entry["bytes"].encode("latin-1") == data
    assert (entry["t"], entry["port"], entry["dir"]) == (1.25, "port", ">")


def test_an_existing_log_is_continued(tmp_path) -> None:
    for number in range(2):
        log = WireLogFile(tmp_path / "wire.jsonl")
        log.record(float(number), "port", "<", b"x")
        log.close()
    assert [entry["t"] for entry in entries(log.path)] == [0.0, 1.0]


def test_the_log_is_bounded_and_keeps_the_latest(tmp_path) -> None:
    log = WireLogFile(tmp_path / "wire.jsonl", max_bytes=500, kept=2)
    for number in range(100):
        log.record(float(number), "port", "<", b"x" * 20)
    log.close()
    files = sorted(tmp_path.iterdir())
    assert [file.name for file in files] == ["wire.jsonl", "wire.jsonl.1", "wire.jsonl.2"]
    assert all(file.stat().st_size <= 500 for file in files)
    kept = [entry["t"] for file in reversed(files) for entry in entries(file)]
    assert kept == [float(number) for number in range(100 - len(kept), 100)]


def test_a_log_that_cannot_be_written_says_so_and_disturbs_nothing(tmp_path) -> None:
    log = WireLogFile(tmp_path / "missing" / "wire.jsonl")
    log.record(0.0, "port", ">", b"stop\n")
    log.record(0.0, "port", ">", b"stop\n")
    assert log.fault is not None
    assert "No such file" in log.fault.why


class FullDisk(io.FileIO):
    """A file whose third write stores a part, as on a disk that is full; the next fails, and so does its close."""

    writes = 0

    def write(self, data):
        FullDisk.writes += 1
        if FullDisk.writes > 3:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return super().write(bytes(data)[:7] if FullDisk.writes == 3 else data)

    def close(self):
        was_open = not self.closed
        super().close()
        if was_open:
            raise OSError(errno.EIO, os.strerror(errno.EIO))


def test_a_log_whose_write_fails_keeps_whole_lines_and_never_changes_after_that(tmp_path, monkeypatch):
    monkeypatch.setattr("drivers.wire_log.io.FileIO", FullDisk)
    log = WireLogFile(tmp_path / "wire.jsonl")
    for number in range(4):
        log.record(float(number), "port", ">", b"x")
    held = log.path.read_bytes()
    assert log.fault == WireLogFault(2.0, "No space left on device")
    log.close()
    assert log.path.read_bytes() == held
    assert [entry["t"] for entry in entries(log.path)] == [0.0, 1.0]


def test_half_a_line_that_a_power_cut_left_does_not_spoil_the_next_one(tmp_path) -> None:
    log = WireLogFile(tmp_path / "wire.jsonl")
    log.record(1.0, "port", ">", b"x")
    log.close()
    with log.path.open("ab") as file:
        file.write(b'{"t": 2.0, "po')
    log.record(3.0, "port", ">", b"x")
    log.close()
    assert [entry["t"] for entry in entries(log.path)] == [1.0, 3.0]


# ---------------------------------------------------------------- devices that babble

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
    monkeypatch.setattr(ZaberChain, "reply_s", 0.1)
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


def test_a_device_that_never_falls_silent_ends_the_draining(clock) -> None:
    link = CountedLink(Babbler(b"x"), clock)
    link.longest_drain_s = 0.01
    with pytest.raises(ReplyGarbled, match="sends without pause"):
        link.drain()


def test_a_line_too_long_is_thrown_away_with_its_refusal(scripted, clock) -> None:
    port = scripted([(b"a\n", b"x" * (LONGEST_LINE + 1)), (b"sync\n", b"in step\n"), (b"b\n", b"good\n")])

    class SyncLink(CountedLink):
        def _resynchronise(self) -> None:
            with self.urgently():
                self.exchange(b"sync\n", ReplyReader.read_line, deadline_s=0.1)

    link = SyncLink(port, clock)
    with pytest.raises(ReplyGarbled, match="4096 bytes"):
        link.exchange(b"a\n", ReplyReader.read_line, deadline_s=0.1)
    assert link.unread == b""
    assert link.exchange(b"b\n", ReplyReader.read_line, deadline_s=0.1) == b"good\n"
