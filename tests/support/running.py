"""Runs the command line as an operator does, in this process or in one of its own; kills it where a test says."""

import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

from bench.commands.cli import main

STARBENCH = [sys.executable, "-m", "bench"]
PATIENCE_S = 600.0


def environment(home: Path) -> dict[str, str]:
    return {**os.environ, "STARBENCH_HOME": str(home), "STARBENCH_LOCKS": str(home / "locks")}


def with_status(
    process: subprocess.CompletedProcess[str], status: int | None
) -> subprocess.CompletedProcess[str]:
    """See that a process has ended with this status; None is any."""
    assert status in {None, process.returncode}, f"{process.returncode}: {process.stdout}{process.stderr}"
    return process


def python(*words, status: int | None = 0, cwd: Path | None = None, **variables):
    """Run Python in a process of its own, with some variables more, which must end with a status."""
    with killed_at_end(start_python(*words, cwd=cwd, **variables)) as process:
        outputs = process.communicate(timeout=PATIENCE_S)
    return with_status(subprocess.CompletedProcess(words, process.returncode, *outputs), status)


def start_python(*words, stdin=subprocess.DEVNULL, cwd: Path | None = None, **variables):
    """Start Python in a process of its own, with some variables more; its outputs are pipes of text."""
    return subprocess.Popen(
        [sys.executable, *map(str, words)],
        env={**os.environ, **{name: str(value) for name, value in variables.items()}},
        cwd=cwd,
        stdin=stdin,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@contextmanager
def killed_at_end(process: subprocess.Popen) -> Iterator[subprocess.Popen]:
    """Kill a process with the block, and wait for its end."""
    with process:
        try:
            yield process
        finally:
            process.kill()


def answer_of(process: subprocess.Popen[str], line: str) -> dict:
    """Give a process a line, and return its answer, a line in JSON."""
    process.stdin.write(f"{line}\n")
    process.stdin.flush()
    return json.loads(process.stdout.readline())


def starbench(*words, home: Path, cwd: Path | None = None, status: int | None = 0):
    """Run a command in a process of its own, which must end with a status."""
    return python(*STARBENCH[1:], *words, status=status, cwd=cwd, **environment(home))


def called(*words, home: Path, status: int | None = 0) -> subprocess.CompletedProcess[str]:
    """Run a command in this process: all that a process of its own would add is its start, of 3 s."""
    out, err = (io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True) for _ in range(2))
    with (
        mock.patch.dict(os.environ, environment(home)),
        mock.patch.multiple(sys, stdin=io.StringIO(), stdout=out, stderr=err),
    ):
        try:
            main([str(word) for word in words])
        except SystemExit as end:
            code = int(end.code or 0)
    outputs = [stream.buffer.getvalue().decode() for stream in (out, err)]
    return with_status(subprocess.CompletedProcess(words, code, *outputs), status)


def start(*words, home: Path) -> subprocess.Popen[str]:
    return start_python(*STARBENCH[1:], *words, **environment(home))


def children(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def light_outputs(folder: Path, after_s: float = 0.0) -> list[bool]:
    """What the light's output was switched to by a run, in order, after a time of its journal."""
    sent = [json.loads(line) for line in (folder / "wire.jsonl").read_text().splitlines()]
    after = [said["bytes"] for said in sent if said["dir"] == ">" and said["t"] > after_s]
    switched = [re.search(r"OUTP\S* (ON|OFF|0|1)", words) for words in after]
    return [match[1] in {"ON", "1"} for match in switched if match]


def has_ended(pid: int) -> bool:
    """Whether a process is gone, or waits for its parent as a zombie only."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


def journal(folder: Path) -> list[dict]:
    """Whole lines of a run's journal; empty while there is none."""
    path = folder / "journal.jsonl"
    if not path.exists():
        return []
    return [json.loads(line) for line in path.read_text().split("\n")[:-1]]


def end_when(process: subprocess.Popen[str], folder: Path, reached, number=signal.SIGKILL) -> str:
    """Send a signal as soon as the journal shows what is waited for; return what the process said on stderr."""
    with killed_at_end(process):
        wait_for(process, folder, reached)
        process.send_signal(number)
        return process.communicate(timeout=PATIENCE_S)[1]


def wait_for(process: subprocess.Popen[str], folder: Path, reached, seen: int = 0) -> None:
    """Wait until the journal shows, after so many lines, what is waited for; the process must live on."""
    deadline = time.monotonic() + PATIENCE_S
    while not any(map(reached, journal(folder)[seen:])):
        assert process.poll() is None, process.communicate()[1]
        assert time.monotonic() < deadline, journal(folder)
        time.sleep(0.005)


def entering(state: str, pose: int | None = None):
    return lambda line: (
        line["event"] == "entering" and line["state"] == state and line.get("pose") in {pose, None}
    )


def results(folder: Path) -> dict:
    return json.loads((folder / "results.json").read_text())


def numbers(folder: Path) -> dict:
    """What a run measured, without its times and names."""
    run_results = results(folder)
    images = [{k: v for k, v in pose["image"].items() if k != "window_us"} for pose in run_results["poses"]]
    return {
        "calibration": run_results["calibration"],
        "stars": [pose["stars"] for pose in run_results["poses"]],
        "images": images,
        "accepted": [sum(a["accepted"] for a in pose["attempts"]) for pose in run_results["poses"]],
    }
