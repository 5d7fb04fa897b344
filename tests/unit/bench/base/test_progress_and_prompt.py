"""What the operator sees and is asked."""

import io
import os
import re
from datetime import UTC, datetime
from pathlib import Path

import pytest
from running import python
from terminal_screen import Terminal
from waiting import wait_until

from bench.base.clock import Aborted, BenchClock, VirtualClock
from bench.base.progress import Progress, Reply, ask

NIGHT = datetime(2026, 3, 1, 20, tzinfo=UTC)


class Typed(Terminal):
    """A terminal that no select takes, whose lines come as they are typed."""

    def __init__(self, lines):
        super().__init__()
        self.lines, self.read = lines, 0

    def readline(self):
        line = self.lines.readline()
        self.read += 1
        return line


def test_without_a_terminal_each_change_is_a_line_with_state_pose_and_time_left():
    stream = io.StringIO()
    with Progress(total_s=90.0, poses=3, stream=stream) as progress:
        progress.show("slewing", pose=2, detail="upper left")
        progress.left_s = lambda: 25.0
        progress.show("recording", pose=2)
    lines = stream.getvalue().splitlines()
    assert "slewing" in lines[0]
    assert "pose 2 of 3" in lines[0]
    assert "1:30 left" in lines[0]
    assert "upper left" in lines[0]
    assert "0:25 left" in lines[1]


@pytest.mark.parametrize("columns", [20, 40, 60, 80, 200])
def test_on_a_terminal_of_any_width_it_is_one_line_that_names_the_state(monkeypatch, columns):
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    terminal = Terminal()
    with Progress(total_s=90.0, poses=12, stream=terminal) as progress:
        progress.show("recording", pose=11, detail="upper left")
    plain = re.sub(r"\x1b\[[0-9;]*m", "", terminal.getvalue())
    shown = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "\n", plain)
    lines = [line for line in re.split(r"[\r\n]+", shown) if line]
    assert any("recording    1:30" in line for line in lines)
    assert max(map(len, lines)) <= columns
    assert any("pose 11 of 12 (upper left)" in line for line in lines) is (columns >= 60)
    assert any("─" in line for line in lines) is (columns >= 60)


def test_a_shielded_clock_is_not_interrupted():
    clock = BenchClock()
    clock.request_stop("first reason")
    clock.request_stop("second reason")
    with clock.shielded():
        clock.sleep(0.0)
        clock.check()
    with pytest.raises(Aborted, match="first reason"):
        clock.check()


def asked(terminal, *, default="abort", timeout_s=60.0, clock=None, say=lambda _: None, **more):
    """Ask at a terminal; return the word of the reply, and who gave it."""
    more |= {"clock": clock or BenchClock(), "say": say, "folder": Path("runs/cam 7"), "terminal": terminal}
    reply = ask("Go?", default=default, timeout_s=timeout_s, **more)
    return reply.word, reply.by


@pytest.fixture
def selected(monkeypatch):
    """What `select` says is ready to be read."""
    ready = []
    monkeypatch.setattr("bench.base.progress.select.select", lambda *_: (ready, [], []))
    return ready


def test_where_nobody_is_there_the_default_counts_after_the_time_out():
    messages, clock = [], VirtualClock(NIGHT)
    assert asked(io.StringIO(), timeout_s=600, clock=clock, say=messages.append) == ("abort", "time-out")
    assert "Go?" in messages[0]
    assert 600 <= clock.monotonic() < 601


def test_an_answer_from_another_terminal_counts_at_once():
    messages, clock = [], VirtualClock(NIGHT)

    def elsewhere():
        return Reply("continue", "ada") if clock.monotonic() > 30 else None

    answer = asked(io.StringIO(), timeout_s=600, clock=clock, say=messages.append, elsewhere=elsewhere)
    assert answer == ("continue", "ada")
    assert clock.monotonic() < 31
    assert messages[1:] == ["ada: continue"]


ANSWERS = [("a\n", "abort"), ("continue\n", "continue"), ("what\nn\n", "abort"), ("what\nyes\n", "continue")]


@pytest.mark.parametrize("default", ["abort", "continue"])
@pytest.mark.parametrize(("typed", "word"), [*ANSWERS, ("\n", None)])
def test_the_operators_word_counts_and_an_empty_line_is_the_default(selected, typed, word, default):
    selected.append(Terminal(typed))
    assert asked(selected[0], default=default) == (word or default, "operator")


@pytest.mark.parametrize(("typed", "word"), ANSWERS)
def test_where_select_takes_no_terminals_a_thread_reads(typed, word):
    # A StringIO is no file: select refuses it, as Windows' refuses the console.
    assert asked(Terminal(typed), default="continue") == (word, "operator")


@pytest.mark.parametrize("waits_for_terminals", [True, False])
def test_a_terminal_that_was_closed_answers_nothing(request, waits_for_terminals):
    terminal, messages = Terminal(""), []
    if waits_for_terminals:
        request.getfixturevalue("selected").append(terminal)
    assert asked(terminal, timeout_s=1, say=messages.append) == ("abort", "time-out")
    assert "`starbench tell 'runs/cam 7' yes`" in messages[-1]


def test_what_a_thread_read_before_the_question_does_not_count():
    reading, writing = os.pipe()
    with os.fdopen(reading) as lines, os.fdopen(writing, "w", buffering=1) as keyboard:
        terminal = Typed(lines)
        keyboard.write("y\n")
        assert asked(terminal) == ("continue", "operator")
        keyboard.write("y\n")
        wait_until(lambda: terminal.read == 2, 30)
        assert asked(terminal, timeout_s=0.5) == ("abort", "time-out")


def test_what_was_typed_before_the_question_does_not_count():
    keyboard, screen = os.openpty()
    with os.fdopen(screen) as terminal:
        os.write(keyboard, b"y\n")
        assert asked(terminal, timeout_s=1) == ("abort", "time-out")
    os.close(keyboard)


@pytest.mark.usefixtures("selected")
def test_a_stop_ends_the_question():
    clock = BenchClock()
    clock.request_stop("SIGTERM received")
    with pytest.raises(Aborted, match="SIGTERM"):
        asked(Terminal(), clock=clock)


IN_THE_BACKGROUND = """
import os, pty
from pathlib import Path
from bench.base.clock import BenchClock
from bench.base.progress import ask
shell, _ = pty.fork()
if shell:
    print(os.WEXITSTATUS(os.waitpid(shell, 0)[1]))
elif job := os.fork():
    os._exit(0 if os.WIFEXITED(os.waitpid(job, os.WUNTRACED)[1]) else 1)
else:
    os.setpgid(0, 0)
    ask("?", default="abort", timeout_s=0.3, clock=BenchClock(), say=lambda _: None, folder=Path("run"))
    os._exit(0)
"""


def test_a_question_in_the_background_of_a_terminal_suspends_no_run():
    assert python("-c", IN_THE_BACKGROUND).stdout == "0\n"


@pytest.mark.parametrize("stream", [io.StringIO, Terminal])
@pytest.mark.parametrize("state", ["aborting", "aborted", "failed"])
def test_a_run_that_ends_early_has_no_remaining_time(monkeypatch, state, stream):
    monkeypatch.setenv("TERM", "xterm")
    shown = stream()
    with Progress(total_s=90.0, poses=3, stream=shown) as progress:
        progress.show(state, pose=2, detail="upper left")
    assert state in shown.getvalue()
    assert "pose 2 of 3 (upper left)" in shown.getvalue()
    assert "left  " not in shown.getvalue().replace("upper left", "")
    assert "1:30" not in shown.getvalue()
