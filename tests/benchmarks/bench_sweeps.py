"""Does U fall with poses and with knowledge?

    python tests/benchmarks/bench_sweeps.py -o FILE [--seeds 3] [--known cr c r 0]

``poses``: 3 to 25 poses, each set within the next. ``knowledge``: nothing, then readings or a certificate, then both. U
never grows by more than 10 %. Each part prints U of fx along the way and the largest step of each number.
"""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import measured
from worlds.bench import NINE, THREE
from worlds.polynomial import SEEDS
from worlds.scores import WHAT
from worlds.sweeps import CHAINS, more_knowledge, more_poses, steps


def main() -> None:
    parser = measured.options(__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=3, help="number of seeds")
    parser.add_argument("--known", nargs="+", default=["cr", "c", "r", "0"])
    given = parser.parse_args()
    print(f"largest step of U of {' '.join(WHAT)}, then U(fx) on the way")
    with given.output.open("a") as file:
        for seed in SEEDS[: given.seeds]:
            for name, lines in ways(seed, given.known):
                show(f"seed {seed} {name}", lines)
                for line in lines:
                    file.write(json.dumps({"seed": seed, "way": name, **line}, ensure_ascii=False) + "\n")


def ways(seed: int, knowns: Sequence[str]) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """Yield the ways with their results."""
    for known in knowns:
        yield f"poses {known}", more_poses(seed, known)
    for poses in (THREE, NINE):
        results = more_knowledge(seed, poses)
        for chain in CHAINS:
            yield f"{len(poses)} poses {' '.join(chain)}", [results[known] for known in chain]


def show(name: str, lines: Sequence[dict[str, Any]]) -> None:
    """Print one way."""
    solved = [line for line in lines if "refused" not in line]
    refused = f"  {len(lines) - len(solved)} refused" if len(solved) < len(lines) else ""
    largest = [max(steps(solved, what) or [1.0]) for what in WHAT]
    way = " ".join(f"{line['U']['fx']:.3g}" for line in solved)
    print(f"{name:34s} {' '.join(f'{ratio:5.2f}' for ratio in largest)} | {way}{refused}", flush=True)


if __name__ == "__main__":
    main()
