"""Benches drawn at random: views and gimbal readings of a simulated camera, without images.

The stars come from the simulators' optics with Gaussian noise, so that a bench takes milliseconds. Errors of finding
stars in event images are not in these views; `tests/hil` has those. The gimbal has either simple noise
(`GimbalErrors`) or the errors of the simulators' own section (`GimbalTruth`).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.model.rotation import exp_map
from calib.view import View
from simulators.optics import picture as optics
from simulators.world.drift import drift_since_on_arcsec
from simulators.world.gimbal import Gears, GimbalTruth
from simulators.world.truth import (
    COLLIMATORS,
    CameraTruth,
    CollimatorTruth,
    MountTruth,
    OpticsTruth,
    ReticleTruth,
    Truth,
)

FloatArray = NDArray[np.float64]

STAR_SIGMA_PX = 0.014
SCALE_SIGMA = 2e-4  # Of the axes of a gimbal, as its station states it
BORDER_PX = 14.0
#: Time from pose to pose, s.
POSE_S = 30.0


def grid(pan_deg: Sequence[float], tilt_deg: Sequence[float]) -> list[dict[str, float]]:
    """Return the poses of a grid, degrees.

    pan_deg, tilt_deg: Angles of each axis, degrees; pan changes fastest.
    Returns: Poses with ``pan`` and ``tilt``.
    """
    return [{"pan": float(p), "tilt": float(t)} for t in tilt_deg for p in pan_deg]


THREE = [{"pan": -6.0, "tilt": 2.0}, {"pan": 6.0, "tilt": 2.0}, {"pan": 0.0, "tilt": -3.0}]
NINE = grid((-6, 0, 6), (-2.5, 0, 2.5))
TWENTY_FIVE = grid((-6, -3, 0, 3, 6), (-2.5, -1.25, 0, 1.25, 2.5))
POSES: Mapping[int, Sequence[Mapping[str, float]]] = {3: THREE, 9: NINE, 25: TWENTY_FIVE}


@dataclass(frozen=True)
class GimbalErrors:
    """Errors of the readings of a gimbal, each 1 sigma."""

    reading_sigma_deg: float = 0.002  # Noise of a reading, and of the rotation about each axis
    scale: float = 0.0  # Relative scale error of each axis


@dataclass(frozen=True)
class DrawnBench:
    """A drawn bench."""

    truth: Truth
    views: list[View] = field(repr=False)  # Views of the poses, in their order
    readings_deg: list[dict[str, float]] = field(repr=False)  # Readings of the axes for each view, degrees
    camera_from_head: FloatArray = field(repr=False)  # (3, 3) how the camera is mounted


def gimbal_truth(rng: np.random.Generator, seed: int | None = None) -> GimbalTruth:
    """Draw the errors of a gimbal, of the sizes that its readings state."""
    return GimbalTruth(
        wobble_deg=0.001,
        eccentricity_deg=0.001,
        scale=tuple((SCALE_SIGMA * rng.normal(size=3)).tolist()),
        backlash_deg=(0.001, 0.001, 0.001),
        nonorthogonality_deg=float(0.02 * rng.normal()),
        reading_sigma_deg=0.002,
        seed=int(rng.integers(1, 2**30)) if seed is None else seed,
    )


def draw_bench(
    profile: str | CollimatorTruth,
    poses: Sequence[Mapping[str, float]],
    seed: int,
    *,
    errors: GimbalErrors | None = None,
    camera: CameraTruth | None = None,
    star_sigma_px: float = STAR_SIGMA_PX,
    noise_seed: int = 0,
    common_share: float = 0.0,
    gimbal: GimbalTruth | None = None,
    reticle: ReticleTruth | None = None,
    mount: MountTruth | None = None,
) -> DrawnBench:
    """Draw glass, mounting, noise and gimbal errors of a bench from a seed.

    profile: Name of a collimator's profile, or the collimator.
    poses: Angles ``pan``, ``tilt``, ``roll`` of the poses, degrees: the true ones, or the readings if
      `gimbal` is given.
    errors: Simple errors of the gimbal; None for noise of .002 degrees. They have no effect if `gimbal` is
      given.
    camera: The camera; None for the paper's.
    star_sigma_px: Noise of a star per axis, px.
    common_share: Share of the noise's variance that all recordings of a pose have in common, whatever
      `noise_seed` is.
    gimbal: Errors of the gimbal as the simulated bench has them; None for `errors`.
    reticle: Errors of the print; None for a flat print without errors.
    mount: Drift of the mount; its vibration and shift have no effect. None for no drift. A pose is recorded
      every `POSE_S`.
    """
    noise = np.random.default_rng((seed, 8, noise_seed))
    common = np.random.default_rng((seed, 9))
    rng = np.random.default_rng((seed, 7))
    errors = errors or GimbalErrors()
    collimator = COLLIMATORS[profile] if isinstance(profile, str) else profile
    mounting = rng.normal((0.0, 0.0, 10.0), 0.25)
    truth = Truth(
        camera or CameraTruth(),
        replace(collimator, glass_seed=seed + 1000),
        OpticsTruth(mounting_deg=tuple(mounting.tolist())),
        mount=mount or MountTruth(),
        reticle=reticle or ReticleTruth(),
        gimbal=gimbal or GimbalTruth(),
    )
    head = exp_map(np.radians(rng.normal(0.0, 1.0, 3)))
    scales = np.ones(3) if gimbal else 1.0 + errors.scale * rng.normal(size=3)
    views, readings = [], []
    for number, (pose, angles) in enumerate(zip(poses, _loads(poses, truth), strict=True), 1):
        wobble = np.eye(3)
        if gimbal is None:
            wobble = exp_map(np.radians(errors.reading_sigma_deg) * rng.normal(size=3))
        rotation = np.asarray(head @ wobble @ optics.true_rotation(angles, truth))
        views.append(seen_view(truth, rotation, f"pose {number}", noise, star_sigma_px, common, common_share))
        readings.append(
            {
                f"{axis}_deg": pose.get(axis, 0.0) / scale
                for axis, scale in zip(("pan", "tilt", "roll"), scales, strict=True)
                if axis != "roll" or any("roll" in pose for pose in poses)
            }
        )
    return DrawnBench(truth, views, readings, head)


def draw_repeats(
    profile: str | CollimatorTruth, poses: Sequence[Mapping[str, float]], seed: int, times: int, **drawn: Any
) -> DrawnBench:
    """Draw a bench that records each pose several times, one round after the other.

    Glass, mounting and gimbal errors are the same in every round. The stars' noise is new, apart from the common share.

    profile, poses, seed: As for `draw_bench`.
    drawn: Further parameters of `draw_bench`, without `noise_seed`.
    Returns: Bench with ``times * len(poses)`` views.
    """
    rounds = [draw_bench(profile, poses, seed, noise_seed=number, **drawn) for number in range(times)]
    views = [
        replace(view, name=f"{view.name} round {number}" if number > 1 else view.name)
        for number, bench in enumerate(rounds, 1)
        for view in bench.views
    ]
    readings = [pose for bench in rounds for pose in bench.readings_deg]
    return DrawnBench(rounds[0].truth, views, readings, rounds[0].camera_from_head)


def _loads(poses: Sequence[Mapping[str, float]], truth: Truth) -> list[dict[str, float]]:
    """Return the angles of the loads in each pose, degrees: behind the backlash, and with the drift of the mount."""
    gears, loads = Gears(truth.gimbal), []
    for number, pose in enumerate(poses):
        drift = dict(zip(("pan", "tilt"), drift_since_on_arcsec(truth.mount, POSE_S * number), strict=True))
        behind = gears.load_angles_deg(pose)
        loads.append({axis: angle + drift.get(axis, 0.0) / 3600.0 for axis, angle in behind.items()})
    return loads


def seen_view(
    truth: Truth,
    rotation: FloatArray,
    name: str,
    rng: np.random.Generator,
    star_sigma_px: float,
    common: np.random.Generator | None = None,
    common_share: float = 0.0,
) -> View:
    """Return the stars that the camera sees in a pose, with noise.

    rotation: (3, 3) camera <- target.
    star_sigma_px: Noise of a star per axis, px.
    common: Source of the noise that all recordings of the pose have in common; None if there is none.
    """
    c = truth.collimator
    half_rim = 0.5 * c.rim * c.r * math.tan(math.radians(c.half_angle_deg)) / optics.TARGET.pitch_mm
    ids, points = optics.star_centres(truth, rotation, border_px=BORDER_PX, clearance=half_rim)
    noisy = points + rng.normal(0.0, star_sigma_px * math.sqrt(1.0 - common_share), points.shape)
    if common is not None and common_share > 0.0:
        noisy = noisy + common.normal(0.0, star_sigma_px * math.sqrt(common_share), points.shape)
    covariances = np.tile(np.eye(2) * star_sigma_px**2, (len(ids), 1, 1))
    size = (truth.camera.width, truth.camera.height)
    return View(name, size, ids, noisy, np.asarray(optics.TARGET.positions_mm(ids)), covariances)
