"""Reads a solved run into Python: camera, covariance, collimator, poses, views and results.

Without `results.json` or `views.h5` the stars are found again and the camera calibrated again. Never writes; engine and
HDF5 are imported late.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bench.base.bounded_json import canonical_json
from bench.base.errors import RunFolderError
from bench.record.results import Results
from bench.record.run_folder import REPORT, RESULTS
from bench.record.storage import storage_errors
from bench.record.stored_calibration import stored_calibration
from bench.record.stored_run import StoredRun, results_of
from calib.arrays import ReadOnlyArrays
from calib.calibration import Calibration
from calib.model.camera import CameraModel
from calib.model.collimator import Collimator
from calib.view import View

if TYPE_CHECKING:
    from bench.measure.views_file import StoredView
    from bench.plan.job import Job
    from bench.record.history import Attempt


Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
ReadPicture = Callable[[], Picture]


@dataclass(frozen=True, eq=False)
class Pose(ReadOnlyArrays):
    """One calibrated pose of a run.

    Attributes
    ----------
    index
        Number of the pose in the sequence, from 1.
    name
        Name of the pose; also the name of its view.
    rotation
        (3, 3) float64, rotation camera <- target, as calibrated.
    centre_mm
        (3,) float64, mm, centre of the camera in the target's frame, as calibrated.
    commanded_deg
        Angle of each axis of the stage, as commanded, deg.
    measured_deg
        Angle of each axis as read back before the recording, deg; encoders with the ending ``_encoder``.
    view
        The stars that were found.
    residuals_px
        (N, 2) float64, px, star found minus star projected, in the order of the view.
    read_picture
        Reads `picture`.
    """

    index: int
    name: str
    rotation: Array = field(repr=False)
    centre_mm: Array = field(repr=False)
    commanded_deg: Mapping[str, float]
    measured_deg: Mapping[str, float]
    view: View = field(repr=False)
    residuals_px: Array = field(repr=False)
    read_picture: ReadPicture = field(repr=False)

    @property
    def picture(self) -> Picture:
        """(H, W) uint8, grey values, the image as the report shows it; read each time it is asked for."""
        return self.read_picture()


@dataclass(frozen=True, eq=False)
class Run:
    """A solved run.

    Attributes
    ----------
    folder
        The run folder.
    results
        The content of `results.json` (docs/results.md). A run without this file has ``calibration`` and ``poses``
        only, calculated again from its captures, beside its ``id``.
    calibration
        The result, as `calib.calibrate` returns it, without residuals and weights; it prints a summary.
    poses
        The calibrated poses, in the order of the sequence.
    """

    folder: Path
    results: Results = field(repr=False)
    calibration: Calibration
    poses: tuple[Pose, ...] = field(repr=False)

    def _repr_html_(self) -> str:
        return f"<p>{escape(str(self.folder))}: {len(self.poses)} poses</p>{self.calibration._repr_html_()}"

    @property
    def camera(self) -> CameraModel:
        """Intrinsics and distortion."""
        return self.calibration.camera

    @property
    def collimator(self) -> Collimator | None:
        """The shared centre and the aberrations; None for the planar model. Its ``reference`` is not stored: None."""
        return self.calibration.collimator

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the k parameters that all poses share, in the order of `covariance`."""
        return self.calibration.parameter_names

    @property
    def values(self) -> Mapping[str, float]:
        """Value of each parameter, by name, in its unit (px, mm, 1)."""
        return self.calibration.values

    @property
    def sigma(self) -> Mapping[str, float]:
        """Standard uncertainty (1 sigma) of each parameter, by name."""
        return self.calibration.sigma

    @property
    def k(self) -> Mapping[str, float]:
        """Coverage factor of each parameter, by name."""
        return self.calibration.k

    @property
    def U(self) -> Mapping[str, float]:  # noqa: N802 - the symbol of JCGM 100:2008, 6.2.1
        """Expanded uncertainty of each parameter, by name: its own k times its sigma."""
        return self.calibration.U

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the reader, in words."""
        return self.calibration.notes

    @property
    def covariance(self) -> Array:
        """(k, k) float64, joint covariance of the parameters, in their units."""
        return self.calibration.covariance

    @property
    def camera_covariance(self) -> Array:
        """(n, n) float64, covariance of the camera alone, in the order of `CameraModel.parameter_names`."""
        return self.calibration.camera_covariance

    @property
    def views(self) -> list[View]:
        """The view of each pose, as `calib.calibrate` takes them."""
        return [pose.view for pose in self.poses]

    @property
    def residuals_px(self) -> list[Array]:
        """For each pose (N, 2) float64, px, star found minus star projected."""
        return [pose.residuals_px for pose in self.poses]

    @property
    def report(self) -> Path | None:
        """Path of the report; None if the run has none."""
        path = self.folder / REPORT
        return path if path.is_file() else None


def load(run_folder: str | Path) -> Run:
    """Read a solved run. Nothing is written, and a sealed run stays sealed.

    The stars come from `views.h5`. If `results.json` or `views.h5` is missing, the stars are found in the captures
    again, and the camera is calibrated again with the options of the run. This takes some seconds for each pose.

    Parameters
    ----------
    run_folder
        Folder of a run that was solved, on a real or a simulated bench.

    Returns
    -------
    Run
        Camera, covariance, collimator, poses with their views, and results.

    Raises
    ------
    RunFolderError
        If the folder is not a run, the run was only rehearsed, or its files cannot be read or contradict each other.
    StorageError
        If a file that is needed is not there, or may not be read.
    BenchError
        If results are missing and no recording was accepted.
    ScriptError
        If results are missing and the sequence or the station of the run cannot be read.
    calib.errors.CalibrationError
        If results are missing and the accepted recordings do not determine the camera.

    Examples
    --------
    ::

        import starbench

        run = starbench.load("runs/demo")
        print(run.camera, run.sigma)
    """
    from bench.measure.views_file import VIEWS, read_views

    run = StoredRun.open(Path(run_folder).absolute())
    if run.has_results and (run.folder / VIEWS).is_file():
        return _run(run.folder, run.results, read_views(run.folder / VIEWS))
    with storage_errors(run.folder):
        results, views = _solve_again(run)
    return _run(run.folder, run.results if run.has_results else results, views)


def _run(folder: Path, results: Results, views: Sequence[StoredView]) -> Run:
    """Put a run together; raise RunFolderError if its results and views do not belong together."""
    try:
        calibration = stored_calibration(results["calibration"])
        return Run(folder, results, calibration, tuple(_poses(folder, results, views)))
    except (KeyError, TypeError, ValueError) as error:
        raise RunFolderError(
            f"The results are incomplete: {type(error).__name__}: {error}.",
            where=str(folder / RESULTS),
            remedy="Another version of Starbench wrote them; load the run with that version.",
        ) from error


def _poses(folder: Path, results: Results, views: Sequence[StoredView]) -> list[Pose]:
    """Return the calibrated poses; raise RunFolderError if views and results name different ones."""
    from bench.measure.views_file import VIEWS, read_picture

    solved = results["calibration"]["views"]
    names = [stored.view.name for stored in views]
    if names != [view["name"] for view in solved]:
        raise RunFolderError(
            "The views and the results name different poses.",
            where=str(folder),
            remedy="Restore both files from a copy of the run.",
        )
    recorded = {pose["name"]: pose for pose in results["poses"] if pose["stars"]}
    return [
        Pose(
            recorded[name]["index"],
            name,
            np.array(view["rotation"], np.float64),
            np.array(view["centre_mm"], np.float64),
            recorded[name]["commanded_deg"] or {},
            recorded[name]["measured_deg"] or {},
            stored.view,
            stored.residuals_px,
            stored.picture or partial(read_picture, folder / VIEWS, number),  # which says that it has none
        )
        for number, (name, view, stored) in enumerate(zip(names, solved, views, strict=True), 1)
    ]


def _solve_again(run: StoredRun) -> tuple[Results, list[StoredView]]:
    """Find the stars in the accepted recordings again, and calibrate with the options of the run."""
    from bench.plan.job import Job
    from bench.solve.offline import calibrate_paths
    from bench.solve.offline_options import OfflineOptions
    from bench.solve.results_content import SCHEMA, pose_row

    folder, history = run.folder, run.history
    if run.is_rehearsal:
        raise RunFolderError(
            "This run was rehearsed: it has no recordings.", where=str(folder), remedy="Load a real run."
        )
    job = Job.from_run_folder(folder)
    result = calibrate_paths([folder], OfflineOptions())
    seen = {view.name: view for view in result.calibration.views}
    accepted = {attempt.pose_name: attempt for _, attempt in sorted(history.accepted().items())}
    content = {
        "schema": SCHEMA,
        "run": {"id": history.started["id"]},
        "calibration": result.calibration.to_dict(),
        "poses": [
            pose_row(attempt.pose_index, name, attempt, seen.get(name)) for name, attempt in accepted.items()
        ],
    }
    return results_of(canonical_json(content), folder / RESULTS), [
        replace(stored_view, picture=partial(_picture_again, job, folder, accepted[stored_view.view.name]))
        for stored_view in result.stored_views
    ]


def _picture_again(job: Job, folder: Path, attempt: Attempt) -> Picture:
    """Make the image of an accepted recording again; raise RunFolderError if this is not possible."""
    from bench.solve.measured_again import measure_again

    with storage_errors(folder):
        measurement = measure_again(job, folder, attempt)
    if measurement.image is None:
        where = str(folder / str(attempt.stored["capture"]))
        raise RunFolderError(f"No image can be made of it: {measurement.fault}", where=where)
    return measurement.image.decoded()
