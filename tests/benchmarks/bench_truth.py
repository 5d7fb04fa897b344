"""Measure how right the numbers are: calibrations of drawn benches against their truth, and against what is asked.

    python tests/benchmarks/bench_truth.py [--rows NAME ...] [--seeds 100-107] [--json FILE]

Each row is a bench with what its station states: an ideal collimator, collimators with the errors of a real one (S1, S2,
S3, like-bench), certificates, readings of the gimbal with bounds and without, repeats, bowed prints. Errors of the
gimbal are those of the simulated one. The stars come from the simulators' optics with noise of .014 px, without images.
Columns: error of fx (mean, standard deviation, largest), median of the expanded uncertainty U, the largest error over
U, the largest error of a corner after the best common rotation, models chosen, CPU seconds a bench.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

# Before numpy is loaded: on small matrices, threads of the linear algebra cost more than they gain.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

sys.path.append(str(Path(__file__).parents[2]))
from tests.support.truth_table import BY_NAME, ROWS, SEEDS, Row, Solved, shortcomings, solve_all

#: Repeats may change U by this share.
REPEATS_WITHIN = 0.15


def show(row: Row, seeds: Sequence[int]) -> list[Solved]:
    """Calibrate the benches of a row, and print it."""
    begun = time.process_time()
    solved, refused = solve_all(row, seeds)
    seconds = (time.process_time() - begun) / len(seeds)
    if solved:
        error = np.array([one.error_px for one in solved])
        expanded = np.array([one.expanded_px for one in solved])
        models = ", ".join(f"{name} {n}" for name, n in Counter(one.model for one in solved).most_common())
        faults = shortcomings(row, solved)
        print(
            f"{row.title:42s} {error.mean():+8.2f} {error.std():7.2f} {np.abs(error).max():7.2f} "
            f"{np.median(expanded):7.2f} {np.max(np.abs(error) / expanded):6.2f} "
            f"{max(one.corner_urad for one in solved):7.0f}  {models} | asked: {row.asked} | "
            f"{'NOT: ' + '; '.join(faults) if faults else 'ok'} | {seconds:.1f} s",
            flush=True,
        )
    for line in refused:
        print(f"{row.title:42s} refused, {line}", flush=True)
    return solved


def compare_repeats(once: Sequence[Solved], repeated: Sequence[Solved]) -> None:
    """Print U of repeated poses over that of the same poses once."""
    first = {one.seed: one.expanded_px for one in once}
    ratios = [one.expanded_px / first[one.seed] for one in repeated if one.seed in first]
    middle = float(np.median(ratios))
    good = abs(middle - 1.0) <= REPEATS_WITHIN
    print(
        f"S1, U of 9 poses four times over that of 9: median {middle:.2f}, {min(ratios):.2f} to {max(ratios):.2f} | "
        f"asked: 0.85 to 1.15 | {'ok' if good else 'NOT'}"
    )


def main() -> None:
    """Print the rows asked for, or all."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rows", nargs="+", metavar="NAME", help=", ".join(BY_NAME))
    parser.add_argument("--seeds", default=f"{SEEDS[0]}-{SEEDS[-1]}", help="first-last, or one seed")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all results there")
    given = parser.parse_args()
    unknown = sorted(set(given.rows or ()) - set(BY_NAME))
    if unknown:
        parser.error(f"no row is called {unknown[0]}; there are {', '.join(BY_NAME)}")
    ends = [int(number) for number in given.seeds.split("-")]
    seeds = range(ends[0], ends[-1] + 1)
    print(
        f"{'bench':42s} {'error':>8s} {'sd':>7s} {'max':>7s} {'U':>7s} {'max/U':>6s} {'corner':>7s}  px, px, px, px, -, urad"
    )
    found = {
        row.name: show(row, seeds) for row in (ROWS if not given.rows else [BY_NAME[n] for n in given.rows])
    }
    if found.get("S1-once") and found.get("S1-repeats"):
        compare_repeats(found["S1-once"], found["S1-repeats"])
    if given.json:
        rows = {name: [asdict(one) for one in solved] for name, solved in found.items()}
        given.json.write_text(json.dumps(rows, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    sys.exit(main())
