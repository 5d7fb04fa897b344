"""Residuals of the simulated collimator "like-real" beside those of the recordings it is to resemble.

    python tests/support/like_real.py FOLDER [--glasses 8]

prints the table of docs/simulated-bench.md; FOLDER holds the published recordings (image1.txt to image20.txt). The
simulated camera is turned as the recorded one was. Its discs of light are those of the recordings, or drawn as the
profile says; pieces of glass are numbered from 1, so that the same command prints the same numbers.
"""

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib import Calibration, CalibrationOptions, View, calibrate
from calib.calibration import ModelName
from calib.model.beam import visible_discs
from calib.model.rim_fit import Disc
from simulators.optics import picture as optics
from simulators.world.truth import COLLIMATORS, CameraTruth, CollimatorTruth, OpticsTruth, Truth
from tests.benchmarks.worlds.recordings import SIZE, read

FloatArray = NDArray[np.float64]
Figures = dict[str, float]

CAMERA = CameraTruth(2412.0, 2411.4, 1220.0, 1007.0, k1=-0.0895, k2=0.106, width=SIZE[0], height=SIZE[1])
X_MM, Y_MM, R_MM, HALF_ANGLE_DEG = 95.2, 136.9, 256.0, 12.5
"""The recorded collimator's centre, and its disc."""
OPTICS = OpticsTruth(mounting_deg=(0.0, 0.0, 0.0))
IDEAL = COLLIMATORS["ideal"]
STAR_SIGMA_PX = 0.007
BORDER_PX = 20.0
EDGE = 1.04
"""Where the light ends, in radii of the disc that best parts stars seen from stars not seen."""
OUTER = 0.9
MODELS: tuple[ModelName, ...] = ("spherical", "joint", "planar")


class Recorded(NamedTuple):
    """The recordings, and what simulated ones take from them: turns (N, 3, 3), and discs."""

    views: list[View]
    rotations: FloatArray
    discs: list[Disc]


def recordings(folder: Path) -> Recorded:
    """Read the recordings; turns are those that the joint adjustment finds."""
    views = read(folder)
    rotations = np.asarray(calibrate(views, CalibrationOptions()).rotations)
    return Recorded(views, rotations, visible_discs(views))


def simulated(
    recorded: Recorded, glass: int, *, own_discs: bool = False, profile: CollimatorTruth | None = None
) -> list[View]:
    """Views through one piece of glass, the camera turned as in the recordings.

    own_discs: Whether discs are drawn as the profile says; else they are those of the recordings.
    profile: The collimator, "like-real" by default.
    """
    rng = np.random.default_rng(glass)
    profile = profile or COLLIMATORS["like-real"]
    collimator = replace(profile, x=X_MM, y=Y_MM, r=R_MM, half_angle_deg=HALF_ANGLE_DEG, glass_seed=glass)
    half_rim = 0.5 * collimator.rim * 55.0 / optics.TARGET.pitch_mm
    views = []
    for number, (rotation, disc) in enumerate(zip(recorded.rotations, recorded.discs, strict=True), 1):
        truth = Truth(CAMERA, collimator if own_discs else _with_disc(collimator, disc), OPTICS)
        ids, points = optics.star_centres(truth, rotation, border_px=BORDER_PX, clearance=-half_rim)
        views.append(_seen(str(number), ids, points + rng.normal(0.0, STAR_SIGMA_PX, points.shape)))
    return views


def figures(views: Sequence[View]) -> Figures:
    """Statistics of the residuals and of the free centres, by name: px, drift in % of r, focal gaps in %."""
    discs = visible_discs(views)
    fits = {name: calibrate(views, CalibrationOptions(model=name, loss="l2")) for name in MODELS}
    spherical, joint, planar = fits.values()
    numbers: Figures = {f"{name}_rms": fit.rms_px for name, fit in fits.items()}
    numbers |= {f"{name}_left_out": float(fit.left_out_rms_px or math.nan) for name, fit in fits.items()}
    rho = np.concatenate(
        [
            np.linalg.norm(view.target_mm - disc.centre_mm, axis=1) / disc.radius_mm
            for view, disc in zip(views, discs, strict=True)
        ]
    )
    numbers |= {f"{name}_outer_tenth": _share(fit, rho > OUTER) for name, fit in fits.items()}
    assert spherical.collimator is not None
    drift = 100.0 * planar.centres / spherical.collimator.r
    places = np.array([disc.centre_mm for disc in discs])
    numbers |= {f"drift_{axis}": float(drift[:, k].std()) for k, axis in enumerate("xyz")}
    numbers |= {
        f"disc_{axis}": float(np.corrcoef(drift[:, k], places[:, k])[0, 1]) for k, axis in enumerate("xy")
    }
    numbers["stars"], numbers["beyond"] = float(len(rho)), float(np.mean(rho > 1.0))
    numbers["planar_focal_gap"] = 100.0 * (planar.camera.fx / joint.camera.fx - 1.0)
    numbers["spherical_focal_gap"] = 100.0 * (spherical.camera.fx / joint.camera.fx - 1.0)
    return numbers


def mean_and_scatter(several: Sequence[Figures]) -> tuple[Figures, Figures]:
    """Mean and standard deviation of each figure."""
    mean = {name: float(np.mean([figures_of[name] for figures_of in several])) for name in several[0]}
    return mean, {name: float(np.std([figures_of[name] for figures_of in several])) for name in several[0]}


def _seen(name: str, ids: NDArray[np.int64], points_px: FloatArray) -> View:
    """Put stars into a view, their covariances unknown."""
    covariances = np.tile(np.eye(2), (len(ids), 1, 1))
    return View(name, SIZE, ids, points_px, np.asarray(optics.TARGET.positions_mm(ids)), covariances)


def _with_disc(collimator: CollimatorTruth, disc: Disc) -> CollimatorTruth:
    """Give a collimator the disc of one recording."""
    x, y = (float(v) for v in disc.centre_mm)
    return replace(
        collimator,
        disc_x=x - collimator.x,
        disc_y=y - collimator.y,
        half_angle_deg=math.degrees(math.atan(EDGE * disc.radius_mm / collimator.r)),
        disc_walk=(0.0, 0.0),
        disc_wander_mm=0.0,
        disc_breathing=0.0,
    )


def _share(fit: Calibration, part: NDArray[np.bool_]) -> float:
    """Share of the squared error that some of the stars carry."""
    squares = np.concatenate([(residual**2).sum(axis=1) for residual in fit.residuals_px])
    return float(squares[part].sum() / squares.sum())


def _line(name: str, real: Mapping[str, float], columns: Sequence[tuple[Figures, Figures]]) -> str:
    """Write one row of the table."""
    cells = [f"{mean[name]:9.4f} +- {scatter[name]:.4f}" for mean, scatter in columns]
    return f"{name:22s} {real[name]:10.4f}  " + "  ".join(cells)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--glasses", type=int, default=8)
    options = parser.parse_args()
    recorded = recordings(options.folder)
    real = figures(recorded.views)
    columns = [
        mean_and_scatter(
            [figures(simulated(recorded, n, own_discs=own)) for n in range(1, options.glasses + 1)]
        )
        for own in (False, True)
    ]
    print(f"{'':22s} recordings  like-real, same discs  like-real, own discs")
    for name in real:
        print(_line(name, real, columns))


if __name__ == "__main__":
    main()
