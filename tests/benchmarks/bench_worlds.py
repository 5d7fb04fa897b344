"""Judge the engine on drawn worlds: is the truth within U as often as stated, and how large is U?

    python tests/benchmarks/bench_worlds.py -o FILE [--worlds polynomial ...] [--poses 3 9 25] [--known cr c r 0]
        [--seeds 0-19] [--jobs 1]

Each result is a line of JSON in the file; a later run with the same file goes on where the first one was stopped. The
engine is used through `calib.calibrate` only, so the same program judges another
checkout: `PYTHONPATH=CHECKOUT python .../bench_worlds.py`. The world `stranger` needs Optiland; 0 poses: the seed
decides. The seeds decide everything that is drawn.
"""

import argparse
import sys
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import measured
from worlds.catalogue import WORLDS, result
from worlds.knowledge import KNOWN
from worlds.scores import table

import calib

Key = tuple[str, int, int, str]


def main() -> None:
    parser = measured.options(__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--worlds", nargs="+", default=["polynomial"], choices=WORLDS)
    parser.add_argument("--poses", nargs="+", type=int, default=[3, 9, 25])
    parser.add_argument("--known", nargs="+", default=list(KNOWN))
    parser.add_argument("--seeds", type=measured.seeds, default="0-99", help="first-last, or one seed")
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    parts = ("world", "poses_asked", "seed", "known")
    done = measured.kept(given.output, lambda line: tuple(line[part] for part in parts))
    print(f"engine: {Path(calib.__file__).parent}", file=sys.stderr)
    measured.add_missing(given.output, done, asked(given), result, given.jobs)
    print(table([done[key] for key in asked(given) if key in done]))


def asked(given: argparse.Namespace) -> Iterator[Key]:
    """All benches that are asked for, seed by seed, so that a part of them is a fair sample."""
    for seed, world, poses, known in product(given.seeds, given.worlds, given.poses, given.known):
        yield world, poses, seed, known


if __name__ == "__main__":
    measured.run(main, "truth", "Drawn worlds")
