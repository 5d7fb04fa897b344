"""The step `until` over drawn benches: poses needed, U reached, and error of fx and of the corners against the truth.

Runs are rehearsed: the states, choices and calibrations of a run, on star centres of the simulated bench's glass.

    python -m tests.benchmarks.bench_until [FIRST_SEED [COUNT]] [PATH=VALUE ...]

A setting is as for `starbench run --set`, for example ``sequence.steps.1.until.expanded_fx_px=4``.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from bench.base.clock import VirtualClock
from bench.extras.batch.rehearsal import rehearse_run
from bench.record.stored_calibration import camera_of
from calib.uncertainty.projection_uncertainty import camera_difference

CASES = ("simulated", "simulated_ideal")


def measure(station: str, seed: int, settings: dict[str, str]) -> dict[str, object]:
    """Rehearse one run, and compare its result with the truth."""
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        end = rehearse_run(
            "until_good",
            station,
            seed=seed,
            operator=None,
            folder=Path(folder) / "run",
            clock=VirtualClock(datetime(2026, 3, 1, tzinfo=UTC)),
            settings=settings,
        )
        if end.outcome is None:
            return {"end": f"{end.how}: {end.why}"}
        told = json.loads((Path(folder) / "run" / "results.json").read_text())
    last = told["untils"][-1]
    (fx,) = (row for row in told["comparison"] if row["name"] == "fx")
    values, size = told["calibration"]["camera"], told["calibration"]["image_size"]
    true = {row["name"]: row["truth"] for row in told["comparison"] if row["name"] in values}
    cameras = camera_of(values | true, size), camera_of(values, size)
    offset = np.linalg.norm(camera_difference(*cameras).offset_px, axis=2)
    return {
        "end": last["ended"],
        "poses": last["poses"],
        "U": last["now"]["expanded_fx_px"],
        "error": fx["error"],
        "U_corner": last["now"]["worst_corner_px"],
        "corner": float(offset[[0, 0, -1, -1], [0, -1, 0, -1]].max()),
        "s": time.perf_counter() - began,
    }


def main() -> None:
    """Print a line for each run, and the share of runs within U."""
    numbers = [int(word) for word in sys.argv[1:] if word.isdigit()]
    settings = dict(word.split("=", 1) for word in sys.argv[1:] if "=" in word)
    first, count = (*numbers, 101, 8)[:2] if len(numbers) > 1 else ((numbers or [101])[0], 8)
    for station in CASES:
        rows = []
        for seed in range(first, first + count):
            row = measure(station, seed, settings)
            rows.append(row)
            print(
                station,
                seed,
                *(f"{k} {v:.2f}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()),
                flush=True,
            )
        whole = [row for row in rows if "U" in row]
        inside = np.mean([abs(row["error"]) <= row["U"] for row in whole])
        corners = np.mean([row["corner"] <= row["U_corner"] for row in whole])
        print(f"{station}: fx within U in {inside:.0%}, corners in {corners:.0%} of {len(whole)} runs")


if __name__ == "__main__":
    main()
