"""Prove that the recalculation of many runs loses and doubles nothing, and measure how it scales from 1 to 2 workers.

    python tests/benchmarks/bench_cluster.py --folder EMPTY_FOLDER [--runs 1000] [--dask-runs 200] [--s3-runs 24]

The runs are variations of one run of the simulated bench with a small sensor (`tests/support/varied_runs.py`). They are
calibrated four times: serially in this process; by processes; by a Dask scheduler; from a server for S3 (moto). While
the last three work, workers are killed at random, and now and then the command itself, by SIGKILL or Ctrl-C, and the
scheduler; the same command is then started again. Every row must equal the serial one to the last digit.

The computer may be busy with other things, so the scaling is not a ratio of wall times. A worker is measured by the
share of time in which it has work, and by the CPU time of a piece of work beside a second worker and alone. The product
is what two free processors would give.
"""

import argparse
import contextlib
import json
import logging
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Self

import measured
from quick_runs import THREE, write_sequence, write_station
from varied_runs import make_runs

from bench.base.program import forms
from bench.extras.many.processes import Processes
from bench.measure.kept_views import FOLDER
from bench.solve.offline_options import OfflineOptions
from bench.work.places import Place, find_places
from bench.work.recalculation import Recalculation
from bench.work.results_folders import TABLE, ResultsFolders
from bench.work.tasks import Task, find_view
from bench.work.workers import Serial, Work

ROOT = Path(__file__).parents[2]
KILLED_EVERY_S = 10.0
COMMAND_SHARE = 1 / 12
"""Of the kills, those that hit the command or the scheduler, and no worker."""
PIECES = 16
"""Of work, for each part of the scaling."""


def main() -> None:
    """Make the runs, calibrate them in four ways, compare, and measure the scaling."""
    options = _options()
    folder: Path = options.folder.resolve()
    os.environ["STARBENCH_HOME"] = str(folder / "home")
    os.environ["PYTHONPATH"] = str(ROOT)
    base = _base_run(folder / "base")
    scaling(base)
    runs = make_runs(base, folder / "runs", options.runs)
    begun = time.process_time(), time.monotonic()
    expected = serial(folder)
    print(f"serial: {len(expected)} runs, {time.process_time() - begun[0]:.0f} s CPU,", end=" ")
    converged = all(row["converged"] for row in expected.values())
    print(f"{time.monotonic() - begun[1]:.0f} s; all converged: {converged}")
    rng = random.Random(1)
    kills = Kills(rng)
    rows = kills.calibrate([str(folder / "runs"), "--workers", "2"], folder / "by-processes")
    report("by 2 processes", rows, expected, kills)
    if options.dask_runs:
        some = [str(run) for run in runs[: options.dask_runs]]
        kills = Kills(rng)
        with DaskServers(folder) as servers:
            kills.servers = servers
            rows = kills.calibrate([*some, "--workers", servers.address], folder / "by-dask")
        report("by a Dask scheduler", rows, {name: expected[name] for name in some}, kills)
    if options.s3_runs:
        kills = Kills(rng)
        some = runs[: options.s3_runs]
        with s3_server() as system:
            for run in some:
                system.put(str(run), f"runs/{run.name}", recursive=True)
            # The stars of the same recordings were kept above: each is to be fetched.
            shutil.rmtree(folder / "home" / FOLDER, ignore_errors=True)
            rows = kills.calibrate(["s3://runs", "--workers", "2"], folder / "from-s3")
        here = [{**row, "folder": row["folder"].replace("s3://runs", str(folder / "runs"))} for row in rows]
        report("from S3", here, {str(run): expected[str(run)] for run in some}, kills)


def _options() -> argparse.Namespace:
    parser = measured.options(__doc__)
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--dask-runs", type=int, default=200)
    parser.add_argument("--s3-runs", type=int, default=24)
    return parser.parse_args()


def _base_run(folder: Path) -> Path:
    """Return a finished run of the simulated bench with three poses."""
    if not (folder / "run" / "results.json").is_file():
        folder.mkdir(parents=True)
        files = [write_sequence(folder / "sequence.yaml", THREE), write_station(folder / "station.yaml")]
        command = [sys.executable, "-m", "bench", "run", str(files[0]), "--station", str(files[1])]
        subprocess.run([*command, "--seed", "1", "-o", str(folder / "run")], check=True, cwd=ROOT,
                       stdout=subprocess.DEVNULL)  # fmt: skip
    return folder / "run"


def serial(folder: Path) -> dict[str, Mapping]:
    """Return the row of each run by its folder, calibrated one after the other in this process."""
    task = Task(OfflineOptions(), forms()["program"], str(folder / "kept-by-serial"))
    with ResultsFolders(folder / "serial", None, table_only=True) as output:
        rows = Recalculation(find_places([str(folder / "runs")]), task, Serial(), output).run()
    return {row["folder"]: row for row in rows}


class Kills:
    """Runs the command while workers, the command and the scheduler are killed at random."""

    def __init__(self, rng: random.Random) -> None:
        self.rng = rng
        self.servers: DaskServers | None = None
        self.counts: Counter[str] = Counter()
        self.doubled = 0

    def calibrate(self, words: list[str], output: Path) -> list[dict]:
        """Repeat the command until it has ended by itself; return the rows of its table."""
        words = ["calibrate", *words, "--each", "-o", str(output), "--table-only"]
        command = [sys.executable, "-m", "bench", *words]
        log = output.with_suffix(".log").open("ab")
        while True:
            with subprocess.Popen(command, cwd=ROOT, stdout=log, stderr=log) as process:
                while not self._ended(process):
                    if self.servers is not None and self.servers.workers.poll() is not None:
                        self.servers.require()  # Dask gives up when a worker is killed while it starts
                    self._kill_one(process.pid)
            self.counts["starts"] += 1
            self.doubled += _doubled(output / TABLE)
            if process.returncode == 0:
                return [json.loads(line) for line in (output / TABLE).read_text().splitlines()]
            if self.servers is not None:
                self.servers.require()

    def _ended(self, process: subprocess.Popen) -> bool:
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(self.rng.expovariate(1 / KILLED_EVERY_S))
            return True
        return False

    def _kill_one(self, command: int) -> None:
        """Kill a worker; sometimes the command or the scheduler."""
        if self.rng.random() < COMMAND_SHARE:
            if self.servers is not None and self.rng.random() < 0.5:
                self.counts["scheduler killed"] += 1
                self.servers.kill_scheduler()
                return
            how = self.rng.choice([signal.SIGKILL, signal.SIGINT])
            self.counts["command killed" if how == signal.SIGKILL else "Ctrl-C"] += 1
            os.kill(command, how)
            return
        above = command if self.servers is None else self.servers.workers.pid
        if workers := _workers_below(above):
            self.counts["workers killed"] += 1
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.rng.choice(workers), signal.SIGKILL)


_OF_WORKERS = (b"spawn_main", b"bench.extras.many.processes")
"""What the command lines of workers hold: those of Dask, and those of this computer."""


def _workers_below(parent: int) -> list[int]:
    """Return the workers below a process, without those that only track resources."""
    pids = []
    for status in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError, ValueError, IndexError):
            above = int(status.read_text().rpartition(")")[2].split()[1])
            words = (status.parent / "cmdline").read_bytes()
            if above == parent and any(word in words for word in _OF_WORKERS):
                pids.append(int(status.parent.name))
    return pids


def _doubled(table: Path) -> int:
    """Return how many runs have more than one row that says done. A torn last line is no row."""
    done: Counter[str] = Counter()
    for line in table.read_text().splitlines() if table.is_file() else ():
        with contextlib.suppress(ValueError):
            row = json.loads(line)
            done[row["folder"]] += row["state"] == "done"
    return sum(count > 1 for count in done.values())


def report(name: str, rows: list[dict], expected: Mapping[str, Mapping], kills: Kills) -> None:
    """Print what was lost, doubled and different; fail if anything was."""
    count = Counter(row["folder"] for row in rows)
    lost = [folder for folder in expected if folder not in count]
    doubled = sum(n > 1 for n in count.values()) + kills.doubled
    different = [row["folder"] for row in rows if row != expected.get(row["folder"])]
    killed = ", ".join(f"{n} {what}" for what, n in sorted(kills.counts.items()))
    print(f"{name}: {len(rows)} rows of {len(expected)} runs; {len(lost)} lost, {doubled} doubled,", end=" ")
    print(f"{len(different)} differ from serial ({killed})", flush=True)
    if lost or doubled or different:
        sys.exit(f"{name}: lost {lost[:3]}, doubled {doubled}, different {different[:3]}")


class DaskServers:
    """A scheduler, and a process that keeps two workers alive."""

    def __init__(self, folder: Path) -> None:
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self.port}"
        self.folder = folder

    def __enter__(self) -> Self:
        self._start()
        return self

    def __exit__(self, *_: object) -> None:
        self._kill_workers()
        self.kill_scheduler()

    def _start(self) -> None:
        dask = [str(Path(sys.executable).with_name("dask"))]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": self.folder}
        port = ["--host", "127.0.0.1", "--port", str(self.port), "--dashboard-address", "127.0.0.1:0"]
        self.scheduler = subprocess.Popen([*dask, "scheduler", *port], **quiet)
        each = ["--nworkers", "2", "--nthreads", "1", "--no-dashboard", "--local-directory", str(self.folder)]
        self.workers = subprocess.Popen([*dask, "worker", self.address, *each], **quiet)
        until = time.monotonic() + 120
        while time.monotonic() < until:
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1):
                return
            time.sleep(0.5)
        raise TimeoutError("The scheduler does not start.")

    def kill_scheduler(self) -> None:
        self.scheduler.kill()
        self.scheduler.wait()

    def require(self) -> None:
        """Start both again if one of them has ended."""
        if self.scheduler.poll() is not None or self.workers.poll() is not None:
            self._kill_workers()
            self.kill_scheduler()
            self._start()

    def _kill_workers(self) -> None:
        """Kill the workers, and the process that would start them again."""
        below = _workers_below(self.workers.pid)
        self.workers.kill()
        self.workers.wait()
        for worker in below:
            with contextlib.suppress(ProcessLookupError):
                os.kill(worker, signal.SIGKILL)


@contextlib.contextmanager
def s3_server() -> Iterator:
    """Serve S3 on this computer, by moto; yield the file system."""
    import s3fs
    from moto.server import ThreadedMotoServer

    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    served = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    served.start()
    host, port = served.get_host_and_port()
    os.environ |= {
        "AWS_ACCESS_KEY_ID": "testing", "AWS_SECRET_ACCESS_KEY": "testing", "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_ENDPOINT_URL": f"http://{host}:{port}",
    }  # fmt: skip
    system = s3fs.S3FileSystem()
    system.mkdir("runs")
    try:
        yield system
    finally:
        served.stop()


def timed_find(place: Place, number: int, capture: str, task: Task) -> tuple[int, float, float, float]:
    """Find the stars of a recording; return the process, begin and end on the monotonic clock, and its CPU time, s."""
    begun, cpu_s = time.monotonic(), time.process_time()
    find_view(place, number, capture, task)
    return os.getpid(), begun, time.monotonic(), time.process_time() - cpu_s


def scaling(base: Path) -> None:
    """Print the speed of two workers against one, on processors that nobody else uses."""
    task, place = Task(OfflineOptions(), forms()["program"], ""), Place(str(base))
    captures = sorted(path.relative_to(base).as_posix() for path in (base / "captures").glob("*.raw"))
    busy: dict[int, list[float]] = {1: [], 2: []}
    cpu: dict[int, list[float]] = {1: [], 2: []}
    with Processes(1) as one_worker, Processes(2) as two:
        for turn in range(5):  # in turns, because the load of the computer changes; the first turn warms up
            for workers in (one_worker, two):
                ends = _find_all(workers, place, captures, task, PIECES if turn else 4)
                if turn:
                    cpu[workers.size] += [end[3] for end in ends]
                    busy[workers.size].append(_busy_share(ends))
    share = {n: sum(some) / len(some) for n, some in busy.items()}
    took = {n: measured.spread(some) for n, some in cpu.items()}
    print(
        f"CPU time of a recording, median: {took[1].text(3)} alone, {took[2].text(3)} beside another;",
        end=" ",
    )
    print(f"a worker has work for {share[1]:.3f} and {share[2]:.3f} of the time")
    speed = share[2] / share[1] * took[1].median_s / took[2].median_s
    print(f"scaling from 1 to 2 workers: {2 * speed:.2f}", flush=True)


def _find_all(workers: Processes, place: Place, captures: list[str], task: Task, pieces: int) -> list:
    for n in range(pieces):
        number = n % len(captures)
        workers.submit(Work(f"{n}", timed_find, (place, number, captures[number], task)))
    ends: list = []
    while len(ends) < pieces:
        for end in workers.finished(1.0):
            if end.failure is not None:
                sys.exit(f"{end.failure}")
            ends.append(end.value)
    return ends


def _busy_share(ends: list) -> float:
    """Return the share of the time in which the workers had work, until the first of them found none waiting."""
    last = {pid: max(end[2] for end in ends if end[0] == pid) for pid in {end[0] for end in ends}}
    begun, until = min(end[1] for end in ends), min(last.values())
    worked = sum(max(0.0, min(end[2], until) - end[1]) for end in ends)
    return worked / (len(last) * (until - begun))


if __name__ == "__main__":
    measured.run(main, "costs", "Many runs while workers are killed")
