"""How accurately and how fast stars are found in simulated recordings of 33 ms, compared with the simulated truth.

The table has a row for each waveform of the light, level of noise and kind of image: the automatically chosen one, and
the last polarity of the published method. The columns are, over some random poses (roll 0 to 360 degrees): the rms error
of the centres per axis; the z-score of the centres by their covariances; complete stars that were missed; stars that are
wrong by more than half a pixel; CPU seconds of one core for detection (median view, and 95th percentile).

    python tests/benchmarks/bench_stars.py [--write]

The pitch of stars is 48 px.
"""

import time
from typing import Any

import measured
import numpy as np
from short_recordings import images_of, record
from star_scores import random_pose, star_scores, whole_stars

from calib import CalibrationError, detect_view
from calib.events.event_image import EventImages
from simulators.optics.picture import TARGET, pose_rotation
from simulators.world.truth import NOISE_LEVELS, CollimatorTruth, Truth

IMAGES = ("best", "last-polarity")


def measure(truth: Truth, images: EventImages, kind: str, rotation: Any) -> dict[str, float]:
    """Return the figures of one pose for one kind of image."""
    image = images.best().image if kind == "best" else images.named(kind)
    begin = time.process_time()
    view = detect_view(image, TARGET)
    cpu_s = time.process_time() - begin
    return star_scores(view, truth, rotation, whole_stars(truth, rotation)) | {"cpu_s": cpu_s}


def main() -> None:
    """Print the table."""
    measured.options(__doc__).parse_args()
    truth = Truth(collimator=CollimatorTruth(r=280.0, half_angle_deg=16.0))
    rng = np.random.default_rng(2)
    poses = [pose_rotation(random_pose(rng), truth.optics) for _ in range(10)]
    wholly = [len(whole_stars(truth, rotation)) for rotation in poses]
    print(f"stars wholly in view: {min(wholly)} to {max(wholly)}")
    print("drive   noise    image           rms px    z  missed/whole  wrong  stars  detection CPU s, 95 %")
    for waveform in ("square", "sine"):
        for noise in ("clean", "typical", "heavy"):
            figures: dict[str, list[dict[str, float]]] = {kind: [] for kind in IMAGES}
            for number, rotation in enumerate(poses):
                images = images_of(truth, *record(truth, rotation, waveform, number + 1, NOISE_LEVELS[noise]))
                for kind in IMAGES:
                    try:
                        figures[kind].append(measure(truth, images, kind, rotation))
                    except CalibrationError as error:
                        print(f"        pose {number}: {kind}: {error}")
            for kind, of_poses in figures.items():
                total = {key: sum(sums[key] for sums in of_poses) for key in of_poses[0]}
                rms = (total["square"] / total["stars"] / 2.0) ** 0.5
                z = (total["z_square"] / total["stars"]) ** 0.5
                took = measured.spread(sums["cpu_s"] for sums in of_poses)
                print(
                    f"{waveform:7s} {noise:8s} {kind:14s} {rms:7.4f} {z:5.2f} {total['missed']:6.0f}/"
                    f"{total['whole']:<6.0f} {total['wrong']:5.0f} {total['stars']:6.0f} {took.median_s:8.2f} {took.p95_s:6.2f}",
                    flush=True,
                )


if __name__ == "__main__":
    measured.run(main, "stars", "Accuracy of star centres")
