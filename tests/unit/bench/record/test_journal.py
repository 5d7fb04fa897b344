"""The journal: chained, synced, torn ends dropped, changes found."""

import errno
import hashlib
import json
import os
import subprocess
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bench.base.errors import JournalBroken, RunFolderError, StorageError
from bench.record.journal import CLOCK_JUMPED, Journal, lines_after, read_journal

START = datetime(2026, 3, 1, 12, 0, 0, 123456, tzinfo=UTC)


class Clocks:
    """System time and monotonic time, set by hand."""

    def __init__(self):
        self.utc, self.mono_s = START, 100.0

    def advance(self, seconds, *, system_s=None):
        self.mono_s += seconds
        self.utc += timedelta(seconds=seconds if system_s is None else system_s)

    def utc_now(self):
        return self.utc

    def monotonic(self):
        return self.mono_s


@pytest.fixture
def clocks():
    return Clocks()


@pytest.fixture
def path(tmp_path):
    return tmp_path / "journal.jsonl"


@pytest.fixture
def three_lines(path, clocks):
    with Journal.create(path, clocks) as journal:
        journal.append("run_started", sequence="three_pose", seed=1)
        journal.append("state", to="homing")
        journal.append("finished")
    return path


def test_numpy_paths_and_dates_are_written_as_json(path, clocks):
    with Journal.create(path, clocks) as journal:
        data = journal.append("x", a=np.float64(1.5), b=np.arange(3), c=Path("a/b"), d=START, e=np.True_).data
    assert data == {"a": 1.5, "b": [0, 1, 2], "c": "a/b", "d": "2026-03-01T12:00:00.123456+00:00", "e": True}


def test_a_shell_can_check_a_line_without_this_program(three_lines):
    first = json.loads(three_lines.read_text().splitlines()[0])
    command = f"""sed 's/,"hash":"[0-9a-f]*"}}$/}}/' {three_lines} | head -n 1 | tr -d '\\n' | sha256sum"""
    printed = subprocess.run(["sh", "-c", command], capture_output=True, text=True, check=True).stdout
    assert printed.split()[0] == first["hash"]


def test_every_prefix_of_a_journal_can_be_gone_on_with(three_lines, clocks, monkeypatch):
    monkeypatch.setattr(os, "fsync", lambda _descriptor: None)  # 800 syncs of a busy disk take their time
    whole = three_lines.read_bytes()
    for size in range(len(whole) + 1):
        three_lines.write_bytes(whole[:size])
        with Journal.open(three_lines, clocks) as journal:
            assert len(journal.entries) == whole[:size].count(b"\n")
            assert journal.torn == whole[:size].rpartition(b"\n")[2]
            head, added = journal.head, journal.append("resumed")
        assert (added.prev, added.seq) == (head, whole[:size].count(b"\n"))
        assert read_journal(three_lines)[0][-1] == added


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(data=st.data())
def test_any_changed_byte_of_a_whole_line_is_found(three_lines, data):
    whole = bytearray(three_lines.read_bytes())
    try:
        at = data.draw(st.integers(0, len(whole) - 2))
        value = data.draw(st.integers(0, 255).filter(lambda v: v != whole[at]))
        three_lines.write_bytes(whole[:at] + bytes([value]) + whole[at + 1 :])
        with pytest.raises(JournalBroken) as caught:
            read_journal(three_lines)
        # a line feed in the middle of a line makes that very line unreadable
        assert f":{whole[:at].count(10) + 1}:" in str(caught.value)
    finally:
        three_lines.write_bytes(whole)


def rehashed(line):
    """A line with the hash that its content asks for."""
    body = line[: line.rindex(b',"hash"')] + b"}"
    return body[:-1] + b',"hash":"' + hashlib.sha256(body).hexdigest().encode() + b'"}'


def with_another_hash_form(line):
    """A line whose right hash is followed by a tab."""
    body = line[: line.rindex(b',"hash"')] + b","
    own_hash = hashlib.sha256(body + b"}").hexdigest().encode()
    return body + b'"hash":"' + own_hash + b'"\t}'


def replaced(old, new):
    return lambda line: rehashed(line.replace(old, new))


@pytest.mark.parametrize(
    ("at", "change", "says"),
    [
        (0, replaced(b'"seed":1', b'"seed":2'), r":2: .*not chained"),
        (2, replaced(b'{"seq":2', b'{"seq":3'), r":3: .*line 3 in place of line 2"),
        (2, with_another_hash_form, ":3: "),
        (1, replaced(b'"homing"', b"[" * 500 + b"]" * 500), "this line is not an entry"),
        (1, replaced(b'"event":"state"', b'"event":["x"]'), "this line is not an entry"),
        (1, replaced(b'"utc":"2026-03-01T12:00:00.123456Z"', b'"utc":3'), "this line is not an entry"),
    ],
    ids=[
        "number edited",
        "out of order",
        "form of the hash",
        "nested",
        "event is a list",
        "time is a number",
    ],
)
def test_a_line_with_a_new_hash_of_its_own_is_found(three_lines, at, change, says):
    lines = three_lines.read_bytes().splitlines()
    lines[at], line = change(lines[at]), lines[at]
    assert lines[at] != line
    three_lines.write_bytes(b"\n".join(lines) + b"\n")
    with pytest.raises(JournalBroken, match=says):
        read_journal(three_lines)


def test_a_journal_larger_than_any_is_refused(three_lines, monkeypatch):
    monkeypatch.setattr("bench.record.journal.MOST_JOURNAL_BYTES", three_lines.stat().st_size)
    assert len(read_journal(three_lines)[0]) == 3
    monkeypatch.setattr("bench.record.journal.MOST_JOURNAL_BYTES", three_lines.stat().st_size - 1)
    with pytest.raises(JournalBroken, match=r"more than \d+ bytes"):
        read_journal(three_lines)


def test_a_broken_journal_is_left_as_it_is(three_lines, clocks):
    broken = three_lines.read_bytes().replace(b"homing", b"hominG") + b"torn"
    three_lines.write_bytes(broken)
    with pytest.raises(JournalBroken, match="from a copy"):
        Journal.open(three_lines, clocks)
    assert three_lines.read_bytes() == broken


def test_a_jump_of_the_system_clock_is_told_also_between_two_processes(path, clocks):
    with Journal.create(path, clocks) as journal:
        journal.append("a")
        clocks.advance(10, system_s=11.9)
        journal.append("b")
        clocks.advance(10, system_s=3610)
        journal.append("c")
    clocks.advance(5, system_s=-60)
    with Journal.open(path, clocks) as journal:
        journal.append("d")
    assert [e.event for e in journal.entries] == ["a", "b", CLOCK_JUMPED, "c", CLOCK_JUMPED, "d"]
    assert [journal.entries[at].data for at in (2, 4)] == [{"jump_s": 3600.0}, {"jump_s": -60.0}]


@pytest.mark.parametrize(
    "data",
    [{"seq": 1}, {"hash": "x"}, {"a": float("nan")}, pytest.param({"a": object()}, id="object")],
    ids=str,
)
def test_data_that_cannot_stand_in_a_line_is_refused(path, clocks, data):
    with Journal.create(path, clocks) as journal:
        with pytest.raises(ValueError, match="'bad'"):
            journal.append("bad", **data)
        journal.append("good")
    assert [e.event for e in read_journal(path)[0]] == ["good"]


def test_a_journal_is_never_begun_twice(three_lines, clocks):
    with pytest.raises(RunFolderError, match="exists already"):
        Journal.create(three_lines, clocks)


def test_a_full_disk_leaves_no_half_line_and_the_journal_goes_on(three_lines, clocks, monkeypatch):
    whole, calls, real_write = three_lines.read_bytes(), [], os.write

    def half_then_full(descriptor, data):
        calls.append(len(data))
        if len(calls) == 1:
            return real_write(descriptor, data[:20])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with Journal.open(three_lines, clocks) as journal:
        with monkeypatch.context() as patch:
            patch.setattr(os, "write", half_then_full)
            with pytest.raises(StorageError, match=r"disk is full.*Make room"):
                journal.append("x")
        assert calls[1] == calls[0] - 20
        assert three_lines.read_bytes() == whole
        journal.append("disk_full")
    assert [e.event for e in read_journal(three_lines)[0]][-2:] == ["finished", "disk_full"]


def failing(*_):
    raise OSError(errno.EIO, os.strerror(errno.EIO))


def half_written(descriptor, data):
    os.write(descriptor, data[:20])
    failing()


def stopped(descriptor, data):
    os.write(descriptor, data[:20])
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("calls", "error", "left"),
    [
        ({"os.fsync": failing}, StorageError, (4, 0)),
        ({"bench.record.journal.write_all": half_written, "os.ftruncate": failing}, StorageError, (3, 20)),
        ({"bench.record.journal.write_all": stopped}, KeyboardInterrupt, (3, 20)),
    ],
    ids=["sync failed", "half a line that cannot be taken back", "stopped"],
)
def test_after_a_failed_write_nothing_more_is_written(three_lines, clocks, monkeypatch, calls, error, left):
    with Journal.open(three_lines, clocks) as journal:
        with monkeypatch.context() as patch:
            for name, fault in calls.items():
                patch.setattr(name, fault)
            with pytest.raises(error, match=r"reports an error|^$"):
                journal.append("x")
        with pytest.raises(StorageError, match="a write to it failed"):
            journal.append("y")
        assert len(journal.entries) == 3
    assert tuple(map(len, read_journal(three_lines))) == left


def test_the_name_of_a_new_journal_is_synced_and_a_noted_line_is_with_the_next_one(path, clocks, synced):
    with Journal.create(path, clocks) as journal:
        journal.put("on_the_way", {}, synced=False)
        assert synced == [path.parent]
        assert [entry.event for entry in read_journal(path)[0]] == ["on_the_way"]
        journal.append("counts")
        assert synced == [path.parent, path]
    assert [entry.event for entry in read_journal(path)[0]] == ["on_the_way", "counts"]


# ---------------------------------------------------------------- what a disk may do to the end of it


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_blocks_that_never_reached_the_disk_take_lines_that_were_not_synced_and_no_others(
    tmp_path, clocks, data
):
    path = tmp_path / "zeros.jsonl"
    path.unlink(missing_ok=True)
    with Journal.create(path, clocks) as journal:
        for number in range(data.draw(st.integers(0, 4))):
            journal.append("counts", text="x" * data.draw(st.integers(0, 300)), number=number)
        synced, lasting = path.stat().st_size, len(journal.entries)
        for number in range(data.draw(st.integers(1, 8))):
            text = "y" * data.draw(st.integers(0, 900))
            journal.put("way", {"text": text, "number": number}, synced=False)
    written = bytearray(path.read_bytes())
    for begin in range(synced // 512 * 512, len(written), 512):
        if data.draw(st.booleans()):
            first, last = max(begin, synced), min(begin + 512, len(written))
            written[first:last] = bytes(max(0, last - first))
    path.write_bytes(written)
    with Journal.open(path, clocks) as journal:
        kept = list(journal.entries)
        journal.append("goes_on")
    assert len(kept) >= lasting
    entries, torn = read_journal(path)
    assert [*kept, entries[-1]] == entries
    assert torn == b""


@pytest.mark.parametrize(
    ("lines", "begin", "end", "is_cut"),
    [(100, 2048, 2560, False), (1, 512, 612, False), (1, 512, 1024, True)],
    ids=["far from the end", "no block's extent", "last block"],
)
def test_only_zeros_of_the_last_blocks_are_a_cut_of_power(path, clocks, lines, begin, end, is_cut):
    with Journal.create(path, clocks) as journal:
        for number in range(lines):
            journal.append("counts", text="x" * 1000, number=number)
    damaged = bytearray(path.read_bytes())
    damaged[begin:end] = bytes(end - begin)
    path.write_bytes(damaged)
    if is_cut:
        assert read_journal(path) == ([], bytes(damaged))
        return
    with pytest.raises(JournalBroken, match=r"journal.jsonl:\d: "):
        read_journal(path)


def test_lines_since_a_moment_are_whole_ones_and_nothing_of_the_one_before(three_lines):
    size = three_lines.stat().st_size
    with three_lines.open("ab") as file:
        file.write(b'{"seq":3,"event":"x","n":1}\n{"seq":4,"event":"y"')
    assert list(lines_after(three_lines, size - 10)) == [("x", {"n": 1})]
