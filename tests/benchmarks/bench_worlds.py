"""Judge the engine on drawn worlds: is the truth within U as often as stated, and how large is U?

    python tests/benchmarks/bench_worlds.py -o FILE [--worlds polynomial ...] [--poses 3 9 25] [--known cr c r 0]
        [--seeds 0-19] [--lens shipped] [--jobs 1] [--quick] [--table]

Each result is a line of JSON in the file; a later run with the same file goes on where the first one was stopped. The
engine is used through `calib.calibrate` and `calib.projection_uncertainty` only, so the same program judges another
checkout: `PYTHONPATH=CHECKOUT python .../bench_worlds.py`. ``--quick`` takes few seeds, 3 and 9 poses, some 2 CPU
minutes. ``--table`` prints the table of a file and calibrates nothing; ``--page`` prints the short one of docs/measured. The seeds
decide everything that is drawn.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from itertools import product
from pathlib import Path
from typing import Any

# Before numpy is loaded: on small matrices, threads of the linear algebra cost more than they gain.
os.environ.setdefault("OMP_NUM_THREADS", "1")

sys.path.append(str(Path(__file__).parents[2]))
from worlds.catalogue import WORLDS, result
from worlds.knowledge import KNOWN
from worlds.scores import page, table

import calib

Key = tuple[str, int, int, str]
QUICK: dict[str, Any] = {"seeds": range(4), "poses": [3, 9], "known": ["cr", "c", "0"]}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--worlds", nargs="+", default=["polynomial"], choices=WORLDS)
    parser.add_argument("--poses", nargs="+", type=int, default=[3, 9, 25])
    parser.add_argument("--known", nargs="+", default=list(KNOWN))
    parser.add_argument("--seeds", default="0-99", help="first-last, or one seed")
    parser.add_argument("--lens", default="shipped", choices=("shipped", "right"))
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--table", action="store_true", help="print the table of the file only")
    parser.add_argument("--page", action="store_true", help="print the short table of docs/measured")
    given = parser.parse_args()
    first, _, last = given.seeds.partition("-")
    given.seeds = range(int(first), int(last or first) + 1)
    if given.quick:
        vars(given).update(QUICK)
    done = kept(given.output)
    if not given.table:
        print(f"engine: {Path(calib.__file__).parent}", file=sys.stderr)
        measure(given, done)
    wanted = set(asked(given))
    print(
        (page if given.page else table)([line for key, line in done.items() if key in wanted or given.table])
    )


def kept(path: Path) -> dict[Key, dict[str, Any]]:
    """Read the results of a file."""
    lines = [json.loads(text) for text in path.read_text().splitlines()] if path.exists() else []
    return {(line["world"], line["poses_asked"], line["seed"], line["known"]): line for line in lines}


def asked(given: argparse.Namespace) -> Iterator[Key]:
    """All benches that are asked for, seed by seed, so that a part of them is a fair sample."""
    for seed, world, poses, known in product(given.seeds, given.worlds, given.poses, given.known):
        yield world, poses, seed, known


def measure(given: argparse.Namespace, done: dict[Key, dict[str, Any]]) -> None:
    """Calibrate the benches that the file does not have yet."""
    missing = [key for key in asked(given) if key not in done]
    with given.output.open("a") as file, ProcessPoolExecutor(given.jobs) as pool:
        running = {pool.submit(result, *key, given.lens): key for key in missing}
        for future in as_completed(running):
            try:
                line = future.result()
            except ArithmeticError as error:  # glass through which a ray of this bench does not get
                print("not drawn:", *running[future], error, file=sys.stderr)
                continue
            done[running[future]] = line
            file.write(json.dumps(line, ensure_ascii=False) + "\n")
            file.flush()


if __name__ == "__main__":
    import measured

    measured.run(main, "truth", "Drawn worlds")
