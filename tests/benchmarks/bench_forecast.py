"""Compare forecasts with calibrations of drawn benches: expected against stated uncertainty.

    python tests/benchmarks/bench_forecast.py [--seeds 200-202]

Each row is a profile of the collimator, a number of poses, and what is known besides the views. ``radial``: nothing.
``certificate``: r = 255 +- .05 mm. ``readings``: readings of the gimbal of .002 degrees, with the bounds of their
parallax; S1 and S2 have none, so readings do not enter there. ``both``: certificate and readings. Of each row, the ratios of
expected to median stated U are counted.

The sizes of the collimator's errors were set by hand, after the ``rms_px`` of nine-pose calibrations with the seeds 0
and 1. The rows use other seeds. A laboratory takes its size from a finished run.
"""

import sys
from dataclasses import replace
from itertools import product

import measured
import numpy as np

from bench.solve.solve_options import limited_numbers
from calib import CalibrationOptions, CameraModel, Collimator, Passport, StarTarget, calibrate
from calib.errors import CalibrationError
from calib.model.gimbal_readings import GimbalReadings, ParallaxBound
from calib.studies.planning import Forecast, forecast
from calib.studies.predicted_views import CollimatorErrors, ExpectedBench
from tests.support.drawn_benches import POSES, STAR_SIGMA_PX, DrawnBench, draw_bench

ERRORS = {
    "ideal": CollimatorErrors(),
    "S1": CollimatorErrors(rms_px=0.1, pupil_wander_mm=8.5),
    "S2": CollimatorErrors(rms_px=0.05, pose_rms_px=0.16),
    "S3": CollimatorErrors(rms_px=0.05, pose_rms_px=0.12),
    "like-bench": CollimatorErrors(rms_px=0.068, pupil_wander_mm=0.05),
}
BOUNDS = {
    "ideal": ParallaxBound(0.0, 1e-6, 0.0, 0.5),
    "S3": ParallaxBound(0.066, 0.01, 0.0, 0.5),
    "like-bench": ParallaxBound(0.066, 0.01, 2.0, 0.5),
}
ASKED = ("radial", "certificate", "readings", "both")
FACTOR = 1.5


def known(asked: str, profile: str) -> tuple[Passport | None, GimbalReadings | None]:
    """What is known besides the views: a certificate, or readings without their angles."""
    passport = Passport.of_radius(255.0, 0.05) if asked in ("certificate", "both") else None
    readings = GimbalReadings((), 0.002, parallax=BOUNDS.get(profile), source="drawn")
    return passport, readings if asked in ("readings", "both") else None


def expected(profile: str, poses: int, asked: str) -> Forecast:
    """The forecast, for a camera and a centre that are known approximately only."""
    target = StarTarget()
    passport, readings = known(asked, profile)
    bench = ExpectedBench(
        CameraModel(3300.0, 3300.0, 639.5, 359.5, (1280, 720), {"k1": 0.0, "k2": 0.0}),
        Collimator(*target.tag_centre_mm, 255.0),
        12.5,
        STAR_SIGMA_PX,
        target,
        passport,
        needs_tag=False,
        errors=ERRORS[profile],
        readings=readings,
    )
    return forecast(bench, [{f"{axis}_deg": angle for axis, angle in pose.items()} for pose in POSES[poses]])


def stated(drawn: DrawnBench, profile: str, asked: str) -> tuple[float, float]:
    """Expanded uncertainties of fx and at the corners that the engine states, px."""
    passport, readings = known(asked, profile)
    if readings is not None:
        readings = replace(readings, angles_deg=tuple(drawn.readings_deg))
    result = calibrate(drawn.views, CalibrationOptions(passport=passport, gimbal=readings))
    numbers = limited_numbers(result)
    return numbers["expanded_fx"], numbers["worst_corner"]


def row(profile: str, poses: int, asked: str, seeds: range) -> tuple[float, float]:
    """Return expected over median stated U, of fx and at the worst corner."""
    planned = expected(profile, poses, asked).limited
    solved = []
    for seed in seeds:
        try:
            solved.append(stated(draw_bench(profile, POSES[poses], seed), profile, asked))
        except CalibrationError as error:
            print(f"  {profile} {poses} {asked}, seed {seed}: {error}", file=sys.stderr)
    fx, corner = np.median(solved, axis=0) if solved else (np.nan, np.nan)
    return planned["expanded_fx"] / fx, planned["worst_corner"] / corner


def main() -> None:
    parser = measured.options(__doc__)
    parser.add_argument("--seeds", type=measured.seeds, default="200-202")
    given = parser.parse_args()
    ratios = []
    for poses, profile, asked in product(POSES, ERRORS, ASKED):
        ratios.append(ratio := row(profile, poses, asked, given.seeds))
        text = f"{profile:<11}{poses:>5}  {asked:<12}{ratio[0]:>7.2f}{ratio[1]:>7.2f}"
        print(text, file=sys.stderr, flush=True)
    apart = np.exp(np.abs(np.log(ratios)))
    fx, corner = (apart <= FACTOR).sum(axis=0)
    print(f"| {len(ratios)} forecasts | fx | corner |\n| --- | --- | --- |")
    print(f"| within a factor of {FACTOR:g} | {fx} | {corner} |")
    print("| largest factor | {:.2f} | {:.2f} |".format(*apart.max(axis=0)))


if __name__ == "__main__":
    measured.run(main, "truth", "Forecasts")
