"""SIGKILL at random instants of a run, its resuming, a seal, a certificate and a batch: what is lost, and does it go on?

    python tests/benchmarks/bench_kills.py [--kills 12] [--batch 12] [--write]

All but a batch work in a child, with virtual devices on a virtual clock; a batch is the command itself on
simulated benches, whose supervisor is killed; its worker ends too.
"""

import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from unittest import mock

import measured
from certificate_lab import FIRST, Lab
from quick_runs import write_sequence, write_station
from running import has_ended, journal, starbench, start
from virtual_bench import VirtualBench
from waiting import wait_until

from bench.record.storage import sha256_of

QUEUE = "format: starbench/queue/1\nname: Night\njobs:\n"
JOB = "  - {{name: cam-{number}, sequence: {sequence}, station: {station}, seed: 7, attempts: 20}}\n"
JOBS = 2
ALONE_S = 60.0
"""After this, a worker without its supervisor is taken as left behind."""


def done_or_killed(work: Callable[[], object], until: Callable[[], object]) -> bool:
    """Do the work in a child, killed when ``until`` returns; return whether it was killed before its end."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            work()
            code = 0
        except BaseException:  # noqa: BLE001 - the parent must not go on twice
            traceback.print_exc()
        finally:
            os._exit(code)
    until()
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    if os.WIFEXITED(status) and os.WEXITSTATUS(status):
        raise AssertionError("the work failed without a kill")
    return os.WIFSIGNALED(status)


class ARun:
    """A run of three poses."""

    name = "run"

    def __init__(self, folder: Path) -> None:
        self.bench = VirtualBench(folder)

    def work(self) -> object:
        return self.bench.begin()

    def goes_on(self) -> None:
        stored = self.bench.stored()
        self.bench.finish()
        assert self.bench.stored()[: len(stored)] == stored, "a stored recording is lost"
        assert {fault.kind for fault in self.bench.faults()} <= {"results", "journal"}, self.bench.faults()
        assert self.bench.breaks() == []


class AResume(ARun):
    """A run that was killed at its first recording, and goes on."""

    name = "resume"

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        assert done_or_killed(self.bench.begin, self._stored)

    def _stored(self) -> None:
        while not self.bench.stored():
            time.sleep(0.005)

    def work(self) -> object:
        return self.bench.resume()


class ASeal(ARun):
    """A finished run whose seal is made."""

    name = "seal"

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        no_seal = mock.patch("bench.run.launch.seal", side_effect=KeyboardInterrupt)
        with no_seal, contextlib.suppress(KeyboardInterrupt):
            self.bench.begin()

    def work(self) -> object:
        return self.bench.resume()


class ACertificate:
    """A certificate of a sealed run."""

    name = "certificate"

    def __init__(self, folder: Path) -> None:
        self.lab = Lab(folder)

    def work(self) -> object:
        with mock.patch("bench.extras.certificate.pdf.plots_of_run", return_value={}):
            return self.lab.issue()

    def goes_on(self) -> None:
        whole = (self.lab.path / "certificate").exists()
        if not whole:
            self.work()
        assert self.lab.numbers() == {FIRST: "issued"}, self.lab.numbers()
        assert self.lab.ledger.breaks() == ([], [])
        assert not [path for path in self.lab.path.iterdir() if path.name.endswith(".tmp")]


def kills_of(kind: type[ARun | ACertificate], kills: int, folder: Path, chance: random.Random) -> str:
    """Kill a work so often, anywhere in the time that it takes; return the row of the table."""
    for number in range(2):  # the first one may have to compile
        undisturbed = kind(folder / f"{kind.name}-undisturbed-{number}")
        begun = time.monotonic()
        undisturbed.work()
        takes_s = time.monotonic() - begun
    killed, fallen, tries = 0, [], 0
    while killed < kills:
        tries += 1
        trial = kind(folder / f"{kind.name}-{tries}")
        after_s = chance.uniform(0.0, takes_s)
        if not done_or_killed(trial.work, lambda after_s=after_s: time.sleep(after_s)):
            continue
        killed += 1
        try:
            trial.goes_on()
        except Exception as error:  # noqa: BLE001 - whatever comes of a kill is told
            fallen.append(repr(error)[:500])
    for text in fallen:
        print(f"{kind.name}: {text}", file=sys.stderr)
    return f"| {kind.name} | {killed} | {killed - len(fallen)} | {len(fallen)} |"


def children(pid: int) -> list[int]:
    """Return the processes that a process has begun."""
    return [int(p) for p in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def batch(kills: int, folder: Path, chance: random.Random) -> str:
    """Kill the supervisor of a batch at random instants, and call it again after each; return the row of the table."""
    home, night = folder / "home", folder / "night"
    sequence, station = write_sequence(folder / "quick.yaml"), write_station(folder / "station.yaml")
    queue = folder / "queue.yaml"
    jobs = [JOB.format(number=k, sequence=sequence, station=station) for k in range(JOBS)]
    queue.write_text(QUEUE + "".join(jobs))
    stored: dict[Path, list[str]] = {}
    killed, fallen = 0, []
    while True:
        process = start("batch", queue, "-o", night, home=home)
        if killed < kills:
            try:
                process.wait(chance.uniform(1.0, 15.0))
            except subprocess.TimeoutExpired:
                workers = children(process.pid)
                process.kill()
                killed += 1
                wait_until(lambda workers=workers: all(map(has_ended, workers)), ALONE_S)
        out, err = process.communicate()
        for run in sorted((night / "runs").glob("cam-?-001")):
            now = [e["sha256"] for e in journal(run) if e["event"] == "capture_stored"]
            if now[: len(stored.get(run, []))] != stored.get(run, []):
                fallen.append(f"{run.name}: a stored recording is lost")
            stored[run] = now
        if process.returncode != -signal.SIGKILL:
            break
    if process.returncode or json.loads((night / "summary.json").read_text())["how"] != "finished":
        fallen.append(out + err)
    for run in stored:
        captures = [e for e in journal(run) if e["event"] == "capture_stored"]
        if any(sha256_of(run / e["capture"]) != e["sha256"] for e in captures):
            fallen.append(f"{run.name}: a recording differs")
        verified = starbench("verify", run, home=home, status=None)
        if verified.returncode:
            fallen.append(verified.stdout + verified.stderr)
    for text in fallen:
        print(f"batch: {text}", file=sys.stderr)
    return f"| batch | {killed} | {killed - len(fallen)} | {len(fallen)} |"


def main() -> None:
    """Print the table."""
    parser = measured.options(__doc__)
    parser.add_argument("--kills", type=int, default=12, help="of run, resume, seal and certificate each")
    parser.add_argument("--batch", type=int, default=12, help="kills of a batch")
    given = parser.parse_args()
    chance = random.Random(1)
    print("| killed | times | gone on, nothing lost | not |\n| --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory() as folder:
        for kind in (ARun, AResume, ASeal, ACertificate):
            print(kills_of(kind, given.kills, Path(folder), chance), flush=True)
        print(batch(given.batch, Path(folder), chance))


if __name__ == "__main__":
    measured.run(main, "evidence", "Killed at random instants")
