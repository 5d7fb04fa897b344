"""Calibrates a simulated camera many times, and counts how often the stated uncertainty covers the truth.

    python tests/benchmarks/bench_coverage.py [--sequence nine_pose] [--runs 200] [--model spherical] [--kept FILE]

Noise, drift and outliers are drawn on the views that the sequence is expected to give (Monte Carlo method, JCGM 101). U of
the joint adjustment also covers faults of the bench, which are not drawn; U of the spherical model covers noise alone.
Results are kept in a file: after Ctrl-C, the same command continues.
"""

from __future__ import annotations

import dataclasses
import sys
from functools import lru_cache
from pathlib import Path
from typing import Any

import measured
import monte_carlo

from bench.base.program import forms
from bench.plan.plan import load_documents, make_plan
from bench.solve.forecasts import expected_bench
from calib.calibration import CalibrationOptions


@lru_cache
def planned(sequence: str, station: str) -> tuple[Any, list[dict[str, float]]]:
    """Return the expected bench, and the poses of a sequence in degrees."""
    plan = make_plan(*load_documents(sequence, station))
    poses = [{f"{axis}_deg": angle for axis, angle in pose.angles_deg.items()} for pose in plan.poses]
    return expected_bench(plan.station), poses


def do(*key: Any) -> dict[str, Any]:
    """Calibrate once."""
    sequence, station, model, drift_mm, outliers, seed, run, _ = key
    bench, poses = planned(sequence, station)
    result = monte_carlo.calibrate_once(
        bench, poses, CalibrationOptions(model), seed, run, drift_mm=drift_mm, outliers=outliers
    )
    return {"key": key, "result": dataclasses.asdict(result)}


def main() -> int:
    parser = measured.options(__doc__)
    parser.add_argument("--sequence", default="three_pose")
    parser.add_argument("--station", default="simulated")
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--drift-mm", type=float, default=0.0)
    parser.add_argument("--outliers", type=float, default=0.0)
    parser.add_argument("--model", default="joint", choices=("joint", "spherical", "planar"))
    parser.add_argument("--kept", type=Path, default=Path("coverage.jsonl"))
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    drawn = (given.sequence, given.station, given.model, given.drift_mm, given.outliers, given.seed)
    asked = [(*drawn, run, forms()["program"]) for run in range(given.runs)]
    done = measured.kept(given.kept, lambda line: tuple(line["key"]))
    measured.add_missing(given.kept, done, asked, do, given.jobs)
    results = [monte_carlo.Repetition(**done[key]["result"]) for key in asked]
    study = monte_carlo.study_of(planned(given.sequence, given.station)[0], results)
    low, high = study.coverage_band
    print("| parameter | error, rms | stated, mean | ratio | within U |\n| --- | --: | --: | --: | --: |")
    for name, stated in zip(study.names, study.sigmas.mean(axis=0).tolist(), strict=True):
        numbers = f"{study.scatter[name]:.4g} | {stated:.4g} | {study.z_rms[name]:.2f}"
        print(f"| {name} | {numbers} | {study.coverage[name]:.1%} |")
    print(f"\n{len(study.values)} calibrations by {given.model}, {len(study.failed)} failed.")
    print(f"A correct U covers the truth in {low:.1%} to {high:.1%} of them.")
    return int(min(study.coverage.values()) < low)


if __name__ == "__main__":
    sys.exit(main())
