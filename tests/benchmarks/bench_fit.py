"""CPU time of a fit by the joint adjustment, and by OpenCV's planar calibration of the same views.

    python tests/benchmarks/bench_fit.py [--poses 3 9 20] [--seeds 0-3] [--worlds polynomial product S1]

For each world and number of poses, the median over the seeds and the 95th percentile, s. ``cr``: certificate and bounded readings; a mount
moved by hand (S1) has neither. OpenCV's ``calibrateCamera`` gets the same stars, and the same two coefficients.
"""

from __future__ import annotations

import time
from itertools import product

import cv2
import measured
import numpy as np
from worlds.bench import GRID, POSES, Bench
from worlds.catalogue import WORLDS
from worlds.knowledge import options_for, views_of

from calib.engine import calibrate


def drawn(world: str, poses: int, seed: int) -> Bench:
    """Draw a bench; of more poses than a sequence has, the first of the grid."""
    bench = WORLDS[world](seed, poses if poses in POSES else len(GRID), 1, 0)
    bench.views[poses:], bench.readings_deg[poses:] = [], []
    return bench


def seconds(world: str, poses: int, seed: int) -> tuple[float, float]:
    """CPU time of the joint adjustment and of OpenCV's calibration."""
    bench = drawn(world, poses, seed)
    views, options = views_of(bench), options_for(bench, "0" if world.endswith(("S1", "S2")) else "cr")
    begun = time.process_time()
    calibrate(views, options)
    fitted = time.process_time()
    plane = [np.column_stack([v.target_mm, np.zeros(len(v))]).astype(np.float32) for v in views]
    cv2.calibrateCamera(
        plane,
        [v.points_px.astype(np.float32) for v in views],
        views[0].image_size,
        np.eye(3),
        np.zeros(5),
        flags=cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST,
    )
    return fitted - begun, time.process_time() - fitted


def main() -> None:
    parser = measured.options(__doc__)
    parser.add_argument("--poses", nargs="+", type=int, default=[3, 9, 20])
    parser.add_argument("--seeds", type=measured.seeds, default="0-3")
    parser.add_argument("--worlds", nargs="+", default=["polynomial", "product", "S1"], choices=WORLDS)
    given = parser.parse_args()
    seconds("polynomial", 3, 0)  # imports and compiled loops
    spreads = {
        f"{world}, {poses}": [
            measured.spread(part)
            for part in zip(*(seconds(world, poses, seed) for seed in given.seeds), strict=True)
        ]
        for world, poses in product(given.worlds, given.poses)
    }
    names = ("world, poses", "joint adjustment", "95 %", "OpenCV, planar", "95 %")
    print(f"| {' | '.join(names)} |\n|{' --- |' * len(names)}")
    for name, (joint, planar) in spreads.items():
        print(f"| {name} | {joint.cells(2)} | {planar.cells(2)} |")


if __name__ == "__main__":
    measured.run(main, "costs", "A fit")
