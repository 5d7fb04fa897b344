"""Whether stars are ever labelled wrongly: random poses, all rolls, the tag in view, cut, or out of view.

Each pose has a simulated recording of 33 ms (bright square or sine; clean, typical or heavy noise) or a simulated
photograph of 8 or 16 bit, with either contrast, sharp to slightly out of focus. In seven of ten poses the expected pose
is given, with an error of up to a fifth of a square.

    python tests/benchmarks/bench_star_names.py

The table lists, by the visible part of the tag: views labelled and refused, stars found of the complete ones, stars
wrong by more than half a pixel, and z-scores.
"""

import dataclasses
import time
from collections.abc import Sequence
from typing import Any

import measured
import numpy as np
from numpy.typing import NDArray
from star_scores import event_images, star_scores
from still_picture import simulate

from calib import CalibrationError, detect_view
from calib.model.homography import fit_homography
from simulators.optics.picture import TARGET, pose_rotation, project, render, star_centres
from simulators.world.truth import NOISE_LEVELS, Truth
from simulators.world.world import LightState

KINDS = ("square", "sine", "photo-8", "photo-16")
LEVELS = ("clean", "typical", "heavy")
READ_NOISE = {"clean": 0.01, "typical": 0.03, "heavy": 0.08}
WINDOW_US = 33_000.0
FURTHEST_DEG = 14.0
Pose = dict[str, Any]


def image_of(picture: NDArray[Any], kind: str, level: str, rng: np.random.Generator) -> NDArray[Any]:
    """Return the image of a picture that an event camera or a frame camera makes, with either contrast."""
    if kind.startswith("photo"):
        bits = int(kind.removeprefix("photo-"))
        noisy = 0.1 + 0.7 * picture + READ_NOISE[level] * rng.standard_normal(picture.shape)
        kind_of_grey = np.uint8 if bits == 8 else np.uint16
        image = np.round(np.clip(noisy, 0.0, 1.0) * (2**bits - 1)).astype(kind_of_grey)
    else:
        light = LightState(waveform=kind, output=True, sync=True)
        phase, seed = float(rng.random()), int(rng.integers(1 << 30))
        noise = NOISE_LEVELS[level]
        events = simulate(picture, light, WINDOW_US, phase=phase, noise=noise, camera_seed=7, seed=seed)
        size = picture.shape[1], picture.shape[0]
        image = event_images(events, light, phase, size, WINDOW_US).best().image
    return image.max() - image if rng.random() < 0.5 else image


def expected_by_pose(truth: Truth, rotation: Any, rng: np.random.Generator) -> NDArray[np.float64] | None:
    """Return the grid of stars expected by a pose, with a small error; None in three of ten poses."""
    ids, points = star_centres(truth, rotation)
    wrong = rng.uniform(-0.2, 0.2, 2)
    return None if rng.random() < 0.3 or len(ids) < 8 else fit_homography(TARGET.node_of(ids) + wrong, points)


def tag_seen(truth: Truth, rotation: Any) -> str:
    """Return how much of the tag lies in the frame and the disc: whole, cut, or none."""
    half = TARGET.tag_squares * TARGET.pitch_mm / 2.0
    steps = np.linspace(-half, half, 9)
    points = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2) + np.array(TARGET.tag_centre_mm)
    image = project(points, rotation, truth)
    collimator, camera = truth.collimator, truth.camera
    radius = collimator.r * np.tan(np.radians(collimator.half_angle_deg)) * (1.0 - collimator.rim)
    inside = np.hypot(*(points - [collimator.x, collimator.y]).T) <= radius
    inside &= ((image >= 0) & (image <= [camera.width - 1, camera.height - 1])).all(axis=1)
    return "whole" if inside.all() else "cut" if inside.any() else "none"


def try_pose(seed: int, number: int) -> Pose:
    """Simulate pose ``number``, find its stars, and compare them with the truth."""
    rng = np.random.default_rng([seed, number])
    optics = dataclasses.replace(Truth().optics, psf_px=float(rng.uniform(0.4, 1.0)))
    truth = dataclasses.replace(Truth(), optics=optics)
    off_axis_deg, towards = FURTHEST_DEG * rng.random() ** 0.5, rng.uniform(0, 2 * np.pi)
    across = off_axis_deg * np.array([np.cos(towards), np.sin(towards)])
    pose = {"pan": across[0], "tilt": across[1], "roll": rng.uniform(0, 360)}
    rotation = pose_rotation(pose, optics)
    kind, level = KINDS[rng.integers(len(KINDS))], LEVELS[rng.integers(len(LEVELS))]
    image = image_of(render(truth, rotation), kind, level, rng)
    expected = expected_by_pose(truth, rotation, rng)
    whole, _ = star_centres(truth, rotation, clearance=0.72, border_px=37.0)
    result: Pose = {"number": number, "kind": kind, "level": level, "tag": tag_seen(truth, rotation)}
    result |= {"expected": expected is not None, "whole": len(whole)}
    begin = time.process_time()
    try:
        view = detect_view(image, TARGET, expected=expected)
    except CalibrationError as error:
        return result | {"refused": str(error)}
    cpu_s = time.process_time() - begin
    return result | star_scores(view, truth, rotation, whole) | {"cpu_s": cpu_s}


def line_of(name: str, poses: Sequence[Pose]) -> str:
    """Return one line of the table."""
    named = [p for p in poses if "stars" in p]
    stars, whole = sum(p["stars"] for p in named), sum(p["whole"] for p in named)
    missed, wrong = sum(p["missed"] for p in named), sum(p["wrong"] for p in named)
    share = 100.0 * (1.0 - missed / max(whole, 1))
    z, rms = (sum(p[key] for p in named) / max(stars, 1) for key in ("z_square", "square"))
    took = measured.spread([p["cpu_s"] for p in named] or [0.0])
    return (
        f"{name:26s} {len(poses):6d} {len(named):6d} {len(poses) - len(named):7d} {whole:7d} {missed:6d} {share:7.2f} "
        f"{wrong:5d} {z**0.5:5.2f} {(rms / 2) ** 0.5:7.4f} {took.median_s:6.2f} {took.p95_s:5.2f}"
    )


def table(poses: Sequence[Pose]) -> str:
    """Return the table by the visible part of the tag."""
    lines = [
        "                            poses  found refused   whole missed found %  wrong     z  rms px  CPU s  95 %"
    ]
    for tag in ("whole", "cut", "none"):
        for expected in (True, False):
            of = [p for p in poses if (p["tag"], p["expected"]) == (tag, expected)]
            lines.append(line_of(f"tag {tag}, {'pose given' if expected else 'no pose'}", of))
    return "\n".join([*lines, line_of("all", poses)])


def main() -> None:
    """Print the table."""
    measured.options(__doc__).parse_args()
    print(table([try_pose(1, number) for number in range(1000)]))


if __name__ == "__main__":
    measured.run(main, "stars", "Stars that are named wrongly")
