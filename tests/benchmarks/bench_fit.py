"""CPU time of a fit by the joint adjustment.

    python tests/benchmarks/bench_fit.py [--recordings FOLDER]

For each world, kind of statements and number of poses: the median over the seeds, and the 95th percentile, s.
``cr``: certificate and bounded readings; a mount moved by hand (S1) has none. ``0``: nothing is stated. With
``--recordings`` the twenty published views of a real collimator are fitted, too.
"""

import argparse
import time
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import measured
from worlds.bench import GRID, POSES, Bench
from worlds.catalogue import WORLDS
from worlds.knowledge import options_for, views_of
from worlds.recordings import read

from calib import CalibrationOptions, View, calibrate

SEEDS = range(4)


def drawn(world: str, poses: int, seed: int) -> Bench:
    """Draw a bench; of more poses than a sequence has, the first of the grid."""
    bench = WORLDS[world](seed, poses if poses in POSES else len(GRID), 1, 0)
    bench.views[poses:], bench.readings_deg[poses:] = [], []
    return bench


def seconds(views: list[View], options: CalibrationOptions) -> float:
    """CPU time of the joint adjustment."""
    begun = time.process_time()
    calibrate(views, options)
    return time.process_time() - begun


def rows(given: argparse.Namespace) -> Iterator[tuple[str, list[float]]]:
    """Give the name of each row, and the seconds of each of its fits."""
    for world, known, poses in product(("polynomial", "product", "S1"), ("cr", "0"), (3, 9, 20)):
        if known == "0" or world != "S1":
            benches = [drawn(world, poses, seed) for seed in SEEDS]
            took = [seconds(views_of(bench), options_for(bench, known)) for bench in benches]
            yield f"{world}, {known}, {poses}", took
    if given.recordings:
        views = read(given.recordings)
        yield f"recordings, 0, {len(views)}", [seconds(views, CalibrationOptions()) for _ in SEEDS]


def main() -> None:
    parser = measured.options(__doc__)
    parser.add_argument("--recordings", type=Path)
    given = parser.parse_args()
    bench = drawn("polynomial", 3, 0)
    seconds(views_of(bench), options_for(bench, "cr"))  # imports and compiled loops
    print("| world, stated, poses | joint adjustment | 95 % |\n| --- | --- | --- |")
    for name, times in rows(given):
        print(f"| {name} | {measured.spread(times).cells(2)} |", flush=True)


if __name__ == "__main__":
    measured.run(main, "costs", "A fit")
