"""Measure the cost of calibrations: CPU time, bytes and memory for a pose, a run, a night, and a million captures.

    python tests/benchmarks/bench_costs.py RUN [--rounds 5] [--scaling 1.97]

RUN is a finished run. Everything is done by one process, several times; the median of the CPU time is printed, which
other work on the computer hardly changes. The scaling to two workers is that of `bench_cluster.py --only scaling`.
The result is text in Markdown, for docs/costs.md.
"""

from __future__ import annotations

import itertools
import resource
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import measured

from bench.base.program import forms
from bench.evidence.keys import create_key
from bench.extras.many.places import Place
from bench.extras.many.results_folders import ResultsFolders
from bench.extras.many.tasks import Task, list_recordings
from bench.measure.kept_views import pack_view
from bench.record.storage import sha256_of
from bench.solve.offline import OfflineResult, calibrate_sources
from bench.solve.offline_folder import offline_files
from bench.solve.offline_options import OfflineOptions
from bench.solve.view_sources import view_sources
from drivers.camera.raw_file import RawFile

POSES_OF_A_NIGHT, RUNS_OF_A_NIGHT = 540, 60
CAPTURES = 1_000_000
DISKS_MB_S = {"hard disk or 1 Gbit/s network": 110, "SATA SSD": 500, "NVMe SSD": 3000}
_WORKERS = (1, 2, 8, 32, 128)


def main() -> None:
    """Measure, and print the tables."""
    parser = measured.options(__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--scaling", type=float, default=1.97, help="speed of two workers against one")
    options = parser.parse_args()
    sources = list(view_sources(options.run, OfflineOptions()))
    before_mb = _peak_mb()
    views = [source.read() for source in sources]  # compiles the kernels
    given = [replace(source, read=partial(_same, view)) for source, view in zip(sources, views, strict=True)]
    result = calibrate_sources(given, OfflineOptions())
    offline_files(result, "costs")
    rounds = options.rounds
    poses = len(sources)
    paths = [source.path for source in sources]
    pose = {
        "hash of the recording": _median(rounds, lambda: [sha256_of(path) for path in paths]) / poses,
        "decoding": _median(rounds, lambda: [_decode(path) for path in paths]) / poses,
        "finding the stars, decoding included": _median(rounds, lambda: [one.read() for one in sources])
        / poses,
    }
    run = {
        "fit, the run's own model": _median(rounds, lambda: calibrate_sources(given, OfflineOptions())),
        "fit, spherical, no passport": _median(
            rounds, lambda: calibrate_sources(given, OfflineOptions(model="spherical", without_passport=True))
        ),
        "results, report, exports": _median(rounds, lambda: offline_files(result, "costs")),
    }
    task = Task(OfflineOptions(), forms()["program"], "")
    with tempfile.TemporaryDirectory() as folder:
        made = offline_files(result, "costs")
        with ResultsFolders(Path(folder) / "out", create_key(Path(folder) / "key")) as output:
            numbers = itertools.count()
            row = {"folder": "", "state": "done", "key": "", "results": "", "results_sha256": ""}

            def write() -> None:
                n = next(numbers)
                output.write(f"run-{n}", made, {**row, "folder": str(n)})

            command = {
                "list a run": _median(rounds, lambda: list_recordings(Place(str(options.run)), task)),
                "write and seal its results": _median(rounds, write),
            }
    _print_parts(pose, run, command, poses)
    _print_sizes(paths, views, result, before_mb)
    _print_sums(pose, run, paths, options.scaling)


def _same(view: Any) -> Any:
    return view


def _decode(path: Path) -> int:
    return sum(len(events.t) for events, _ in RawFile.open(path).pieces())


def _median(rounds: int, work: Callable[[], object]) -> float:
    """Return the median of the CPU time of some work, s."""
    work()
    times = []
    for _ in range(rounds):
        begun = time.process_time()
        work()
        times.append(time.process_time() - begun)
    return statistics.median(times)


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _print_parts(
    pose: dict[str, float], run: dict[str, float], command: dict[str, float], poses: int
) -> None:
    print("| work | CPU time |\n| --- | ---: |")
    for what, seconds in pose.items():
        print(f"| a pose: {what} | {seconds:.3f} s |")
    for what, seconds in run.items():
        print(f"| a run of {poses} poses: {what} | {seconds:.2f} s |")
    for what, seconds in command.items():
        print(f"| the command itself: {what} | {seconds:.3f} s |")
    work = sum(run.values()) - run["fit, spherical, no passport"] + poses * (
        pose["hash of the recording"] + pose["finding the stars, decoding included"]
    )  # fmt: skip
    print(f"\nThe command keeps {work / sum(command.values()):.0f} workers busy.")


def _print_sizes(
    paths: Sequence[Path], views: Sequence[Any], result: OfflineResult, before_mb: float
) -> None:
    poses = len(paths)
    recording = sum(path.stat().st_size for path in paths) / poses
    kept = sum(len(pack_view(view, "0" * 64)) for view in views) / poses
    events = sum(_decode(path) for path in paths) / poses
    written = sum(len(data) for data in offline_files(result, "costs").values())
    print("\n| size | |\n| --- | ---: |")
    print(f"| a recording | {recording / 1e6:.2f} MB, {events / 1e6:.2f} million events |")
    print(f"| a kept view | {kept / 1e3:.1f} kB |")
    print(f"| the results of a run, written | {written / 1e6:.2f} MB |")
    print(f"| memory of a worker, largest | {_peak_mb():.0f} MB ({before_mb:.0f} MB of it are the program) |")


def _print_sums(pose: dict[str, float], run: dict[str, float], paths: Sequence[Path], scaling: float) -> None:
    """Print CPU time and duration of a night and of many captures, and what limits them."""
    find = pose["hash of the recording"] + pose["finding the stars, decoding included"]
    fit, files = run["fit, the run's own model"], run["results, report, exports"]
    each = sum(path.stat().st_size for path in paths) / len(paths)
    runs_of_captures = CAPTURES / 9
    amounts = {
        f"a run of {len(paths)} poses": (find * len(paths), fit, files, each * len(paths)),
        f"a night: {RUNS_OF_A_NIGHT} runs, {POSES_OF_A_NIGHT} poses": (
            find * POSES_OF_A_NIGHT, fit * RUNS_OF_A_NIGHT, files * RUNS_OF_A_NIGHT, each * POSES_OF_A_NIGHT,
        ),
        "1,000,000 captures in runs of nine": (
            find * CAPTURES, fit * runs_of_captures, files * runs_of_captures, each * CAPTURES,
        ),
    }  # fmt: skip
    print(
        "\n| amount | stars | fits | reports | bytes read | 1 worker | 2 workers |\n| --- |" + " ---: |" * 6
    )
    for what, (stars, fits, reports, size) in amounts.items():
        total = stars + fits + reports
        print(
            f"| {what} | {_time(stars)} | {_time(fits)} | {_time(reports)} | {size / 1e9:.3g} GB |"
            f" {_time(total)} | {_time(total / scaling)} |"
        )
    efficiency = scaling / 2
    stars, fits, reports, size = amounts["1,000,000 captures in runs of nine"]
    print("\n| 1,000,000 captures on | " + " | ".join(f"{n} workers" for n in _WORKERS) + " |")
    print("| --- |" + " ---: |" * len(_WORKERS))
    for what, seconds in (("with reports", stars + fits + reports), ("table only", stars + fits)):
        shown = (_time(seconds / n / (efficiency if n > 1 else 1)) for n in _WORKERS)
        print(f"| processors, {what} | {' | '.join(shown)} |")
    for disk, rate in DISKS_MB_S.items():
        least = size / (rate * 1e6)
        full = (stars + fits) / least
        print(f"| {disk}, {rate} MB/s: {_time(least)} to read | {'|'.join(' ' for _ in _WORKERS[1:])} |"
              f" {full:.0f} workers keep it busy |")  # fmt: skip


def _time(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.1f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h" if seconds < 48 * 3600 else f"{seconds / 86400:.1f} d"


if __name__ == "__main__":
    measured.run(main, "costs", "A pose, a run, a night")
