"""`status --follow`: one block that stays on a terminal, new lines elsewhere."""

import sys
from dataclasses import replace
from functools import partial

import pytest
from journals import made_batch
from rich.console import ConsoleDimensions
from terminal_screen import Screen, Terminal

from bench.base.text_block import Block
from bench.batch.batch_status import read_batch_status
from bench.commands.status import follow, status
from bench.record.events import Event
from tests.unit.bench.run.test_status import Run


@pytest.fixture
def run(tmp_path):
    run = Run(tmp_path / "run")
    yield run
    run.die()


@pytest.fixture
def followed(run, monkeypatch):
    """Follow the run; between two looks something happens each time. Returns the exit status."""

    def follow_while(*happens):
        left = iter(happens)
        monkeypatch.setattr("bench.commands.status.follow", partial(follow, sleep=lambda _: next(left)()))
        return status.callback(run.path, follow=True, summary=False)

    return follow_while


def test_on_a_terminal_one_block_stays_to_the_end_of_the_run(run, followed, monkeypatch):
    for name, value in {"TERM": "xterm", "COLUMNS": "48", "LINES": "12"}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(sys, "stdout", terminal := Terminal())

    def finish():
        run.tell(Event.RUN_ENDED, how="finished", why="")
        run.die()

    records = [partial(run.tell, Event.ENTERING, state="recording", pose=pose) for pose in (1, 2, 3)]
    assert followed(*records, finish) == 0
    screen = Screen(48, 12)
    screen.feed(terminal.getvalue())
    assert screen.text.startswith("Run run-7")
    assert screen.text.count("Run run-7") == 1
    assert "running" not in screen.text
    assert "starbench resume" in screen.text.replace("\n", " ")
    assert (screen.scrolled, screen.unknown) == ([], [])
    assert max(map(len, screen.text.splitlines())) < 48


def test_ctrl_c_ends_the_following_only(followed, capsys):
    def interrupt():
        raise KeyboardInterrupt

    assert followed(interrupt) == 130
    assert "No longer following." in capsys.readouterr().err


def test_elsewhere_each_line_is_printed_once(run, followed, capsys):
    def fail():
        for number in range(12):
            run.tell(Event.DEVIATION, what=f"number {number}")
        run.tell(Event.RUN_ENDED, how="failed", why="the lamp is broken")
        run.die()

    assert followed(partial(run.tell, Event.ENTERING, state="recording", pose=1), fail) == 1
    lines = capsys.readouterr().out.splitlines()
    told = [line.partition("deviation: ")[2] for line in lines if line.startswith("  ") and "number" in line]
    assert told == [f"number {number}" for number in range(12)]
    assert sum(line.startswith("Run run-7") for line in lines) == 2  # at the begin and at the end
    assert lines[-1].startswith("No process works")
    assert "\x1b" not in "".join(lines)


def test_a_block_fits_a_terminal_that_becomes_narrower_and_lower(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    size = [48, 12]
    monkeypatch.setattr("rich.console.Console.size", property(lambda _: ConsoleDimensions(*size)))
    terminal, screen = Terminal(), Screen(*size)
    block = Block(terminal)
    for columns, rows, log in ((48, 12, 4), (48, 12, 4), (30, 8, 20)):
        size[:] = screen.columns, screen.height = columns, rows
        begin = terminal.tell()
        block.draw(["Run", "state"], [f"line {number} {'x' * 60}" for number in range(log)], ["tail"])
        screen.feed(terminal.getvalue()[begin:])
        shown = screen.text.splitlines()
        assert [*shown[:2], shown[-1], len(shown)] == ["Run", "state", "tail", 7]
        assert shown[-2].startswith(f"line {log - 1} x")
        assert (len(shown[-2]), shown[-2][-1]) == (columns - 1, "\N{HORIZONTAL ELLIPSIS}")
    assert (screen.scrolled, screen.unknown) == ([], [])


def test_a_name_cannot_move_the_cursor(capsys, monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    Block(sys.stdout).draw(["one\x1b[2J", "two"], ["\x1b[9A"], [])
    assert "\x1b[2J" not in capsys.readouterr().out


def test_a_followed_batch_prints_what_has_changed_and_returns_its_end(tmp_path, capsys, monkeypatch):
    begun = read_batch_status(made_batch(tmp_path / "night").folder)
    first = replace(begun, running=True, current_run="a-001: slewing", upcoming=())
    statuses = [
        first,
        replace(first, current_run="a-001: recording"),
        replace(first, running=False, ended="aborted", why="by ada@lab", current_run=""),
    ]
    monkeypatch.setattr("bench.batch.batch_status.follow_batch", lambda _folder, *, ticks: iter(statuses))
    assert status.callback(tmp_path / "night", follow=True, summary=False) == 3
    lines = capsys.readouterr().out.splitlines()
    assert lines[:4] == [
        "Batch Night: running",
        "0 runs with a result, 0 without",
        "In progress: a-001: slewing",
        "In progress: a-001: recording",
    ]
    assert lines[4] == "Batch Night: aborted: by ada@lab"
