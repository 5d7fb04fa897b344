"""Measure the cost of calibrations: CPU time, bytes and memory for a pose, a run, a night, and a million captures.

    python tests/benchmarks/bench_costs.py RUN [--rounds 11] [--scaling 1.97] [--write]

RUN is a finished run. Everything is done by one process, several times. The median of the CPU time is printed, which
other work on the computer hardly changes, and its 95th percentile. The scaling to two workers is that of
`bench_cluster.py`. ``--write`` puts the tables into docs/measured/costs.md.
"""

import resource
from dataclasses import replace
from pathlib import Path
from typing import Any

import measured
from measured import Spread

from bench.measure.measure import measure
from bench.record.storage import sha256_of
from bench.solve.offline import calibrate_sources
from bench.solve.offline_folder import offline_files
from bench.solve.offline_options import OfflineOptions
from bench.solve.view_sources import view_sources
from calib.target import StarTarget
from drivers.camera.raw_file import RawFile

POSES_OF_A_NIGHT, RUNS_OF_A_NIGHT = 540, 60
CAPTURES = 1_000_000
_POSES = 9
"""Poses of a run, where runs are counted."""


def main() -> None:
    """Measure, and print the tables."""
    parser = measured.options(__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("--rounds", type=int, default=11)
    parser.add_argument("--scaling", type=float, default=1.97, help="speed of two workers against one")
    options = parser.parse_args()
    sources = list(view_sources(options.run, OfflineOptions()))
    before_mb = _peak_mb()
    views = [source.read() for source in sources]  # compiles the kernels
    given = [
        replace(source, read=lambda view=view: view) for source, view in zip(sources, views, strict=True)
    ]
    result = calibrate_sources(given, OfflineOptions())
    offline_files(result, "costs")
    rounds = options.rounds
    poses = len(sources)
    paths = [source.path for source in sources]
    of_a_pose = {
        "hash of the recording": lambda: [sha256_of(path) for path in paths],
        "decoding": lambda: [_decode(path) for path in paths],
        "finding the stars, decoding included": lambda: [source.read() for source in sources],
        "check in a run: stars, motion, edge width, flicker": lambda: [_check(path) for path in paths],
    }
    of_a_run = {
        "fit, the run's own model": lambda: calibrate_sources(given, OfflineOptions()),
        "results, report, exports": lambda: offline_files(result, "costs"),
    }
    pose = {what: measured.cpu_times(rounds, work) / poses for what, work in of_a_pose.items()}
    run = {what: measured.cpu_times(rounds, work) for what, work in of_a_run.items()}
    hashed, _, found, _ = (took.median_s for took in pose.values())
    fit_s, files_s = (took.median_s for took in run.values())
    _print_parts(pose, run, poses)
    recording_mb = sum(path.stat().st_size for path in paths) / poses / 1e6
    events_m = sum(_decode(path) for path in paths) / poses / 1e6
    print("\n| size | |\n| --- | ---: |")
    print(f"| a recording | {recording_mb:.2f} MB, {events_m:.2f} million events |")
    print(f"| memory of a worker, largest | {_peak_mb():.0f} MB ({before_mb:.0f} MB of it are the program) |")
    _print_sums((hashed + found, fit_s, files_s, 1e6 * recording_mb), poses, options.scaling)


def _check(path: Path) -> Any:
    """Measure a recording as a run does before its gates."""
    return measure(
        path, name=path.stem, target=StarTarget(), image="auto", periods=None, expected_hz=None
    ).view


def _decode(path: Path) -> int:
    return sum(len(events.t) for events, _ in RawFile.open(path).pieces())


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _print_parts(pose: dict[str, Spread], run: dict[str, Spread], poses: int) -> None:
    print("| work | CPU time | 95 % |\n| --- | ---: | ---: |")
    for what, took in pose.items():
        print(f"| a pose: {what} | {took.cells(3)} |")
    for what, took in run.items():
        print(f"| a run of {poses} poses: {what} | {took.cells(2)} |")


def _print_sums(costs: tuple[float, float, float, float], poses: int, scaling: float) -> None:
    """Print CPU time and duration of a night and of many captures, by those of a pose and of a run, s, and bytes."""
    find, fit, files, each = costs
    runs_of_captures = CAPTURES / _POSES
    amounts = {
        f"a run of {poses} poses": (find * poses, fit, files, each * poses),
        f"a night: {RUNS_OF_A_NIGHT} runs, {POSES_OF_A_NIGHT} poses": (
            find * POSES_OF_A_NIGHT, fit * RUNS_OF_A_NIGHT, files * RUNS_OF_A_NIGHT, each * POSES_OF_A_NIGHT,
        ),
        "1,000,000 captures in runs of nine": (
            find * CAPTURES, fit * runs_of_captures, files * runs_of_captures, each * CAPTURES,
        ),
    }  # fmt: skip
    print("\n| amount | stars | fits | reports | bytes read | 1 worker | 2 workers |")
    print("| --- |" + " ---: |" * 6)
    for what, (stars, fits, reports, size) in amounts.items():
        total = stars + fits + reports
        print(
            f"| {what} | {_time(stars)} | {_time(fits)} | {_time(reports)} | {float(f'{size / 1e9:.3g}'):,g} GB |"
            f" {_time(total)} | {_time(total / scaling)} |"
        )


def _time(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.1f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h" if seconds < 48 * 3600 else f"{seconds / 86400:.1f} d"


if __name__ == "__main__":
    measured.run(main, "costs", "A pose, a run, a night")
