"""U as one thing grows: the number of poses, or what is known. A step of U is a ratio of neighbours."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from .bench import GRID, THREE, Pose
from .judge import judged
from .polynomial import draw_world, record

COUNTS = (3, 4, 5, 6, 7, 9, 12, 16, 20, 25)
CHAINS = (("0", "r", "cr"), ("0", "c", "cr"))


def nested_poses(seed: int) -> Sequence[Pose]:
    """25 poses: the three of a short sequence, then those of the grid in a drawn order."""
    order = np.random.default_rng((seed, 41)).permutation(len(GRID))
    return [*THREE, *(GRID[i] for i in order)][: max(COUNTS)]


def more_poses(seed: int, known: str) -> list[dict[str, Any]]:
    """Results of a real bench with more and more poses, each set within the next one."""
    world, poses = draw_world(seed), nested_poses(seed)
    return [{"count": n, **judged(record(world, seed, poses[:n]), known, lens="right")} for n in COUNTS]


def more_knowledge(seed: int, poses: Sequence[Pose]) -> dict[str, dict[str, Any]]:
    """Results of a real bench by what is known."""
    bench = record(draw_world(seed), seed, poses)
    return {known: judged(bench, known, lens="right") for known in ("0", "r", "c", "cr")}


def steps(lines: Sequence[dict[str, Any]], what: str) -> list[float]:
    """U of each result over U of the one before; refusals are left out."""
    u = [line["U"][what] for line in lines if "refused" not in line]
    return [after / before for before, after in pairwise(u)]
