"""Which light, and how sharp a lens: stars of simulated recordings, compared with the truth, and the load of the link.

The table has a row for each waveform, level of noise, frequency, level of the light, window, blur of the lens, and roll of
the camera against the target (random where none stands). The
columns are, over some random poses of the simulated bench: million events per second; data of the link, Gbit/s (it
carries 1.6), and the share of the time for which the readout waited for it; events of a lit pixel at an edge of the
light; rms error of the stars per axis, their median stated sigma and the rms z-score; complete stars that were missed;
width of the edges as measured; poses that were refused.

    python tests/benchmarks/bench_lights.py [--poses 3] [--rows noise | light | focus | roll]
"""

import dataclasses
import math
from typing import Any

import measured
import numpy as np
from star_scores import event_images, random_pose, star_scores, whole_stars

from calib.errors import CalibrationError
from calib.stars.detect import detect_stars
from simulators.optics.picture import TARGET, pose_rotation, render
from simulators.pixels.evt3_writer import Evt3Writer
from simulators.pixels.sensor import Sensor
from simulators.world.truth import NOISE_LEVELS, OpticsTruth, Truth
from simulators.world.world import FULL_DRIVE_V, LightState

WAVEFORMS = ("square", "sine")
ROWS = {
    "noise": [
        {"waveform": w, "noise": n, "window_ms": ms}
        for n in ("clean", "typical", "heavy")
        for w in WAVEFORMS
        for ms in (33, 100)
    ],
    "light": [
        {"waveform": w, "frequency_hz": hz, "level_percent": level}
        for w in WAVEFORMS
        for hz in (15, 30, 60, 120, 240)
        for level in (100, 30, 10)
    ],
    "focus": [
        {"waveform": w, "psf_px": psf}
        for w in WAVEFORMS
        for psf in (0.4, 0.7, 1.0, 1.25, 1.5, 1.75, 2.0, 2.5)
    ],
    "roll": [{"waveform": w, "roll_deg": roll} for w in WAVEFORMS for roll in (0, 5, 10, 16, 30, 45)],
}
ROW = {
    "waveform": "square",
    "noise": "typical",
    "frequency_hz": 60,
    "level_percent": 100,
    "window_ms": 33,
    "psf_px": 0.7,
    "roll_deg": None,
}


def try_pose(row: dict[str, Any], angles_deg: dict[str, float], seed: int) -> dict[str, float]:
    """Return the figures of one recording; without those of its stars if the view is refused."""
    truth = dataclasses.replace(Truth(), optics=OpticsTruth(psf_px=row["psf_px"]))
    if row["roll_deg"] is not None:
        angles_deg = angles_deg | {"roll": row["roll_deg"] - truth.optics.mounting_deg[2]}
    rotation = pose_rotation(angles_deg, truth.optics)
    light = LightState(
        waveform=row["waveform"],
        frequency_hz=row["frequency_hz"],
        high_v=FULL_DRIVE_V * row["level_percent"] / 100.0,
        output=True,
        sync=True,
    )
    phase = float(np.random.default_rng(seed).random())
    periods = max(1, round(row["window_ms"] * 1e3 / light.period_us))
    length_us = (periods + 1) * light.period_us
    sensor = Sensor(noise=NOISE_LEVELS[row["noise"]], camera_seed=7, seed=seed)
    sensor.begin(render(truth, rotation), light, phase)
    events = sensor.run(length_us)
    words = Evt3Writer().write(*events, until_us=math.ceil(length_us) + 1).size
    figures = {"rate": events.t.size / length_us, "gbit_s": 16e-3 * words / length_us}
    figures["waited"] = sensor.stalled_us / length_us
    size = truth.camera.width, truth.camera.height
    try:
        images = event_images(events, light, phase, size, length_us, periods)
        detection = detect_stars(images.best().image, TARGET)
        view, width_px = detection.view, detection.edge_width_px
    except CalibrationError:
        return figures
    scores = star_scores(view, truth, rotation, whole_stars(truth, rotation))
    means = {"square": scores["square"] / 2.0 / len(view), "z_square": scores["z_square"] / len(view)}
    sigma = float(np.median(np.sqrt(np.trace(view.covariances_px2, axis1=1, axis2=2) / 2.0)))
    own = {"per_edge": images.facts.events_per_edge, "sigma": sigma, "width": width_px}
    return figures | scores | means | own


def main() -> None:
    """Print the tables."""
    parser = measured.options(__doc__)
    parser.add_argument("--poses", type=int, default=3)
    parser.add_argument("--rows", choices=tuple(ROWS), action="append")
    options = parser.parse_args()
    rng = np.random.default_rng(5)
    poses = [random_pose(rng) for _ in range(options.poses)]
    print(
        "waveform noise    Hz level ms  blur roll | Mev/s Gbit/s waited edge | rms px  sigma     z missed width refused"
    )
    for table in options.rows or ROWS:
        for changed in ROWS[table]:
            row = ROW | changed
            row["window_ms"] = max(row["window_ms"], 1e3 / row["frequency_hz"])
            tried = [try_pose(row, pose, seed) for seed, pose in enumerate(poses, start=1)]
            solved = [pose for pose in tried if "square" in pose]
            keys = solved[0] if solved else {}
            mean = {key: float(np.mean([pose[key] for pose in solved])) for key in keys}
            link = [np.mean([pose[key] for pose in tried]) for key in ("rate", "gbit_s", "waited")]
            text = (
                f"{row['waveform']:8s} {row['noise']:7s} {row['frequency_hz']:3d} {row['level_percent']:4d} "
                f"{row['window_ms']:3.0f} {row['psf_px']:5.2f} "
                f"{'-' if row['roll_deg'] is None else row['roll_deg']:>4} | {link[0]:5.0f} {link[1]:6.2f} {link[2]:6.2f} "
            )
            if solved:
                text += (
                    f"{mean['per_edge']:4.1f} | {mean['square'] ** 0.5:.4f} {mean['sigma']:.4f} "
                    f"{mean['z_square'] ** 0.5:5.2f} {sum(pose['missed'] for pose in solved):6.0f} {mean['width']:5.2f} "
                )
            print(text + f"{len(tried) - len(solved):7d}", flush=True)


if __name__ == "__main__":
    measured.run(main, "stars", "Light and focus")
