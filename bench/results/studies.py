"""Studies: calibrate a simulated camera repeatedly, to test whether the stated uncertainties are right.

Uses the poses of a sequence and the ``expected`` section of a station. Makes no images and reaches no device.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.plan.plan import load_documents, make_plan
from bench.records.storage import storage_errors
from bench.results.forecasts import expected_bench
from bench.stations.station import Station
from calib.calibration import CalibrationOptions
from calib.studies.monte_carlo import MonteCarloStudy, Repetition, calibrate_once
from calib.studies.predicted_views import ExpectedBench
from sequences.reader import Located


def sequence_poses_deg(sequence: str, station: str) -> tuple[list[dict[str, float]], Located[Station]]:
    """Return the poses that a sequence records.

    Returns: Poses with an angle in degrees for each axis, named as in the engine (``pan_deg``), and the
      station file.
    """
    planned = make_plan(*load_documents(sequence, station))
    poses = [{f"{axis}_deg": angle for axis, angle in pose.angles_deg.items()} for pose in planned.poses]
    return poses, planned.station


@dataclass(frozen=True)
class PlannedStudy:
    """What all calibrations of a study have in common."""

    bench: ExpectedBench
    # For each pose its angles, named as in the engine (``pan_deg``), degrees.
    poses_deg: Sequence[Mapping[str, float]]
    options: CalibrationOptions
    seed: int
    # Standard deviation, for each axis, of the distance between a view's centre and the shared centre, mm.
    drift_mm: float = 0.0
    outliers: float = 0.0

    def calibrate(self, runs: range) -> list[Repetition]:
        """Calibrate a simulated camera repeatedly with random noise (Monte Carlo method, JCGM 101)."""
        return [
            calibrate_once(
                self.bench,
                self.poses_deg,
                self.options,
                self.seed,
                run,
                drift_mm=self.drift_mm,
                outliers=self.outliers,
            )
            for run in runs
        ]


def plan_study(
    sequence: str,
    station: str,
    *,
    seed: int,
    noise_px: float | None,
    drift_mm: float,
    outliers: float,
    model: str,
    loss: str,
) -> PlannedStudy:
    """Read the files of a study.

    seed, drift_mm, outliers: As `PlannedStudy` has them.
    noise_px: Standard deviation of a star for each axis, px; None for the station's value.
    Raises ScriptError, UsageError: When the files cannot be used.
    """
    poses, described = sequence_poses_deg(sequence, station)
    bench = expected_bench(described, noise_px=noise_px)
    options = CalibrationOptions(model=model, loss=loss)  # type: ignore[arg-type]
    return PlannedStudy(bench, poses, options, seed, drift_mm, outliers)


def write_study_plot(study: MonteCarloStudy, path: Path) -> None:
    """Draw the z-scores of each parameter as histograms beside the normal distribution, in an SVG file.

    Raises StorageError: When the file cannot be written.
    """
    from bench.report.study_plot import study_plot

    svg = study_plot(study.names, (study.values - study.truth) / study.sigmas, study.z_rms)
    with storage_errors(path):
        path.write_text(svg + "\n", encoding="utf-8")
