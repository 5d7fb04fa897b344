"""How accurately and how fast stars are found in simulated recordings of 33 ms, compared with the simulated truth.

The table has a row for each waveform of the light, level of noise and kind of image: the automatically chosen one, and
the last polarity of the published method. The columns are, over some random poses (roll 0 to 360 degrees): the rms error
of the centres per axis; the z-score of the centres by their covariances; complete stars that were missed; stars that are
wrong by more than half a pixel; CPU seconds of one core for detection (median view).

    python tests/benchmarks/bench_stars.py [--poses 10] [--r 280] [--half-angle 16] [--pictures FOLDER]

With a collimator of 280 mm, stars are 48 px apart, and 318 or more of them are complete in each view if the disc is wide
enough. ``--pictures`` draws, for the first pose of each row, the event image with its stars and, next to it, their
errors, enlarged 500 times (red: more than 0.04 px).
"""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from calib.errors import CalibrationError
from calib.events.event_image import EventImages, make_images
from calib.events.flicker import Flicker
from calib.events.grey_image import to_uint8
from calib.stars.detect import detect_view
from calib.view import View
from simulators.optics.picture import TARGET, pose_rotation, project, render, star_centres
from simulators.pixels.sensor import simulate
from simulators.world.truth import NOISE_LEVELS, CollimatorTruth, Truth
from simulators.world.world import LightState

WINDOW_US = 33_000.0
IMAGES = ("best", "last-polarity")
SCALE, FAR_PX = 500, 0.04
"""Enlargement of drawn errors, and error from which they are red, px."""


def record(truth: Truth, noise: str, waveform: Any, rotation: Any, seed: int) -> EventImages:
    """Return the event images of a simulated recording."""
    light = LightState(waveform=waveform, output=True, sync=True)
    phase = float(np.random.default_rng(seed).random())
    picture = render(truth, rotation)
    events = simulate(
        picture, light, WINDOW_US, phase=phase, noise=NOISE_LEVELS[noise], camera_seed=7, seed=seed
    )
    first_edge = -phase * light.period_us % light.period_us
    flicker = Flicker(light.period_us, first_edge, 0.5, 0.0, 2, 0, 0, "triggers")
    size = (truth.camera.width, truth.camera.height)
    return make_images(events.t, events.x, events.y, events.p, size, flicker, window_us=(0.0, WINDOW_US))


def whole_stars(truth: Truth, rotation: Any) -> Any:
    """Return the ids of the stars whose cells lie completely in the frame and in the bright part of the disc."""
    pitch_px = truth.camera.fx * TARGET.pitch_mm / truth.collimator.r
    ids, _ = star_centres(truth, rotation, clearance=0.72, border_px=pitch_px / math.sqrt(2.0))
    return ids


def measure(
    truth: Truth, images: EventImages, kind: str, rotation: Any
) -> tuple[View, Any, dict[str, float]]:
    """Return view, errors and figures of one pose for one kind of image."""
    image = images.best().image if kind == "best" else images.named(kind)
    begin = time.process_time()
    view = detect_view(image, TARGET)
    cpu_s = time.process_time() - begin
    errors = view.points_px - project(np.asarray(TARGET.positions_mm(view.ids)), rotation, truth)
    squares = np.einsum("ni,nij,nj->n", errors, np.linalg.inv(view.covariances_px2), errors) / 2.0
    whole = whole_stars(truth, rotation)
    return (
        view,
        errors,
        {
            "square": float((errors**2).sum()),
            "z_square": float(squares.sum()),
            "stars": len(view),
            "whole": len(whole),
            "missed": len(np.setdiff1d(whole, view.ids)),
            "wrong": int((np.linalg.norm(errors, axis=1) > 0.5).sum()),
            "cpu_s": cpu_s,
        },
    )


def draw(path: Path, image: Any, view: View, errors: Any) -> None:
    """Draw the event image with the stars found and, next to it, their enlarged errors with a scale."""
    seen = cv2.cvtColor(to_uint8(image), cv2.COLOR_GRAY2BGR)
    shown = np.full_like(seen, 255)
    for (x, y), error in zip(view.points_px, errors, strict=True):
        at = (round(x * 16), round(y * 16))
        cv2.circle(seen, at, 6 * 16, (0, 160, 0), 2, cv2.LINE_AA, 4)
        to = (at[0] + round(error[0] * SCALE * 16), at[1] + round(error[1] * SCALE * 16))
        far = float(np.linalg.norm(error)) > FAR_PX
        cv2.circle(shown, at, 2 * 16, (150, 150, 150), -1, cv2.LINE_AA, 4)
        cv2.line(shown, at, to, (0, 0, 220) if far else (90, 90, 90), 2, cv2.LINE_AA, 4)
    height, length = shown.shape[0], round(FAR_PX * SCALE)
    cv2.rectangle(shown, (10, height - 36), (length + 150, height - 8), (255, 255, 255), -1)
    cv2.line(shown, (20, height - 20), (20 + length, height - 20), (0, 0, 0), 3)
    cv2.putText(
        shown, f"{FAR_PX:.2f} px", (30 + length, height - 14), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (0, 0, 0), 1
    )
    cv2.imwrite(str(path), np.hstack([seen, shown]))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--poses", type=int, default=10)
    parser.add_argument("--r", type=float, default=280.0, help="mm, as r of the collimator")
    parser.add_argument("--half-angle", type=float, default=16.0, help="degrees, of the disc")
    parser.add_argument("--pictures", type=Path)
    options = parser.parse_args()
    truth = Truth(collimator=CollimatorTruth(r=options.r, half_angle_deg=options.half_angle))
    rng = np.random.default_rng(2)
    poses = [
        pose_rotation(
            {"pan": rng.uniform(-6, 6), "tilt": rng.uniform(-3, 3), "roll": rng.uniform(0, 360)}, truth.optics
        )
        for _ in range(options.poses)
    ]
    wholly = [len(whole_stars(truth, rotation)) for rotation in poses]
    print(f"stars wholly in view: {min(wholly)} to {max(wholly)}")
    print("drive   noise    image           rms px    z  missed/whole  wrong  stars  detection CPU s")
    for waveform in ("square", "sine"):
        for noise in ("clean", "typical", "heavy"):
            figures: dict[str, list[dict[str, float]]] = {kind: [] for kind in IMAGES}
            for number, rotation in enumerate(poses):
                images = record(truth, noise, waveform, rotation, seed=number + 1)
                for kind in IMAGES:
                    try:
                        view, errors, found = measure(truth, images, kind, rotation)
                    except CalibrationError as error:
                        print(f"        pose {number}: {kind}: {error}")
                        continue
                    figures[kind].append(found)
                    if options.pictures and number == 0:
                        options.pictures.mkdir(parents=True, exist_ok=True)
                        image = images.best().image if kind == "best" else images.named(kind)
                        draw(options.pictures / f"{waveform}-{noise}-{kind}.png", image, view, errors)
            for kind, found in figures.items():
                total = {key: sum(f[key] for f in found) for key in found[0]}
                rms = (total["square"] / total["stars"] / 2.0) ** 0.5
                z = (total["z_square"] / total["stars"]) ** 0.5
                cpu_s = np.median([f["cpu_s"] for f in found])
                print(
                    f"{waveform:7s} {noise:8s} {kind:14s} {rms:7.4f} {z:5.2f} {total['missed']:6.0f}/"
                    f"{total['whole']:<6.0f} {total['wrong']:5.0f} {total['stars']:6.0f} {cpu_s:8.2f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
