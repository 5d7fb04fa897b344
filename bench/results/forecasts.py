"""Forecasts before anything moves: the uncertainty that planned poses will reach, and poses that lower it most."""

from __future__ import annotations

from itertools import product

import numpy as np

from bench.base.errors import UsageError
from bench.plan.plan import Plan
from bench.stations.station import Station
from calib.errors import DegenerateViews, TooFewStars
from calib.model.camera import CameraModel
from calib.model.collimator import Collimator
from calib.studies.planning import Forecast, forecast, next_poses
from calib.studies.predicted_views import ExpectedBench
from sequences.reader import Located

_CENTRE = 0.5
_CANDIDATES_AN_AXIS = 13


def expected_bench(station: Located[Station], *, noise_px: float | None = None) -> ExpectedBench:
    """Return the bench that a station file expects: approximate values, sufficient for planning.

    Parameters
    ----------
    station
        The station file.
    noise_px
        Standard uncertainty of a star for each axis, px; None for the station's value.

    Returns
    -------
    ExpectedBench
        Camera, collimator, field of view and noise.

    Raises
    ------
    UsageError
        When the station file has no ``expected`` section.
    """
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
        _CENTRE * (width - 1),
        _CENTRE * (height - 1),
        (width, height),
        {"k1": expected.k1, "k2": expected.k2},
    )
    target = station.value.target.pattern()
    x, y = target.tag_centre_mm
    return ExpectedBench(
        camera,
        Collimator(x, y, expected.r_mm),
        expected.half_angle_deg,
        star_sigma_px=noise_px or expected.star_sigma_px,
        target=target,
    )


def expected_uncertainty(planned: Plan) -> Forecast | None:
    """Predict the uncertainties that the poses of a plan will give.

    A sequence is not refused if the prediction fails, because the real bench may differ from the expected one.

    Parameters
    ----------
    planned
        The plan.

    Returns
    -------
    Forecast or None
        None if the station expects nothing, the plan has no poses, or the poses show too few stars.
    """
    station = planned.station.value
    if station.expected is None or not planned.poses:
        return None
    poses = [{f"{axis}_deg": angle for axis, angle in pose.angles_deg.items()} for pose in planned.poses]
    try:
        return forecast(expected_bench(planned.station), poses)
    except (TooFewStars, DegenerateViews):
        return None


def suggest_poses(planned: Plan, count: int) -> list[dict[str, float]]:
    """Suggest further poses, within the station's limits, that improve the calibration most.

    Parameters
    ----------
    planned
        The plan with the poses so far.
    count
        Number of poses to suggest.

    Returns
    -------
    list of dict
        Angle of each axis, deg (``pan_deg``).

    Raises
    ------
    UsageError
        When the station file has no ``expected`` section.
    calib.errors.CalibrationError
        When no pose is suitable.
    """
    station = planned.station.value
    taken = [{f"{axis}_deg": angle for axis, angle in pose.angles_deg.items()} for pose in planned.poses]
    steps = {
        f"{name}_deg": np.linspace(*axis.limits_deg, _CANDIDATES_AN_AXIS)
        for name, axis in station.axes.items()
    }
    candidates = [dict(zip(steps, map(float, angles), strict=True)) for angles in product(*steps.values())]
    return [dict(pose) for pose in next_poses(expected_bench(planned.station), taken, candidates, count)]
