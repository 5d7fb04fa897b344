"""Forecasts before anything moves: the uncertainty that planned poses will reach, and poses that lower it most.

A forecast is that of a sequence's last calibration, with the collimator's errors that the station expects.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from bench.base.errors import UsageError
from bench.plan.plan import Plan
from bench.solve.solve_options import gimbal_readings, stated_radial_sigma
from bench.stations.station import Station
from bench.wording.numbers import number
from calib.calibration import REFERENCE_MODELS
from calib.errors import DegenerateViews, TooFewStars
from calib.model.camera import CameraModel
from calib.model.collimator import Collimator
from calib.model.result_parts import WORST_CORNER
from calib.studies.planning import Forecast, WeighedPose, forecast, next_poses
from calib.studies.pose_gains import Angles
from calib.studies.predicted_views import ExpectedBench
from sequences.reader import Located
from sequences.script import ChooseStep, Pose, SolveStep

_CANDIDATES = {"pan": 13, "tilt": 13, "roll": 7}  # Poses along each axis; a finer grid takes longer to weigh
LARGEST_ROLL_DEG = 90.0
"""Largest roll that is chosen, degrees: beyond a quarter of a turn, the pattern of the stars repeats itself."""
SMALLEST_COVERAGE_FACTOR = 2.0
"""The k of the expanded uncertainty if many poses determine it."""
QUANTITIES = {"expanded_fx_px": "fx", "expanded_fy_px": "fy", "worst_corner_px": WORST_CORNER}
"""Column of the budget for each limit that the budget explains."""


def expected_bench(station: Located[Station]) -> ExpectedBench:
    """Return the bench that a station expects, without errors."""
    expected = station.value.expected
    if expected is None:
        raise UsageError(
            "The station file has no expected section, so nothing can be predicted.",
            where=station.file,
            remedy="Add one: expected: {focal_px, r_mm, half_angle_deg}.",
        )
    width, height = expected.image_size
    camera = CameraModel(
        expected.focal_px,
        expected.focal_px,
        0.5 * (width - 1),
        0.5 * (height - 1),
        (width, height),
        {"k1": expected.k1, "k2": expected.k2},
    )
    target = station.value.target.pattern()
    x, y = target.tag_centre_mm
    return ExpectedBench(
        camera,
        Collimator(x, y, expected.r_mm),
        expected.half_angle_deg,
        star_sigma_px=expected.star_sigma_px,
        target=target,
    )


def forecast_bench(planned: Plan) -> ExpectedBench:
    """Return the bench that a plan expects, with what its last calibration uses."""
    bench, station = expected_bench(planned.station), planned.station.value
    assert station.expected is not None
    bench = replace(
        bench,
        errors=station.expected.errors(station.collimator),
        terms=station.budget.terms(station.collimator),
        radial_sigma=stated_radial_sigma(station),
    )
    step = last_solve(planned)
    if step is None:
        return bench
    terms = ("k1", "k2") if isinstance(step.distortion, str) else step.distortion
    known = bench.camera.distortion
    lens = replace(bench.camera, distortion={name: known.get(name, 0.0) for name in terms})
    return replace(
        bench,
        camera=lens,
        passport=planned.passport_for(step) if planned.model_for(step) not in REFERENCE_MODELS else None,
        readings=gimbal_readings(station, []) if step.readings == "auto" else None,
    )


def suggest_poses(planned: Plan, count: int) -> list[WeighedPose]:
    """Suggest further poses (``pan_deg`` ...) within the station's limits that improve most, the best first."""
    return further_poses(planned, forecast_bench(planned), poses_deg(planned.poses), count)


def further_poses(
    planned: Plan, bench: ExpectedBench, poses: list[dict[str, float]], count: int
) -> list[WeighedPose]:
    """Return further poses, besides these, where they help most."""
    return list(next_poses(bench, poses, list(_candidates(planned)), count))


def forecasts_with(planned: Plan, further: Sequence[WeighedPose]) -> Iterator[Forecast | None]:
    """Yield a plan's forecast with the first further pose, the first two ...; None where stars are too few.

    Each takes about half a second, so that a person sees one after the other.
    """
    bench, poses = forecast_bench(planned), poses_deg(planned.poses)
    for pose in further:
        poses = [*poses, dict(pose.angles_deg)]
        yield forecast_if_enough(bench, poses)


def forecast_if_enough(bench: ExpectedBench, poses: Sequence[Angles]) -> Forecast | None:
    """Return the forecast for these poses; None if they do not suffice."""
    try:
        return forecast(bench, poses) if poses else None
    except (TooFewStars, DegenerateViews):
        return None


def poses_deg(poses: Iterable[Pose]) -> list[dict[str, float]]:
    """Return the angles of poses by the names that the engine knows, such as ``pan_deg``."""
    return [{f"{axis}_deg": angle for axis, angle in pose.angles_deg.items()} for pose in poses]


def _candidates(planned: Plan) -> Iterator[dict[str, float]]:
    """Return a grid of poses over the station's limits; a roll beyond a quarter of a turn repeats the pattern."""
    steps = {}
    for name, axis in planned.station.value.axes.items():
        lowest, highest = axis.limits_deg
        if name == "roll":
            lowest, highest = max(lowest, -LARGEST_ROLL_DEG), min(highest, LARGEST_ROLL_DEG)
        steps[f"{name}_deg"] = np.linspace(lowest, highest, _CANDIDATES.get(name, _CANDIDATES["pan"]))
    return pose_grid(steps)


def pose_grid(axes: Mapping[str, NDArray[np.float64]]) -> Iterator[dict[str, float]]:
    """Yield the poses with every combination of the angles of each axis, degrees."""
    for angles in product(*axes.values()):
        yield dict(zip(axes, map(float, angles), strict=True))


def last_solve(planned: Plan) -> SolveStep | None:
    """Return the options of the last calibration of a plan."""
    for step in reversed(planned.script):
        if isinstance(step, SolveStep):
            return step
        if isinstance(step, ChooseStep):
            return step.solve
    return None


def largest_part(expected: Forecast, quantity: str) -> str:
    """Return the largest part of the uncertainty of a column of the budget, as text without a full stop."""
    largest = max(expected.budget_rows, key=lambda row: row.contribution.get(quantity, 0.0))
    part = SMALLEST_COVERAGE_FACTOR * largest.contribution.get(quantity, 0.0)
    return f"Its largest part is: {largest.name}, {number(part, 2)} px (k = 2)"
