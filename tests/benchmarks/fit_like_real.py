"""Fit the parameters of the simulated collimator "like-real" to recordings: Gauss-Newton on statistics of residuals.

Each step prints the parameters it begins at, the figures of the recordings and of the profile there, and the parameters
that the figures' slopes lead to; none is written anywhere. Pieces of glass keep their numbers from one evaluation to
the next, so that figures change by the parameters alone, and the same command prints the same numbers.

    python tests/benchmarks/fit_like_real.py FOLDER [--steps 1] [--glasses 4] [--processes 2]

The figures are those of ``tests/support/like_real.py``, through the recordings' own turns and discs.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from multiprocessing import Pool
from pathlib import Path
from typing import Any

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "support"))
import like_real  # it stands in a folder that only pytest knows

STEPS = {
    "defocus": 0.01,
    "coma": 0.01,
    "astigmatism": 0.01,
    "field_curvature": 0.01,
    "distortion": 0.01,
    "rim_roll_mm": 0.03,
    "irregularity_mm": 0.002,
    "rim_irregularity_mm": 0.006,
}
"""Parameters of the profile, and by how much each is changed to learn the slopes."""
TIGHT = 5.0
"""A parameter that the figures do not tell stays within so many of these steps (1 sigma) of where it begins."""
CLOSE = {
    "spherical_rms": 0.01,
    "field_rms": 0.008,
    "planar_rms": 0.006,
    "spherical_left_out": 0.015,
    "field_left_out": 0.012,
    "planar_left_out": 0.03,
    "spherical_outer_tenth": 0.01,
    "field_outer_tenth": 0.03,
    "planar_outer_tenth": 0.03,
    "drift_x": 0.02,
    "drift_y": 0.035,
    "drift_z": 0.006,
    "disc_x": 0.01,
    "disc_y": 0.05,
    "spherical_focal_gap": 0.08,
    "planar_focal_gap": 0.2,
}
"""How near each figure is to come to that of the recordings."""


def evaluate(job: tuple[like_real.Recorded, dict[str, float], int]) -> like_real.Figures:
    """Figures through one piece of glass."""
    recorded, values, glass = job
    profile: Any = replace(like_real.COLLIMATORS["like-real"], **values)
    return like_real.figures(like_real.simulated(recorded, glass, profile=profile))


def means(
    pool: Any, recorded: like_real.Recorded, points: Sequence[dict[str, float]], glasses: int
) -> list[like_real.Figures]:
    """Mean figures at each point."""
    jobs = [(recorded, point, glass) for point in points for glass in range(1, glasses + 1)]
    found = pool.map(evaluate, jobs, chunksize=1)
    groups = [found[n : n + glasses] for n in range(0, len(found), glasses)]
    return [like_real.mean_and_scatter(group)[0] for group in groups]


def main() -> None:
    """Print the steps."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--steps", type=int, default=1)
    parser.add_argument("--glasses", type=int, default=4)
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    recorded = like_real.recordings(options.folder)
    real = like_real.figures(recorded.views)
    close = np.array(list(CLOSE.values()))
    steps = np.array(list(STEPS.values()))
    start = np.array([getattr(like_real.COLLIMATORS["like-real"], name) for name in STEPS])
    at = start.copy()
    with Pool(options.processes) as pool:
        for _ in range(options.steps):
            points = [at, *(at + np.diag(steps))]
            found = means(pool, recorded, [dict(zip(STEPS, p, strict=True)) for p in points], options.glasses)
            off = np.array([[(one[name] - real[name]) for name in CLOSE] for one in found]) / close
            slopes = (off[1:] - off[0]).T / steps
            held = np.diag((TIGHT * steps) ** -2.0)
            at_next = at - np.linalg.solve(slopes.T @ slopes + held, slopes.T @ off[0] + held @ (at - start))
            print(f"sum of squares {off[0] @ off[0]:.1f}")
            for name in CLOSE:
                print(f"  {name:24s} {real[name]:9.4f} {found[0][name]:9.4f}")
            for name, value, to in zip(STEPS, at, at_next, strict=True):
                print(f"  {name:24s} {value:9.4f} -> {to:9.4f}", flush=True)
            at = at_next


if __name__ == "__main__":
    main()
