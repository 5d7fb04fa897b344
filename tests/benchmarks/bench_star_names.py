"""Whether stars are ever taken for others: random poses, all rolls, the tag in view, cut, or out of view.

Images are drawn by the simulated optics and spoiled quickly (no readout): black and white as by thresholds with
mismatch and stray events, stepped as by event counts, or as by an 8-bit frame camera; at three levels of noise, with
either contrast, sharp to slightly out of focus. In some, the expected pose is given, a fifth of a square wrong.

    python tests/benchmarks/bench_star_names.py [--poses 1000] [--seed 1]

Prints views found and refused, stars found of those wholly in view, stars further off than half a pixel ("wrong"),
and the z-score of the centres.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.detect import detect
from calib.errors import CalibrationError
from calib.grid_map import fit_homography
from simulators.optics import TARGET, pose_rotation, project, render, star_centres
from simulators.truth import Truth

MISMATCH, STRAY, FRAME_NOISE = (0.03, 0.12, 0.25), (0.002, 0.03, 0.15), (2.0, 6.0, 15.0)


def spoil(image: NDArray[Any], rng: np.random.Generator) -> NDArray[Any]:
    """Make of a clean image one that an event or frame camera might give."""
    level, kind = rng.integers(3), rng.integers(3)
    uneven = MISMATCH[level] * rng.standard_normal(image.shape)
    if kind == 0:
        stray = rng.random(image.shape) < STRAY[level]
        spoiled = np.where(stray, rng.random(image.shape) < 0.5, image > 0.05 * np.exp(uneven)).astype(
            np.float32
        )
    elif kind == 1:
        events = np.floor(np.log(image / 0.01 + 1.0) / 0.5 * (1.0 + uneven))
        spoiled = (events + rng.poisson(STRAY[level], image.shape)).astype(np.float32)
    else:
        noise = FRAME_NOISE[level] * rng.standard_normal(image.shape)
        spoiled = np.clip(image * 180.0 + 20.0 + noise, 0, 255).astype(np.uint8)
    return spoiled.max() - spoiled if rng.random() < 0.5 else spoiled


def expectation(truth: Truth, rotation: Any, rng: np.random.Generator) -> NDArray[np.float64] | None:
    """Grid of stars as a pose would let expect it, a little wrong; None in three of ten."""
    ids, points = star_centres(truth, rotation)
    if len(ids) < 30 or rng.random() < 0.3:
        return None
    return fit_homography(TARGET.node_of(ids) + rng.uniform(-0.2, 0.2, 2), points)


def main() -> None:
    """Print what was found."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--poses", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    sums = dict.fromkeys(("found views", "refused views", "wrong stars", "whole stars", "missed stars"), 0)
    z_squares: list[float] = []
    cpu_s: list[float] = []
    for number in range(options.poses):
        optics = dataclasses.replace(Truth().optics, psf_px=float(rng.uniform(0.4, 1.0)))
        truth = dataclasses.replace(Truth(), optics=optics)
        pose = {"pan": rng.uniform(-9, 9), "tilt": rng.uniform(-6, 6), "roll": rng.uniform(0, 360)}
        rotation = pose_rotation(pose, optics)
        image = spoil(render(truth, rotation, subsamples=2), rng)
        expected = expectation(truth, rotation, rng)
        begin = time.process_time()
        try:
            view = detect(image, TARGET, expected=expected)
        except CalibrationError:
            sums["refused views"] += 1
            continue
        cpu_s.append(time.process_time() - begin)
        off = view.points_px - project(np.asarray(TARGET.positions_mm(view.ids)), rotation, truth)
        whole, _ = star_centres(truth, rotation, clearance=0.72, border_px=37.0)
        sums["found views"] += 1
        sums["wrong stars"] += int((np.linalg.norm(off, axis=1) > 0.5).sum())
        sums["whole stars"] += len(whole)
        sums["missed stars"] += len(np.setdiff1d(whole, view.ids))
        z_squares.append(
            float(np.einsum("ni,nij,nj->n", off, np.linalg.inv(view.covariances_px2), off).mean()) / 2.0
        )
        if number % 50 == 49:
            print(f"{number + 1} poses: {sums}", flush=True)
    print(
        f"{options.poses} poses: {sums}; z {np.mean(z_squares) ** 0.5:.3f}; median {np.median(cpu_s):.2f} CPU s a view"
    )


if __name__ == "__main__":
    main()
