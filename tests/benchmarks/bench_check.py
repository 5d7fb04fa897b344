"""How often the step `check` calls a right camera wrong, and misses a moved lens: one pose, with the collimator's passport.

    python tests/benchmarks/bench_check.py [--seeds 100-139]

Each bench is drawn. A run of 25 poses with a certificate gives the stated calibration and the passport. Later the lens
has moved, and one pose is recorded. A change of 1 U is the expanded uncertainty (k = 2) of the difference of that value
between the two calibrations. Without images; the stars have noise of .014 px.
"""

from dataclasses import replace

import measured
import numpy as np

from calib import Calibration, CalibrationOptions, Passport, calibrate
from calib.model.gimbal_readings import GimbalReadings
from calib.studies.camera_check import check_camera
from simulators.world.gimbal import GimbalTruth
from simulators.world.truth import CameraTruth
from tests.support.drawn_benches import SCALE_SIGMA, TWENTY_FIVE, draw_bench, gimbal_truth

ONE = [{"pan": 3.0, "tilt": 2.0}]
CHANGES = (0.0, 0.5, 1.0, 2.0, 3.0)
CERTIFICATE_MM = (255.0, 0.05)
KINDS = {"scale": ("fx", "fy"), "principal point": ("cx",)}


def _gimbal(seed: int) -> GimbalTruth:
    return gimbal_truth(np.random.default_rng((seed, 11)), seed)


def stated(profile: str, seed: int) -> Calibration:
    """Return the calibration of the run of 25 poses."""
    bench = draw_bench(profile, TWENTY_FIVE, seed, gimbal=_gimbal(seed))
    r, sigma = CERTIFICATE_MM
    drawn = r + sigma * np.random.default_rng((seed, 21)).normal()
    readings = GimbalReadings(tuple(bench.readings_deg), 0.002, SCALE_SIGMA, 0.001, None, "drawn")
    options = CalibrationOptions(passport=Passport.of_radius(drawn, sigma), gimbal=readings)
    return calibrate(bench.views, options)


def later(profile: str, seed: int, camera: CameraTruth, passport: Passport, again: int) -> Calibration:
    """Return the calibration of one pose, recorded later."""
    bench = draw_bench(profile, ONE, seed, camera=camera, noise_seed=again, gimbal=_gimbal(seed))
    return calibrate(bench.views, CalibrationOptions(passport=passport))


def expanded(calibration: Calibration, other: Calibration, name: str) -> float:
    """Return the expanded uncertainty of the difference of a value, k = 2."""
    return float(2.0 * np.hypot(calibration.sigma[name], other.sigma[name]))


def main() -> None:
    """Print the table."""
    parser = measured.options(__doc__)
    parser.add_argument("--seeds", type=measured.seeds, default="100-139")
    given = parser.parse_args()
    called = {(kind, change): 0 for kind in KINDS for change in CHANGES}
    named, sizes = dict.fromkeys(called, 0), {kind: [] for kind in KINDS}
    for seed in given.seeds:
        before = stated("like-bench", seed)
        passport, truth = before.passport(), CameraTruth()
        unmoved = later("like-bench", seed, truth, passport, 1)
        for again, (kind, change) in enumerate(called, 2):
            names = KINDS[kind]
            unit = expanded(before, unmoved, names[0])
            sizes[kind].append(unit)
            moved = replace(truth, **{name: getattr(truth, name) + change * unit for name in names})
            camera_check = later("like-bench", seed, moved, passport, again)
            checked = check_camera(
                before.camera, before.camera_covariance, camera_check.camera, camera_check.camera_covariance,
                np.random.default_rng(seed),
            )  # fmt: skip
            called[kind, change] += not checked.right
            named[kind, change] += not checked.right and checked.cause == kind
    benches = len(given.seeds)
    print(f"| {benches} benches | " + " | ".join(f"moved by {change:g} U" for change in CHANGES) + " |")
    print("| --- |" + " --- |" * len(CHANGES))
    for kind in KINDS:
        cells = [
            f"{100 * called[kind, c] / benches:.0f} %"
            + (f" ({100 * named[kind, c] / benches:.0f} %)" if c else "")
            for c in CHANGES
        ]
        print(f"| {kind}, U = {np.median(sizes[kind]):.2g} px | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
