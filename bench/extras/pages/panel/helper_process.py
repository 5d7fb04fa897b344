"""The helper of the panel: makes pictures, coverage and forecasts from a run's files, at the lowest priority.

A process of its own, so that neither page nor run waits. It ends with its input, writes no file and uses no device.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, Required, TypedDict, TypeVar

import numpy as np
from numpy.typing import NDArray

from bench.base.worker_process import answer_questions
from bench.run.last_view import LastView
from calib.arrays import Array

if TYPE_CHECKING:
    from bench.extras.pages.panel.shown_run import Uncertainties
    from bench.measure.measure import StoredImage
    from bench.plan.job import Job

T_co = TypeVar("T_co", covariant=True)
T = TypeVar("T")

_ORDERS = (5, 3)  # Of the polynomial; the second for few stars
_STARS_A_TERM = 2  # At least, so that the polynomial smooths
_DIGITS = 3  # Thousandths of a pixel
_PNG_SIZE = struct.Struct(">16xII")
"""Width and height in the first bytes of a PNG file (ISO/IEC 15948, 11.2.2)."""

_JOBS_KEPT = 4  # Runs that are looked at together; each holds its plan


class PictureAnswer(TypedDict, total=False):
    """Stars and residuals of one recording as a page shows them, px; alone ``fault`` where there is no picture."""

    size: Sequence[int]
    stars: Sequence[Sequence[float]]
    residuals: Sequence[Sequence[float]] | None
    residuals_of: str
    rms_px: float | None
    fault: Required[str]
    absent: bool  # Whether it was not made, because it was not to be measured


def picture_of_view(left: LastView) -> PictureAnswer:
    """Return what a page shows of the picture that a run in progress has left, as `picture_answer`."""
    nodes = np.array(left.nodes, np.float64).reshape(-1, 2)
    points_px = np.array(left.points_px, np.float64).reshape(-1, 2)
    width, height = _PNG_SIZE.unpack_from(left.png)
    return {**own_residuals((width, height), nodes, points_px), "fault": left.fault}


def own_residuals(size: tuple[int, int], nodes: Array, points_px: Array) -> PictureAnswer:
    """Return stars with their residuals to a smooth fit of this pose alone; arguments as for `smooth_residuals`."""
    residuals = smooth_residuals(nodes, points_px)
    return picture_answer(size, points_px, residuals, "a smooth fit of this pose alone")


def smooth_residuals(nodes: Array, points_px: Array) -> Array | None:
    """Return what a polynomial, of fifth order or third with few stars, leaves of the stars' places, (N, 2) px.

    It shows single stars that are wrong; it is no calibration. None with too few stars. ``nodes`` are (column, row),
    (N, 2).
    """
    order = next((n for n in _ORDERS if len(nodes) >= _STARS_A_TERM * (n + 1) * (n + 2) // 2), None)
    if order is None:
        return None
    centred = nodes - nodes.mean(axis=0)
    x, y = (centred / max(float(np.abs(centred).max()), 1e-9)).T
    powers = [x**i * y**j for i in range(order + 1) for j in range(order + 1 - i)]
    design = np.column_stack(powers)
    fitted, *_ = np.linalg.lstsq(design, points_px, rcond=None)
    return np.asarray(points_px - design @ fitted)


def picture_answer(
    size: tuple[int, int], points_px: Array, residuals_px: Array | None = None, residuals_of: str = ""
) -> PictureAnswer:
    """Return stars and residuals, (N, 2) px or None, with size, rms and fault, as JSON holds them."""
    answer: PictureAnswer = {
        "size": list(size),
        "stars": np.round(points_px, _DIGITS).tolist(),
        "residuals": None,
        "residuals_of": "",
        "rms_px": None,
        "fault": "",
    }
    if residuals_px is not None and len(residuals_px):
        answer["residuals"] = np.round(residuals_px, _DIGITS + 1).tolist()
        answer["residuals_of"] = residuals_of
        answer["rms_px"] = float(np.sqrt(np.mean(np.sum(residuals_px**2, axis=1))))
    return answer


class Request(Protocol[T_co]):
    """Something that the helper process is asked for."""

    def answer(self) -> T_co:
        """Calculate it, in the helper process."""


@dataclass(frozen=True)
class PictureRequest:
    """A recording whose picture is asked for: its stars and residuals, and the picture as PNG."""

    folder: Path
    pose: int
    attempt: int
    pose_name: str
    capture: str
    expected_grid: Sequence[Sequence[float]] | None
    accepted: bool  # Whether it entered a calibration
    measure: bool  # Whether its stars may be found again, which takes seconds

    def answer(self) -> tuple[PictureAnswer, bytes]:
        """Return residuals of the solved run, or else of a smooth fit of this pose; ``absent`` if there is none."""
        from bench.measure.views_file import VIEWS

        if self.accepted and (self.folder / VIEWS).is_file():
            answer = _solved_picture(self.folder / VIEWS, self.pose_name)
            if answer is not None:
                return answer
        if not self.measure:
            return {"absent": True, "fault": ""}, b""
        return _measured_picture(self)


@dataclass(frozen=True)
class CoverageRequest:
    """Accepted recordings whose stars are counted in the cells of the image, row by row.

    Places come from each grid, without distortion. Of few stars those next to the tag count: the beam lights the
    middle.
    """

    folder: Path
    size: Sequence[int]  # Of the image, px
    cells: tuple[int, int]  # Columns and rows
    # Map of each pose from the reticle to the image, (3, 3), and its number of stars.
    grids: Sequence[tuple[Sequence[Sequence[float]], int]]

    def answer(self) -> list[int]:
        """Return the number of stars in each cell."""
        target = job_of_run(self.folder).target
        nodes = target.node_of(target.ids).astype(float)
        tag = np.array(target.tag_centre_mm) / target.pitch_mm
        nodes = nodes[np.argsort(np.linalg.norm(nodes - tag, axis=1), kind="stable")]
        counts = np.zeros(self.cells[0] * self.cells[1], np.int64)
        for grid, stars in self.grids:
            cells = _cells_of(nodes, np.array(grid, np.float64), self.size, self.cells)
            counts += np.bincount(cells[:stars], minlength=len(counts))
        return [int(count) for count in counts]


def _cells_of(nodes: Array, grid: Array, size: Sequence[int], cells: tuple[int, int]) -> NDArray[np.int64]:
    """Return the cell of each node that lies in the image, in the order of the nodes."""
    mapped = np.column_stack([nodes, np.ones(len(nodes))]) @ grid.T
    points = mapped[:, :2] / mapped[:, 2:]
    place = np.floor((points + 0.5) / np.array(size) * np.array(cells)).astype(np.int64)
    inside = ((place >= 0) & (place < np.array(cells)) & (mapped[:, 2:] * grid[2, 2] > 0)).all(axis=1)
    return np.asarray(place[inside, 1] * cells[0] + place[inside, 0])


@dataclass(frozen=True)
class ForecastRequest:
    """The first ``poses`` of a run's plan, whose expanded uncertainties are forecast."""

    folder: Path
    poses: int

    def answer(self) -> Uncertainties:
        """Return them, empty where they are not known."""
        from bench.base.errors import UsageError
        from bench.solve.forecasts import forecast_bench
        from calib.errors import CalibrationError
        from calib.model.result_parts import WORST_CORNER
        from calib.studies.planning import forecast

        plan = job_of_run(self.folder).plan
        poses = [{f"{axis}_deg": deg for axis, deg in pose.angles_deg.items()} for pose in plan.poses]
        try:
            limited = forecast(forecast_bench(plan), poses[: self.poses]).limited
        except (CalibrationError, UsageError):
            return {}
        now: Uncertainties = {}
        if np.isfinite(limited["expanded_fx"]):
            now["expanded_fx_px"] = float(limited["expanded_fx"])
        if np.isfinite(limited[WORST_CORNER]):
            now["worst_corner_px"] = float(limited[WORST_CORNER])
        return now


def _solved_picture(path: Path, name: str) -> tuple[PictureAnswer, bytes] | None:
    """Return the picture of a calibrated pose; None if the file does not hold it, or cannot be read."""
    from bench.base.errors import BenchError
    from bench.measure.measure import StoredImage
    from bench.measure.views_file import read_picture, read_views

    try:
        views = read_views(path)
        number = next((i for i, view in enumerate(views, 1) if view.view.name == name), None)
        if number is None:
            return None
        picture = read_picture(path, number)
    except BenchError:
        return None
    stored = views[number - 1]
    answer = picture_answer(
        stored.view.image_size, stored.view.points_px, stored.residuals_px, "the calibration"
    )
    return answer, StoredImage.from_image(picture).png


def _measured_picture(request: PictureRequest) -> tuple[PictureAnswer, bytes]:
    job = job_of_run(request.folder)
    step = job.record_steps[request.pose]
    grid = request.expected_grid
    measured = job.camera_kind.measure(
        request.folder / request.capture,
        step,
        job.frequency_hz(step),
        job.target,
        None if grid is None else lambda _image_size: np.array(grid, np.float64),
    )
    image: StoredImage | None = measured.image
    if image is None:
        return {"fault": measured.fault or "No image can be made of this recording."}, b""
    height, width = image.decoded().shape
    size = width, height
    if measured.view is None:
        return {**picture_answer(size, np.zeros((0, 2))), "fault": measured.fault}, image.png
    nodes = job.target.node_of(measured.view.ids).astype(np.float64)
    return own_residuals(size, nodes, measured.view.points_px), image.png


@lru_cache(maxsize=_JOBS_KEPT)
def job_of_run(folder: Path) -> Job:
    """Return the task of a run; the last ones are kept."""
    from bench.plan.job import Job

    return Job.from_run_folder(folder)


def answer_request(request: Request[T]) -> T | str:
    """Answer a request, or say why it has no answer; one that fails must not end the others."""
    from bench.base.failure import Failure

    try:
        return request.answer()
    except Exception as error:  # noqa: BLE001 - the answer says it
        return Failure.of(error).message


def main() -> None:
    """Answer the panel until its end."""
    from bench.base.kernel_cache import set_kernel_cache

    with suppress(AttributeError, OSError):
        os.nice(19)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    set_kernel_cache(os.environ)
    answer_questions(answer_request)


if __name__ == "__main__":
    main()
