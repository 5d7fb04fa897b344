"""How exactly stars are found in simulated recordings of 33 ms, against the simulated truth, and how fast.

The table gives, for each drive of the light and level of noise, the rms error of the centres per axis over some
random poses (roll 0 to 360 degrees), by the automatically chosen image and by the published method's last
polarity; the z-score of the centres by their covariances; stars wholly in view that were missed; stars further
off than half a pixel ("wrong"); CPU seconds of one core for imaging and for detection.

    python tests/benchmarks/bench_stars.py [--poses 10] [--pictures FOLDER]

With ``--pictures`` the event image with its stars, and a map of their errors, is drawn for the first pose of each.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from calib.detect import detect
from calib.errors import CalibrationError
from calib.event_image import EventImages, make_images
from calib.flicker import Flicker
from calib.picture import to_uint8
from calib.view import View
from simulators.optics.picture import TARGET, pose_rotation, project, render, star_centres
from simulators.pixels.sensor import simulate
from simulators.world.truth import NOISE_LEVELS, Truth
from simulators.world.world import LightState

WINDOW_US = 33_000.0
TRUTH = Truth()
IMAGES = ("best", "last-polarity")


def record(noise: str, waveform: Any, rotation: Any, seed: int) -> EventImages:
    """Event images of a simulated recording."""
    light = LightState(waveform=waveform, output=True, sync=True)
    phase = float(np.random.default_rng(seed).random())
    picture = render(TRUTH, rotation)
    events = simulate(
        picture, light, WINDOW_US, phase=phase, noise=NOISE_LEVELS[noise], camera_seed=7, seed=seed
    )
    first_edge = -phase * light.period_us % light.period_us
    flicker = Flicker(light.period_us, first_edge, 0.5, 0.0, 2, 0, 0, "triggers")
    size = (TRUTH.camera.width, TRUTH.camera.height)
    return make_images(events.t, events.x, events.y, events.p, size, flicker, window_us=(0.0, WINDOW_US))


def measure(images: EventImages, kind: str, rotation: Any) -> tuple[View, Any, dict[str, float]]:
    """View, errors and figures of one pose by one kind of image."""
    image = images.best().image if kind == "best" else images.named(kind)
    begin = time.process_time()
    view = detect(image, TARGET)
    cpu_s = time.process_time() - begin
    errors = view.points_px - project(np.asarray(TARGET.positions_mm(view.ids)), rotation, TRUTH)
    squares = np.einsum("ni,nij,nj->n", errors, np.linalg.inv(view.covariances_px2), errors) / 2.0
    whole, _ = star_centres(TRUTH, rotation, clearance=0.72, border_px=37.0)
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
    """Event image with the stars found, and their errors 500 times as long."""
    picture = cv2.cvtColor(to_uint8(image), cv2.COLOR_GRAY2BGR)
    for (x, y), (dx, dy) in zip(view.points_px, errors, strict=True):
        at = (round(x * 8), round(y * 8))
        cv2.circle(picture, at, 40, (0, 200, 0), 1, cv2.LINE_AA, 3)
        cv2.line(
            picture,
            at,
            (round((x + 500 * dx) * 8), round((y + 500 * dy) * 8)),
            (0, 0, 255),
            1,
            cv2.LINE_AA,
            3,
        )
    cv2.imwrite(str(path), picture)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--poses", type=int, default=10)
    parser.add_argument("--pictures", type=Path)
    options = parser.parse_args()
    rng = np.random.default_rng(2)
    poses = [(rng.uniform(-6, 6), rng.uniform(-3, 3), rng.uniform(0, 360)) for _ in range(options.poses)]
    print("drive   noise    image           rms px    z  missed/whole  wrong  stars  detection CPU s")
    for waveform in ("square", "sine"):
        for noise in ("clean", "typical", "heavy"):
            figures: dict[str, list[dict[str, float]]] = {kind: [] for kind in IMAGES}
            for number, pose in enumerate(poses):
                rotation = pose_rotation(dict(zip(("pan", "tilt", "roll"), pose, strict=True)), TRUTH.optics)
                images = record(noise, waveform, rotation, seed=number + 1)
                for kind in IMAGES:
                    try:
                        view, errors, found = measure(images, kind, rotation)
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
