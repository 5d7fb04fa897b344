"""Does U follow data, poses and knowledge without steps?

    python tests/benchmarks/bench_sweeps.py -o FILE [--seeds 3] [--known cr c r 0] [--only smooth poses knowledge bound]

``smooth``: an ideal bench whose poses get a smooth error of 0 to .01 px in steps of .001 px: no step of U above 1.6.
``poses``: 3 to 25 poses, each set within the next: U never grows by more than 10 %. ``knowledge``: nothing, then readings
or a certificate, then both: U never grows by more than 10 %. ``bound``: U of the ideal bench over the bound of Cramér and
Rao for the spherical model: at most 1.4; and that bound for one pose before a collimator that is known exactly. Each
part prints U of fx along the way and the largest step of each number.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import measured
import numpy as np
from worlds.bench import NINE, POSES, THREE
from worlds.bound import bound_px
from worlds.judge import judged
from worlds.polynomial import SEEDS, draw_world, record
from worlds.scores import WHAT
from worlds.sweeps import CHAINS, more_knowledge, more_poses, smooth_errors, steps

PARTS = ("smooth", "poses", "knowledge", "bound")
#: What is expected of the tangential terms of a lens (docs/adjustment.md).
TANGENTIAL = {"p1": 4e-4, "p2": 4e-4}
ONE_POSE = "one pose, collimator known"


def main() -> None:
    parser = measured.options(__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=3, help="number of seeds")
    parser.add_argument("--known", nargs="+", default=["cr", "c", "r", "0"])
    parser.add_argument("--only", nargs="+", default=PARTS, choices=PARTS)
    given = parser.parse_args()
    with given.output.open("a") as file:
        for part in given.only:
            print(f"{part}: largest step of U of {' '.join(WHAT)}, then U(fx) on the way")
            for seed in SEEDS[: given.seeds]:
                for name, lines in ways(part, seed, given.known):
                    show(f"{part} seed {seed} {name}", lines, part)
                    for line in lines:
                        file.write(
                            json.dumps({"part": part, "seed": seed, "way": name, **line}, ensure_ascii=False)
                            + "\n"
                        )


def ways(part: str, seed: int, knowns: Sequence[str]) -> list[tuple[str, list[dict[str, Any]]]]:
    """The ways of a part with their results."""
    if part == "smooth":
        sets = (("3 poses", THREE), ("9 poses", NINE))
        return [
            (f"{label} {known}", smooth_errors(seed, known, poses))
            for label, poses in sets
            for known in knowns
        ]
    if part == "poses":
        return [(known, more_poses(seed, known)) for known in knowns]
    if part == "knowledge":
        labelled = [
            (label, more_knowledge(seed, poses)) for label, poses in (("3 poses", THREE), ("9 poses", NINE))
        ]
        return [
            (f"{label} {' '.join(chain)}", [results[known] for known in chain])
            for label, results in labelled
            for chain in CHAINS
        ]
    return [*((known, [_over_bound(seed, known)]) for known in knowns), (ONE_POSE, [_one_pose(seed)])]


def _over_bound(seed: int, known: str) -> dict[str, Any]:
    world = draw_world(seed, "ideal")
    bench = record(world, seed, NINE)
    line, bound = judged(bench, known, "right"), bound_px(world, bench, known, TANGENTIAL)
    return {**line, "over_bound": {name: line["U"][name] / value for name, value in bound.items()}}


def _one_pose(seed: int) -> dict[str, Any]:
    """What no calibration with a passport can be better than: the glass has no errors, the pupil has its place."""
    world = draw_world(seed, "ideal")
    bench = record(world, seed, POSES[1])
    return {"bound_px": bound_px(world, bench, "xr", TANGENTIAL)}


def show(name: str, lines: Sequence[dict[str, Any]], part: str) -> None:
    """Print one way."""
    solved = [line for line in lines if "refused" not in line]
    refused = f"  {len(lines) - len(solved)} refused" if len(solved) < len(lines) else ""
    if name.endswith(ONE_POSE):
        print(name, "bound:", " ".join(f"{what} {px:.2f} px" for what, px in lines[0]["bound_px"].items()))
    elif part == "bound":
        over = " ".join(f"{what} {ratio:.2f}" for what, ratio in solved[0]["over_bound"].items())
        print(f"{name:34s} U over the bound: {over}; U(fx) {solved[0]['U']['fx']:.2f}", flush=True)
    else:
        _show_steps(name, solved, part, refused)


def _show_steps(name: str, solved: Sequence[dict[str, Any]], part: str, refused: str) -> None:
    largest = []
    for what in WHAT:
        ratios = np.array(steps(solved, what) or [1.0])
        largest.append(float(np.exp(np.abs(np.log(ratios)).max()) if part == "smooth" else ratios.max()))
    way = " ".join(f"{line['U']['fx']:.3g}" for line in solved)
    print(f"{name:34s} {' '.join(f'{ratio:5.2f}' for ratio in largest)} | {way}{refused}", flush=True)


if __name__ == "__main__":
    main()
