"""Studies: an imagined camera calibrated again and again, to see whether stated uncertainties hold.

Takes the poses of a sequence and what a station expects of its bench; images nothing and reaches no device.
"""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from rich.console import Console
from rich.progress import Progress

from bench.base.errors import UsageError
from bench.plan.plan import Plan, load_documents, make_plan
from bench.records.storage import storage_errors
from bench.stations.station import Station
from calib.engine import CalibrationOptions
from calib.errors import DegenerateViews, TooFewStars
from calib.model.camera import CameraModel
from calib.model.collimator import Collimator
from calib.studies.monte_carlo import MonteCarloStudy, run_monte_carlo
from calib.studies.planning import Forecast, forecast, next_poses
from calib.studies.predicted_views import ExpectedBench

_CENTRE = 0.5
_CANDIDATES_AN_AXIS = 13
_BINS = np.linspace(-4, 4, 33)


def expected_bench(station: Station, *, noise_px: float | None = None) -> ExpectedBench:
    """Say what a station expects of its bench: roughly, and enough to plan with.

    Raises
    ------
    UsageError
        When the station file has no ``expected`` section.
    """
    expected = station.expected
    if expected is None:
        raise UsageError(
            "This station does not say what it expects of its bench.",
            where=station.name,
            remedy="Add an expected section: {focal_px, r_mm, half_angle_deg}.",
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
    target = station.target.pattern()
    x, y = target.tag_centre_mm
    return ExpectedBench(
        camera,
        Collimator(x, y, expected.r_mm),
        expected.half_angle_deg,
        star_sigma_px=noise_px or expected.star_sigma_px,
        target=target,
    )


def sequence_poses_deg(sequence: str, station: str) -> tuple[list[dict[str, float]], Station]:
    """Take the poses that a sequence records, as the engine names them, and the station."""
    planned = make_plan(*load_documents(sequence, station))
    poses = [{f"{axis}_deg": angle for axis, angle in pose.angles_deg.items()} for pose in planned.poses]
    return poses, planned.station.value


def expected_uncertainty(planned: Plan) -> Forecast | None:
    """Say what a plan's poses will be worth; None where the station expects nothing, or poses show too little.

    A sequence that is fit for other reasons is not refused because a forecast fails: the bench may differ.
    """
    station = planned.station.value
    if station.expected is None or not planned.poses:
        return None
    poses = [{f"{axis}_deg": angle for axis, angle in pose.angles_deg.items()} for pose in planned.poses]
    try:
        return forecast(expected_bench(station), poses)
    except (TooFewStars, DegenerateViews):
        return None


def suggest_poses(planned: Plan, count: int) -> list[dict[str, float]]:
    """Suggest the poses, within the station's limits, that would add most to those of a plan.

    Raises
    ------
    UsageError
        When the station expects nothing.
    calib.errors.CalibrationError
        When no pose would do.
    """
    station = planned.station.value
    taken = [{f"{axis}_deg": angle for axis, angle in pose.angles_deg.items()} for pose in planned.poses]
    steps = {
        f"{name}_deg": np.linspace(*axis.limits_deg, _CANDIDATES_AN_AXIS)
        for name, axis in station.axes.items()
    }
    candidates = [dict(zip(steps, map(float, angles), strict=True)) for angles in product(*steps.values())]
    return [dict(pose) for pose in next_poses(expected_bench(station), taken, candidates, count)]


def run_study(
    sequence: str,
    station: str,
    *,
    runs: int,
    seed: int,
    noise_px: float | None,
    drift_mm: float,
    outliers: float,
    model: str,
    loss: str,
) -> MonteCarloStudy:
    """Calibrate an imagined camera ``runs`` times.

    Parameters
    ----------
    sequence, station
        Where the poses, and what is expected of the bench, come from.
    runs, seed
        How many times, and the seed of the noise.
    noise_px
        1-sigma of a star per axis; None for the station's expectation.
    drift_mm
        1-sigma per axis by which each view's centre lies off the shared one.
    outliers
        Share of the stars that are grossly wrong.
    model, loss
        The model and the loss to calibrate with.

    Raises
    ------
    ScriptError, UsageError
        When the files cannot be used.
    """
    poses, described = sequence_poses_deg(sequence, station)
    bench = expected_bench(described, noise_px=noise_px)
    options = CalibrationOptions(model=model, loss=loss)  # type: ignore[arg-type]
    with Progress(console=Console(stderr=True), transient=True) as shown:
        task = shown.add_task("calibrating", total=runs)
        return run_monte_carlo(
            bench,
            poses,
            options,
            runs,
            seed,
            drift_mm=drift_mm,
            outliers=outliers,
            progress=lambda done, _of: shown.update(task, completed=done),
        )


def write_study_plot(study: MonteCarloStudy, path: Path) -> None:
    """Draw the errors of each parameter, in their stated sigmas, beside the normal distribution; an SVG file."""
    figure = Figure(figsize=(9, 6), layout="constrained")
    FigureCanvasSVG(figure)
    z = (study.values - study.truth) / study.sigmas
    normal = np.exp(-0.5 * _BINS**2) / np.sqrt(2 * np.pi)
    across = 3
    for at, name in enumerate(study.names):
        axes = figure.add_subplot(-(-len(study.names) // across), across, at + 1)
        axes.hist(np.clip(z[:, at], _BINS[0], _BINS[-1]), bins=list(_BINS), density=True, color="#9ecae1")
        axes.plot(_BINS, normal, color="#08306b", linewidth=1)
        axes.set_title(f"{name}: rms {study.z_rms[name]:.2f}", fontsize=10)
        axes.set_yticks([])
    figure.supxlabel("error in stated sigmas; the line is the normal distribution")
    with storage_errors(path):
        figure.savefig(path, format="svg", metadata={"Date": None})
