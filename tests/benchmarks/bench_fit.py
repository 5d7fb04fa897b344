"""Measure how much CPU time a calibration takes, beside an older checkout and OpenCV's planar fit, in one run.

    python tests/benchmarks/bench_fit.py [--old CHECKOUT] [--rounds N] [--data FOLDER]

Each round starts one process for each checkout in turn, so that both meet the same load. Needs the recordings published
with "Camera Calibration using a Collimator System" (ECCV 2024), set data1; FOLDER contains their folder
``collimator_real``. The times are of the first calibration of fresh views. Values must agree to 1e-6 relative.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

HERE = Path(__file__).parents[2]
CASES = {
    "spherical, 20 views": ("spherical", 20),
    "spherical, 3 views": ("spherical", 3),
    "auto, 20 views": ("auto", 20),
}
OPENCV = "OpenCV, planar, 20 views"


def measure(data: Path) -> None:
    """Print CPU seconds, fx and its sigma of each case as JSON. Runs in a process of its own."""
    import cv2
    import numpy as np

    from calib.engine import CalibrationOptions, calibrate
    from calib.view import View

    cv2.setNumThreads(1)
    views = []
    for i in range(1, 21):
        table = np.loadtxt(data / "collimator_real" / f"image{i}.txt", ndmin=2)
        ids, points = table[:, 4].astype(np.int64), table[:, :2] - 0.5
        covariances = np.tile(np.eye(2), (len(table), 1, 1))
        views.append(View(f"image{i}", (2448, 2048), ids, points, table[:, 2:4], covariances))
    calibrate(views[:3])  # imports and caches
    found = {}
    for case, (model, count) in CASES.items():
        chosen = views if count == 20 else [views[i] for i in (0, 7, 14)]
        fresh = [replace(view) for view in chosen]
        began = time.process_time()
        result = calibrate(fresh, CalibrationOptions(model=model))
        found[case] = [time.process_time() - began, result.camera.fx, result.sigma["fx"]]
    began = time.process_time()
    points = [np.column_stack([view.target_mm, np.zeros(len(view))]).astype(np.float32) for view in views]
    images = [view.points_px.astype(np.float32) for view in views]
    rms, matrix, *_ = cv2.calibrateCamera(points, images, (2448, 2048), None, None, flags=cv2.CALIB_FIX_K3)
    found[OPENCV] = [time.process_time() - began, matrix[0, 0], rms]
    print(json.dumps(found))


def one(checkout: Path, data: Path) -> dict[str, list[float]]:
    """Return what `measure` prints for a checkout."""
    environment = os.environ | {
        "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
        "PYTHONPATH": str(checkout),
    }
    words = [sys.executable, str(Path(__file__)), "--measure", "--data", str(data)]
    said = subprocess.run(words, cwd=checkout, env=environment, capture_output=True, text=True, check=True)
    return json.loads(said.stdout)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--old", type=Path, help="an older checkout to compare with")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--data", type=Path, default=os.environ.get("STARBENCH_REFERENCE_DATA"))
    parser.add_argument("--measure", action="store_true", help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.data is None:
        parser.error("give --data FOLDER, or set STARBENCH_REFERENCE_DATA")
    if not (chosen.data / "collimator_real").is_dir():
        parser.error(f"{chosen.data}: it contains no folder collimator_real")
    if chosen.measure:
        measure(chosen.data)
        return
    sides = {"new": HERE} | ({"old": chosen.old.resolve()} if chosen.old else {})
    rounds = [
        {side: one(path, chosen.data.resolve()) for side, path in sides.items()} for _ in range(chosen.rounds)
    ]
    for case in (*CASES, OPENCV):
        best = {side: min(each[side][case][0] for each in rounds) for side in sides}
        text = f"{case:26}" + "".join(f"  {side} {seconds:6.3f} s" for side, seconds in best.items())
        if "old" in best:
            new, old = rounds[0]["new"][case], rounds[0]["old"][case]
            apart = max(abs(a - b) / abs(b) for a, b in zip(new[1:], old[1:], strict=True))
            text += f"  ratio {best['old'] / best['new']:4.2f}  values differ by {apart:.1e}"
        print(text)


if __name__ == "__main__":
    main()
