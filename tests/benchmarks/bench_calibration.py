"""Measure how focal lengths scatter and agree, on published recordings and in simulation, and how long calibrations take.

    python tests/benchmarks/bench_calibration.py [LINE ...] [--data FOLDER]

Lines: ``sigmas``: stated over observed uncertainty, in random sets of views; ``crops`` and ``halves``: parts of the
data against all; ``passports``: from ten views, for one and for three others; ``triples`` of views; ``leftout``:
prediction of left-out views; ``times``: CPU time; ``simulated``: the paper's camera. All but the last need the
recordings published with "Camera Calibration using a Collimator System" (ECCV 2024), set data1; FOLDER contains their
folder ``collimator_real``.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

# Before numpy is loaded: on small matrices, threads of the linear algebra cost more than they gain.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from calib.engine import Calibration, CalibrationOptions, calibrate
from calib.fit import fit_model
from calib.model.passport import Passport
from calib.view import View

sys.path.append(str(Path(__file__).parents[1] / "support"))
from monte_carlo_runs import run_monte_carlo  # in a folder that only pytest adds to the path
from paper_camera import NARROW, POSES

SIZE, COUNT = (2448, 2048), 20
FIELD, COMA = CalibrationOptions(model="field"), CalibrationOptions(model="coma")
#: Two discs at one end of the frame, one at the other: what a drift of the centre harms least.
APART = [
    {"pan_deg": 5.7, "tilt_deg": -1.3},
    {"pan_deg": -6.1, "tilt_deg": 2.3},
    {"pan_deg": 3.6, "tilt_deg": -0.2},
]
Line = Callable[[Sequence[View]], None]


def read(path: Path) -> View:
    """Return a view of the published recordings, whose pixel coordinates start at a corner."""
    rows = np.loadtxt(path)
    covariances = np.tile(np.eye(2), (len(rows), 1, 1))
    return View(path.stem, SIZE, rows[:, 4].astype(np.int64), rows[:, :2] - 0.5, rows[:, 2:4], covariances)


def random_sets(views: Sequence[View], size: int, sets: int = 100) -> list[Calibration]:
    """Return calibrations of random sets of views."""
    rng = np.random.default_rng(202600 + size)
    chosen = [sorted(rng.choice(COUNT, size, replace=False)) for _ in range(sets)]
    return [calibrate([views[i] for i in one], FIELD) for one in chosen]


def sigmas(views: Sequence[View]) -> None:
    """Print stated sigmas over observed scatter, corrected for drawing without replacement."""
    for size in (3, 4, 5, 7, 10):
        found = random_sets(views, size)
        values, stated = (
            np.array(v) for v in ([c.values for c in found], [list(c.sigma.values()) for c in found])
        )
        scatter = values.std(axis=0, ddof=1) / np.sqrt(1 - size / COUNT)
        ratio = np.sqrt((stated**2).mean(axis=0)) / scatter
        k = np.array([c.coverage_factor for c in found])[:, None]
        covered = (np.abs(values - values.mean(axis=0)) <= k * stated).mean(axis=0)
        named = " ".join(f"{n} {r:.2f}" for n, r in zip(found[0].parameter_names, ratio, strict=True))
        print(
            f"sigmas, {size} views: {ratio.min():.2f} median {np.median(ratio):.2f} to {ratio.max():.2f}; ",
            end="",
        )
        print(f"k {np.median(k):.2f}, covered {covered.min():.0%} to {covered.max():.0%} | {named}")


def crops(views: Sequence[View]) -> None:
    """Print the focal length from the inner part of the beam, and from all of it."""
    for model in ("field", "coma"):
        whole = calibrate(views, CalibrationOptions(model=model))
        print(f"crops, {model}: all {focal_text(whole)}", end="")
        for share in (0.9, 0.8, 0.7, 0.6):
            inner = calibrate(views, CalibrationOptions(model=model, guard_band=share))
            print(f"; inner {share:.0%} {focal_text(inner)}", end="")
        print()


def halves(views: Sequence[View]) -> None:
    """Print the focal lengths from two halves of the views, and their difference in common sigmas."""
    rng = np.random.default_rng(9)
    shuffled = [rng.permutation(COUNT) for _ in range(10)]
    every = np.arange(COUNT)
    splits = {"first and second": (every[:10], every[10:]), "odd and even": (every[::2], every[1::2])}
    splits |= {f"random {i}": (np.sort(p[:10]), np.sort(p[10:])) for i, p in enumerate(shuffled, 1)}
    apart = []
    for name, both in splits.items():
        one, other = (calibrate([views[i] for i in half], COMA) for half in both)
        apart.append((one.camera.fx - other.camera.fx) / np.hypot(one.sigma["fx"], other.sigma["fx"]))
        print(
            f"halves, coma, {name}: {focal_text(one)} and {focal_text(other)}, apart {apart[-1]:+.2f} sigma"
        )
    print(f"halves: rms {np.sqrt(np.mean(np.square(apart))):.2f} sigma, most {np.abs(apart).max():.2f}")


def passports(views: Sequence[View]) -> None:
    """Print focal lengths of other views with a passport from ten views."""
    for model in ("field", "coma"):
        rng, single, triple = np.random.default_rng(11), [], []
        for _ in range(10):
            order = rng.permutation(COUNT)
            made = calibrate([views[i] for i in order[:10]], CalibrationOptions(model=model))
            options = CalibrationOptions(passport=made.passport())
            triples = [rng.choice(order[10:], 3, replace=False) for _ in range(10)]
            for found, sets in ((triple, triples), (single, [[i] for i in order[10:]])):
                found += [
                    calibrate([views[i] for i in one], options).camera.fx - made.camera.fx for one in sets
                ]
        print(f"passports, {model}: fx of 3 other views {rms(triple):.2f} px, of 1 {rms(single):.2f} px rms")


def triples(views: Sequence[View]) -> None:
    """Print the focal length from three views."""
    fx = np.array([c.camera.fx for c in random_sets(views, 3)])
    robust = 1.4826 * np.median(np.abs(fx - np.median(fx)))
    print(f"triples, field: std of fx {fx.std(ddof=1):.1f} px, robust {robust:.1f} px")


def leftout(views: Sequence[View]) -> None:
    """Print the residuals of left-out views, of which only the rotation was adjusted."""
    found = calibrate(views, CalibrationOptions(model="auto"))
    print(
        f"leftout: {found.left_out_rms_px:.3f} px rms by the model chosen, {found.model}; fx {focal_text(found)}"
    )


def times(views: Sequence[View]) -> None:
    """Print CPU seconds of calibrations of all views."""
    jobs: dict[str, Callable[[], Any]] = {
        "coma, with uncertainty": partial(fit_model, views, COMA, "coma"),
        "coma, every view left out too": partial(fit_model, views, COMA, "coma", leave_out=True),
        "model chosen": partial(calibrate, views, CalibrationOptions(model="auto")),
        "three views, spherical": partial(calibrate, views[:3], CalibrationOptions()),
        "three views, field": partial(calibrate, views[:3], FIELD),
    }
    for name, job in jobs.items():
        job()
        spent = []
        for _ in range(3):
            begun = time.process_time()
            job()
            spent.append(time.process_time() - begun)
        print(f"times: {name} {min(spent):.2f} s")


def simulated(_: Sequence[View]) -> None:
    """Print errors of fx over repeated calibrations of the paper's camera, with 0.05 px of noise."""
    exact = Passport(("x", "y", "r"), NARROW.collimator.values, np.eye(3) * 1e-8)
    plain = CalibrationOptions(loss="l2")
    wandering = replace(plain, model="drift", drift_mm=0.1)
    lines = {
        "three views": (POSES, plain, 0.0),
        "three views, passport": (POSES, CalibrationOptions(passport=exact), 0.0),
        "one view, passport": (POSES[:1], CalibrationOptions(passport=exact), 0.0),
        "three views, centre wandering by 0.1 mm": (POSES, wandering, 0.1),
        "three views far apart, centre wandering by 0.1 mm": (APART, wandering, 0.1),
        "three views, planar": (POSES, replace(plain, model="planar"), 0.0),
    }
    for name, (poses, options, drift_mm) in lines.items():
        study = run_monte_carlo(NARROW, poses, options, 200, 19, drift_mm=drift_mm)
        print(
            f"simulated: {name}: fx off by {study.scatter['fx']:.3g} px rms, stated over it {1 / study.z_rms['fx']:.2f}"
        )


def focal_text(found: Calibration) -> str:
    """Return the focal length with its sigma, as text."""
    return f"{found.camera.fx:.1f} +- {found.sigma['fx']:.1f} px"


def rms(numbers: Sequence[float]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(numbers))))


LINES: dict[str, Line] = {
    line.__name__: line for line in (sigmas, crops, halves, passports, triples, leftout, times, simulated)
}


def main() -> None:
    """Print the lines asked for, or all."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("lines", nargs="*", metavar="LINE", help=", ".join(LINES))
    parser.add_argument("--data", type=Path, default=os.environ.get("STARBENCH_REFERENCE_DATA"))
    words = parser.parse_args()
    unknown = sorted(set(words.lines) - set(LINES))
    if unknown:
        parser.error(f"no line is called {unknown[0]}; there are {', '.join(LINES)}")
    folder = words.data and words.data / "collimator_real"
    views = [read(folder / f"image{i}.txt") for i in range(1, COUNT + 1)] if folder else []
    for name in words.lines or LINES:
        if views or name == "simulated":
            LINES[name](views)
        else:
            print(f"{name}: the published recordings are not here; --data names their folder")


if __name__ == "__main__":
    main()
