"""Does U fall with poses and with knowledge?

    python tests/benchmarks/bench_sweeps.py

``poses``: 3 to 25 poses, each set within the next. ``knowledge``: nothing, then readings or a certificate, then both. U
never grows by more than 10 %. Each part prints U of fx along the way and the largest step of each number.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import measured
from worlds.bench import NINE, THREE
from worlds.polynomial import SEEDS
from worlds.scores import WHAT
from worlds.sweeps import CHAINS, more_knowledge, more_poses, steps


def main() -> None:
    measured.options(__doc__).parse_args()
    print(f"largest step of U of {' '.join(WHAT)}, then U(fx) on the way")
    for seed in SEEDS[:3]:
        for name, lines in ways(seed):
            show(f"seed {seed} {name}", lines)


def ways(seed: int) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """Yield the ways with their results."""
    for known in ("cr", "c", "r", "0"):
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
