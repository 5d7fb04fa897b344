"""SIGKILL at random moments to the worker, the supervisor or both of a batch: it ends as the undisturbed one. Slow."""

import json
import os
import random
import signal
import time
from collections import Counter
from pathlib import Path

import pytest
from quick_runs import write_sequence, write_station
from running import PATIENCE_S, journal, numbers, starbench, start

from bench.record.journal import read_journal
from bench.record.storage import sha256_of
from bench.run.heartbeat import read_heartbeat

KILLS = int(os.environ.get("STARBENCH_KILLS", "300"))
RUNS, POSES = 10, 12
QUEUE = """\
format: starbench/queue/1
name: Night
jobs:
%s"""
JOB = "  - {name: cam-%d, sequence: %s, station: %s, seed: 7, attempts: 20}\n"


class Night:
    """A batch under way, killed again and again and called again after that."""

    def __init__(self, queue, folder, home):
        self.queue, self.folder, self.home = queue, folder, home
        self.workers: set[int] = set()
        self.begin()

    def begin(self):
        self.process = start("batch", self.queue, "-o", self.folder, home=self.home)

    def done(self):
        return self.process.poll() is not None

    def kill(self, kind):
        """Kill; tell whether anything that was still at work was hit."""
        self.workers |= {
            sign.pid for run in self.runs() if (sign := read_heartbeat(run)) is not None and is_ours(sign.pid)
        }
        self.workers |= set(children(self.process.pid))
        hit = False
        if kind in {"supervisor", "both"} and not self.done():
            self.process.kill()
            self.process.communicate(timeout=PATIENCE_S)
            hit = True
        if kind in {"worker", "both"}:
            for pid in [pid for pid in self.workers if is_ours(pid)]:
                os.kill(pid, signal.SIGKILL)
                hit = True
        self.workers = {pid for pid in self.workers if is_ours(pid)}
        if self.process.returncode == -signal.SIGKILL:
            self.begin()
        return hit

    def runs(self):
        folders = (self.folder / "runs").glob("cam-?-001") if self.folder.exists() else ()
        return sorted(path for path in folders if path.is_dir())


def children(pid):
    try:
        return [int(p) for p in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []


def is_ours(pid):
    """Whether it is a worker of a batch, and not dead."""
    try:
        words = Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
    except OSError:
        return False
    return b"bench" in words and (b"run" in words or b"resume" in words)


def lines_written(night):
    """How many lines the journals of a batch and its runs have."""
    journals = [night.folder / "journal.jsonl", *(run / "journal.jsonl" for run in night.runs())]
    return sum(path.read_bytes().count(b"\n") for path in journals if path.exists())


def wait_for_lines(night, chance):
    """Wait until so many lines have been written, drawn by chance, and a moment more; however fast the machine is."""
    wanted = lines_written(night) + chance.randint(0, 40)
    deadline = time.monotonic() + PATIENCE_S
    while lines_written(night) < wanted and not night.done() and time.monotonic() < deadline:
        time.sleep(0.02)
    time.sleep(chance.uniform(0.0, 0.5))


def stored(run):
    return [(e["pose"], e["attempt"], e["sha256"]) for e in journal(run) if e["event"] == "capture_stored"]


def see_that_nothing_is_lost(night, captures_of):
    """What a journal has told of once, it tells of for ever."""
    for run in night.runs():
        now = stored(run)
        assert now[: len(captures_of.get(run, ()))] == captures_of.get(run, [])
        captures_of[run] = now


def check(run, whole):
    """Each pose stored and accepted once, whole on disk; results as those of the undisturbed run. Returns its moves."""
    accepted = Counter(e["pose"] for e in journal(run) if e["event"] == "attempt_checked" and e["accepted"])
    assert accepted == dict.fromkeys(range(1, POSES + 1), 1)
    captures = [e for e in journal(run) if e["event"] == "capture_stored"]
    assert len({(e["pose"], e["attempt"]) for e in captures}) == len(captures) == POSES
    for capture in captures:
        assert sha256_of(run / capture["capture"]) == capture["sha256"]
    assert numbers(run) == numbers(whole)
    read_journal(run / "journal.jsonl")
    return sum(e["event"] == "entering" and e["state"] == "slewing" for e in journal(run))


@pytest.mark.slow
@pytest.mark.timeout(4 * 3600)
def test_a_batch_killed_at_random_moments_loses_nothing_doubles_nothing_and_ends_the_same(tmp_path):
    sequence, station = write_sequence(tmp_path / "quick.yaml"), write_station(tmp_path / "station.yaml")
    home = tmp_path / "home"
    queue = tmp_path / "queue.yaml"
    queue.write_text(QUEUE % "".join(JOB % (number, sequence, station) for number in range(RUNS)))
    undisturbed = tmp_path / "undisturbed"
    ended = starbench("run", sequence, "-s", station, "--seed", 7, "-o", undisturbed, home=home)
    assert ended.returncode == 0, ended.stderr
    chance = random.Random(1)
    kills = batches = 0
    while kills < KILLS:
        batches += 1
        night, captures_of = Night(queue, tmp_path / f"night-{batches}", home), {}
        killed_here = 0
        while not night.done():
            wait_for_lines(night, chance)
            if kills + killed_here < KILLS and not night.done():
                killed_here += night.kill(chance.choice(("worker", "supervisor", "both")))
                see_that_nothing_is_lost(night, captures_of)
        out, err = night.process.communicate()
        assert night.process.returncode == 0, out + err
        summary = json.loads((night.folder / "summary.json").read_text())
        assert summary["how"] == "finished"
        moves = sum(check(run, undisturbed) for run in night.runs())
        assert len(night.runs()) == RUNS
        assert moves - RUNS * POSES <= killed_here
        kills += killed_here
