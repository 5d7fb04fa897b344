"""Benches drawn at random: views and gimbal readings of a simulated camera, without images.

The stars come from the simulators' optics with Gaussian noise, so that a bench takes milliseconds. Errors of finding
stars in event images are not in these views; `tests/hil` has those.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from calib.model.rotation import exp_map
from calib.view import View
from simulators.optics import picture as optics
from simulators.world.truth import COLLIMATORS, CameraTruth, CollimatorTruth, OpticsTruth, Truth

FloatArray = NDArray[np.float64]

STAR_SIGMA_PX = 0.014
BORDER_PX = 14.0


def grid(pan_deg: Sequence[float], tilt_deg: Sequence[float]) -> list[dict[str, float]]:
    """Return the poses of a grid, degrees."""
    return [{"pan": float(p), "tilt": float(t)} for t in tilt_deg for p in pan_deg]


THREE = [{"pan": -6.0, "tilt": 2.0}, {"pan": 6.0, "tilt": 2.0}, {"pan": 0.0, "tilt": -3.0}]
NINE = grid((-6, 0, 6), (-2.5, 0, 2.5))
TWENTY_FIVE = grid((-6, -3, 0, 3, 6), (-2.5, -1.25, 0, 1.25, 2.5))
POSES: Mapping[int, Sequence[Mapping[str, float]]] = {3: THREE, 9: NINE, 25: TWENTY_FIVE}


@dataclass(frozen=True)
class GimbalErrors:
    """Errors of the readings of a gimbal, each 1 sigma.

    Attributes
    ----------
    reading_sigma_deg
        Noise of a reading, and of the rotation about each axis.
    scale
        Relative scale error of each axis.
    """

    reading_sigma_deg: float = 0.002
    scale: float = 0.0


@dataclass(frozen=True)
class DrawnBench:
    """A drawn bench.

    Attributes
    ----------
    truth
        Its true parameters.
    views
        Views of the poses, in their order.
    readings_deg
        Readings of the axes for each view, degrees.
    """

    truth: Truth
    views: list[View] = field(repr=False)
    readings_deg: list[dict[str, float]] = field(repr=False)


def draw_bench(
    profile: str | CollimatorTruth,
    poses: Sequence[Mapping[str, float]],
    seed: int,
    *,
    errors: GimbalErrors | None = None,
    camera: CameraTruth | None = None,
    star_sigma_px: float = STAR_SIGMA_PX,
    noise_seed: int = 0,
) -> DrawnBench:
    """Draw glass, mounting, noise and gimbal errors of a bench from a seed.

    Parameters
    ----------
    profile
        Name of a collimator's profile, or the collimator.
    poses
        True angles ``pan``, ``tilt``, ``roll`` of the poses, degrees.
    seed
        Seed of everything that is drawn.
    errors
        Errors of the gimbal; None for noise of .002 degrees.
    camera
        The camera; None for the paper's.
    star_sigma_px
        Noise of a star per axis, px.
    noise_seed
        Further seed of the stars' noise alone, for repeated recordings.
    """
    noise = np.random.default_rng((seed, 8, noise_seed))
    rng = np.random.default_rng((seed, 7))
    errors = errors or GimbalErrors()
    collimator = COLLIMATORS[profile] if isinstance(profile, str) else profile
    mounting = rng.normal((0.0, 0.0, 10.0), 0.25)
    truth = Truth(
        camera or CameraTruth(),
        replace(collimator, glass_seed=seed + 1000),
        OpticsTruth(mounting_deg=tuple(mounting.tolist())),
    )
    head = exp_map(np.radians(rng.normal(0.0, 1.0, 3)))
    scales = 1.0 + errors.scale * rng.normal(size=3)
    views, readings = [], []
    for number, pose in enumerate(poses, 1):
        wobble = exp_map(np.radians(errors.reading_sigma_deg) * rng.normal(size=3))
        rotation = np.asarray(head @ wobble @ optics.pose_rotation(pose, truth.optics))
        views.append(seen_view(truth, rotation, f"pose {number}", noise, star_sigma_px))
        readings.append(
            {
                f"{axis}_deg": pose.get(axis, 0.0) / scale
                for axis, scale in zip(("pan", "tilt", "roll"), scales, strict=True)
                if axis != "roll" or any("roll" in one for one in poses)
            }
        )
    return DrawnBench(truth, views, readings)


def seen_view(
    truth: Truth, rotation: FloatArray, name: str, rng: np.random.Generator, star_sigma_px: float
) -> View:
    """Return the stars that the camera sees in a pose, with noise."""
    c = truth.collimator
    half_rim = 0.5 * c.rim * c.r * math.tan(math.radians(c.half_angle_deg)) / optics.TARGET.pitch_mm
    ids, points = optics.star_centres(truth, rotation, border_px=BORDER_PX, clearance=half_rim)
    noisy = points + rng.normal(0.0, star_sigma_px, points.shape)
    covariances = np.tile(np.eye(2) * star_sigma_px**2, (len(ids), 1, 1))
    size = (truth.camera.width, truth.camera.height)
    return View(name, size, ids, noisy, np.asarray(optics.TARGET.positions_mm(ids)), covariances)
