"""How the recalculation of many runs scales from 1 to 2 workers.

    python tests/benchmarks/bench_cluster.py --folder EMPTY_FOLDER

The computer may be busy with other things, so the scaling is not a ratio of wall times. A worker is measured by the
share of time in which it has work, and by the CPU time of a piece of work beside a second worker and alone. The product
is what two free processors would give. A piece of work is a recording of the simulated bench with a small sensor.
"""

import os
import sys
from pathlib import Path

import measured
from quick_runs import THREE, quick_words
from running import starbench
from timed_work import timed_find

from bench.base.program import forms
from bench.extras.many.processes import Processes
from bench.solve.offline_options import OfflineOptions
from bench.work.places import Place
from bench.work.tasks import Task
from bench.work.workers import Work

PIECES = 16
"""Of work, for each part of the scaling."""


def main() -> None:
    """Make a run, and measure the scaling."""
    parser = measured.options(__doc__)
    parser.add_argument("--folder", type=Path, required=True)
    folder = parser.parse_args().folder.resolve()
    os.environ["PYTHONPATH"] = str(Path(__file__).parent)  # where workers find `timed_work`
    if not (folder / "run" / "results.json").is_file():
        starbench(*quick_words(folder, THREE, seed=1), home=folder / "home")
    scaling(folder / "run")


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
    measured.run(main, "costs", "Two workers")
