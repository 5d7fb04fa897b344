"""Reading a journal that another process writes: whole lines only, each once, each verified."""

import os

import pytest
from journals import MadeRun

from bench.extras.pages.panel import journal_tail
from bench.extras.pages.panel.journal_tail import JournalTail


@pytest.fixture
def run(tmp_path):
    return MadeRun(tmp_path / "run")


def _tail(run):
    begins = []
    return JournalTail(run.path, lambda: begins.append(1)), begins


def _events(tail):
    return [entry.event for entry in tail.read()]


def test_each_line_is_read_once(run):
    tail, begins = _tail(run)
    run.write("run_started", id="x")
    assert tail.has_changed()
    assert _events(tail) == ["run_started"]
    assert not tail.has_changed()
    assert _events(tail) == []
    run.write("left_off", state="idle")
    run.write("run_ended", how="finished", why="")
    assert tail.has_changed()
    assert _events(tail) == ["left_off", "run_ended"]
    assert begins == [1]


def test_a_line_that_is_half_written_waits(run):
    tail, _ = _tail(run)
    line = run.line("run_started", id="x")
    run.path.write_bytes(line[:20])
    assert _events(tail) == []
    assert tail.incomplete
    assert not tail.fault
    assert not tail.more
    with run.path.open("ab") as stream:
        stream.write(line[20:])
    assert tail.has_changed()
    assert _events(tail) == ["run_started"]
    assert not tail.incomplete


def test_a_changed_line_ends_the_reading_and_says_where(run):
    run.write("run_started", id="x")
    run.write("left_off", state="idle")
    run.path.write_bytes(run.path.read_bytes().replace(b'"idle"', b'"idlx"'))
    tail, _ = _tail(run)
    assert _events(tail) == ["run_started"]
    assert f"{run.path}:2" in tail.fault
    assert "its hash" in tail.fault
    assert not tail.more


def test_zeros_after_a_power_cut_are_named_as_such(run):
    run.write("run_started", id="x")
    with run.path.open("ab") as stream:
        stream.write(b"\0" * (512 - run.path.stat().st_size % 512) + b'of a line"}\n')
    tail, _ = _tail(run)
    assert _events(tail) == ["run_started"]
    assert "power cut" in tail.fault


def test_a_shorter_file_is_read_again(run):
    for _ in range(3):
        run.write("left_off", state="idle")
    tail, begins = _tail(run)
    assert len(tail.read()) == 3
    lines = run.path.read_bytes().splitlines(keepends=True)
    os.truncate(run.path, len(lines[0]))
    assert tail.has_changed()
    assert len(tail.read()) == 1
    assert begins == [1, 1]


def test_a_missing_file_is_a_fault_until_it_is_there(run):
    tail, _ = _tail(run)
    run.path.unlink()
    assert tail.read() == []
    assert "No such file" in tail.fault
    MadeRun(run.folder / "again").path.replace(run.path)
    assert tail.has_changed()
    tail.read()
    assert not tail.fault


def test_a_long_journal_is_read_in_parts(run, monkeypatch):
    monkeypatch.setattr(journal_tail, "MOST_BYTES", 700)
    for _ in range(20):
        run.write("left_off", state="idle")
    tail, _ = _tail(run)
    parts = []
    while tail.has_changed():
        parts.append(len(tail.read()))
        assert 0 < tail.read_share <= 1
    assert sum(parts) == 20
    assert len(parts) > 5


def test_a_line_longer_than_a_part_is_read_whole(run, monkeypatch):
    monkeypatch.setattr(journal_tail, "MOST_BYTES", 100)
    run.write("deviation", what="x" * 5000)
    tail, _ = _tail(run)
    assert _events(tail) == ["deviation"]
