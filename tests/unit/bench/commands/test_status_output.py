"""`status --follow`: one block that stays on a terminal, new lines elsewhere; tried on a pseudo-terminal."""

import fcntl
import os
import pty
import signal
import struct
import subprocess
import sys
import termios
import threading
import time
from dataclasses import replace

import pytest
from terminal_screen import Screen
from waiting import wait_until

from bench.base.text_block import Block
from bench.batch.batch_status import BatchStatus
from bench.commands.status import status
from bench.plan.plan import load_documents, make_plan
from bench.record.events import Event
from tests.unit.bench.run.test_status import Run

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals")
FOLLOW = [sys.executable, "-m", "bench", "status", "--follow"]
WAIT_S = 20.0


@pytest.fixture(scope="module")
def planned():
    return make_plan(*load_documents("three_pose", "simulated")).to_dict()


@pytest.fixture
def run(tmp_path, planned):
    run = Run(tmp_path / "run", planned)
    yield run
    run.die()


class Followed:
    """`status --follow` on a pseudo-terminal, and what its screen shows."""

    def __init__(self, path, columns, rows):
        self.master, slave = pty.openpty()
        self.resize(columns, rows)
        environment = {k: v for k, v in os.environ.items() if k not in {"COLUMNS", "LINES", "NO_COLOR"}}
        self.process = subprocess.Popen(
            [*FOLLOW, str(path)],
            stdin=slave,
            stdout=slave,
            stderr=slave,
            env=environment | {"TERM": "xterm-256color", "PYTHONUTF8": "1"},
            start_new_session=True,
        )
        os.close(slave)
        self.screen = Screen(columns, rows)
        self.reader = threading.Thread(target=self._read)
        self.reader.start()

    def _read(self):
        while True:
            try:
                data = os.read(self.master, 65536)
            except OSError:  # the other end is closed
                return
            self.screen.feed(data.decode())

    def resize(self, columns, rows):
        fcntl.ioctl(self.master, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))
        if hasattr(self, "screen"):
            self.screen.columns, self.screen.height = columns, rows

    def shows(self, *texts):
        until = time.monotonic() + WAIT_S
        while not all(text in self.screen.text for text in texts):
            assert time.monotonic() < until, f"{texts} not in:\n{self.screen.text}"
            time.sleep(0.02)

    def end(self):
        status = self.process.wait(WAIT_S)
        self.reader.join(WAIT_S)
        return status

    def close(self):
        if self.process.poll() is None:
            self.process.kill()
        self.end()
        os.close(self.master)


@pytest.fixture
def followed(run):
    opened = []

    def follow(columns=100, rows=24):
        opened.append(Followed(run.path, columns, rows))
        return opened[-1]

    yield follow
    for follower in opened:
        follower.close()


def test_one_block_stays_to_the_end_of_the_run(run, followed):
    on = followed()
    on.shows("Run run-7  SIMULATED", "running: idle", "starbench tell")
    for pose in (1, 2, 3):
        run.tell(Event.ENTERING, state="recording", pose=pose)
        on.shows(f"running: recording, pose {pose} of 3")
    on.resize(48, 12)  # narrower and lower in the middle of the run
    run.tell(Event.ENTERING, state="finished")
    on.shows("finished; the run folder is being sealed")
    assert "abort" not in on.screen.text
    run.tell(Event.RUN_ENDED, how="finished", why="")
    run.die()
    assert on.end() == 0
    shown = on.screen.text
    assert shown.count("Run run-7") == 1, shown
    assert "running" not in shown.replace("recording", "")
    assert "starbench resume" in shown.replace("\n", " ")
    assert not on.screen.scrolled
    assert not on.screen.unknown
    assert max(map(len, shown.splitlines())) < 48


def test_a_run_that_dies_and_a_terminal_that_is_small(run, followed):
    on = followed(30, 8)
    for pose in (1, 2):
        run.tell(Event.ENTERING, state="slewing", pose=pose)
    on.shows("pose 2 of 3")
    run.die()
    assert on.end() == 1
    assert "interrupted (killed, power" in on.screen.text
    assert on.screen.text.startswith("Run run-7")
    assert len(on.screen.text.splitlines()) < 8
    assert not on.screen.scrolled


def test_ctrl_c_ends_the_following_only(run, followed):
    on = followed()
    on.shows("running: idle")
    on.process.send_signal(signal.SIGINT)
    assert on.end() == 130
    assert "No longer following. The run is not affected." in on.screen.text
    assert "Traceback" not in on.screen.text


def test_elsewhere_each_line_is_printed_once(run, tmp_path):
    run.tell(Event.ENTERING, state="recording", pose=1)
    out = tmp_path / "out.txt"
    with out.open("w") as stream:
        process = subprocess.Popen([*FOLLOW, str(run.path)], stdout=stream)
    wait_until(lambda: "pose 1" in out.read_text(), WAIT_S)
    for number in range(12):
        run.tell(Event.DEVIATION, what=f"number {number}")
    run.tell(Event.RUN_ENDED, how="failed", why="the lamp is broken")
    run.die()
    assert process.wait(WAIT_S) == 1
    lines = out.read_text().splitlines()
    journal = [line for line in lines if line.startswith("  ")]
    assert [line for line in journal if "number" in line] == [
        line for number in range(12) for line in journal if line.endswith(f"deviation: number {number}")
    ]
    assert sum("number 7" in line for line in journal) == 1
    assert lines[-1].startswith("No process works on this run.")
    assert sum(line.startswith("Run run-7") for line in lines) == 2  # at the begin and at the end
    assert "\x1b" not in out.read_text()


def test_a_name_cannot_move_the_cursor(capsys, monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    Block(sys.stdout).draw(["one\x1b[2J", "two"], ["\x1b[9A"], [])
    assert "\x1b[2J" not in capsys.readouterr().out


def test_a_followed_batch_prints_what_has_changed_and_returns_its_end(tmp_path, capsys, monkeypatch):
    (tmp_path / "queue.yaml").write_text("")
    (tmp_path / "journal.jsonl").write_text("")
    first = BatchStatus(
        folder=str(tmp_path), queue="night", zone=None, running=True, rehearsal=False, simulated=False,
        ended="", why="", done=(), current_run="a-001: slewing", upcoming=(), withdrawn=(),
    )  # fmt: skip
    statuses = [
        first,
        replace(first, current_run="a-001: recording"),
        replace(first, running=False, ended="aborted", why="by ada@lab", current_run=""),
    ]
    monkeypatch.setattr("bench.batch.batch_status.follow_batch", lambda _folder, *, ticks: iter(statuses))
    assert status.callback(tmp_path, follow=True, summary=False) == 3
    lines = capsys.readouterr().out.splitlines()
    assert lines[:4] == [
        "Batch night: running",
        "0 runs with a result, 0 without",
        "In progress: a-001: slewing",
        "In progress: a-001: recording",
    ]
    assert lines[4] == "Batch night: aborted: by ada@lab"
