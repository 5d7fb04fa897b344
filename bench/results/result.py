"""From accepted recordings to results.json, images, exports and the report.

All of this can be done again from the run folder alone; no device is used. The truth of a simulated world is used
only at the end, for a comparison, after all estimates are made.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.base.bounded_json import canonical_json
from bench.base.errors import BenchError
from bench.plan.job import Job
from bench.records.events import Solved
from bench.records.history import History, RunLog
from bench.records.ledger import bench_ledger
from bench.records.results import Results
from bench.records.run_folder import EXPORTS, REPORT, RESULTS, RunFolder
from bench.report.html import ReportData, render_report
from bench.report.view_picture import ViewPicture, pictured_poses
from bench.results.exports import exports
from bench.results.previous_calibration import previous_calibration
from bench.results.results_content import results_content, run_software
from bench.results.solution import Solution, main_numbers, solve_run
from bench.results.view_sources import decided_by_run
from bench.views.camera_kinds import EventKind, FrameKind
from bench.views.kept_views import KeptViews, view_key
from bench.views.measure import Measurement
from bench.views.views_file import VIEWS, views_file
from calib.boards.board import Board
from calib.calibration import Calibration
from calib.target import StarTarget
from sequences.script import SolveStep

# Keeps the views that a run has found, so that `calibrate` need not find its stars again.


def keep_views_of_run(job: Job, history: History, measured: Mapping[int, Measurement]) -> int:
    """Keep the views of a run's accepted recordings, unless it is a rehearsal or shows a board."""
    if type(job.camera_kind) not in {EventKind, FrameKind} or job.board is not None:
        return 0
    kept, count = KeptViews.of_bench(), 0
    for index, attempt in history.accepted().items():
        found = measured.get(index)
        if found is None or found.view is None:
            continue
        options = decided_by_run(job, job.record_step(index), attempt)
        kept.write(view_key(str(attempt.stored["sha256"]), options), found.view)
        count += 1
    return count if not kept.remarks else 0


@dataclass(frozen=True)
class Outcome:
    """Result of a run."""

    results: Results
    report: Path
    # Hash of the journal's last line when the results were made; the report prints it.
    journal_head: str = ""


class ResultWriter:
    """Calculates and writes the results of one run."""

    def __init__(self, job: Job, folder: RunFolder) -> None:
        self.outcome: Outcome | None = None
        self._job = job
        self._folder = folder
        self._solution: Solution | None = None

    def solve(
        self,
        step: SolveStep,
        history: History,
        measured: Mapping[int, Measurement],
        check: Callable[[], None],
    ) -> Solved:
        """Calibrate from the accepted recordings; ``check`` is called between pieces of work, and raises to stop."""
        keep_views_of_run(self._job, history, measured)
        self._solution = solve_run(self._job, self._folder.path, step, history, measured, check)
        return main_numbers(self._solution.calibration)

    def write(self, log: RunLog, truth: Mapping[str, Any] | None) -> None:
        """Write results.json, views.h5, exports and the report; a real bench has no ``truth``."""
        if self._solution is None:
            raise BenchError(
                "There is nothing to report: no solve step came before the report step.",
                remedy="Add a solve step to the sequence.",
            )
        solution = self._solution
        with log.held() as history:
            head, results = (
                log.journal.head,
                results_content(self._job, history, solution, truth, run_software(self._job.station)),
            )
            ledger = history.ledger
        if previous := previous_calibration(bench_ledger(), ledger, results):
            results["previous"] = previous
        self._folder.write_atomic(RESULTS, json_bytes(results))
        residuals = solution.calibration.residuals_px
        self._folder.write_atomic(VIEWS, views_file(solution.measurements, residuals))
        pictures = _view_pictures(results, solution)
        target = self._job.board or self._job.target
        shown = shown_files(results, solution.calibration, self._job.camera_name, target, pictures, head)
        for name, data in shown.items():
            self._folder.write_atomic(name, data)
        self.outcome = Outcome(results, self._folder.path / REPORT, head)


def shown_files(
    results: Results,
    calibration: Calibration,
    camera_name: str,
    target: StarTarget | Board | None,
    pictures: Sequence[ViewPicture],
    head: str = "",
) -> dict[str, bytes]:
    """Return what shows results to others: the exports, and last the report.

    head: Hash of the journal's line that the report prints; empty for results without a journal.
    Returns: Contents by name within the folder.
    """
    written = exports(calibration, camera_name=camera_name, target=target)
    files = {f"{EXPORTS}/{name}": data for name, data in written.items()}
    return {**files, REPORT: render_report(ReportData(results, pictures, head)).encode()}


def json_bytes(content: Mapping[str, Any]) -> bytes:
    """Return JSON as results.json and the other files of results hold it."""
    return canonical_json(content)


def _view_pictures(results: Results, solution: Solution) -> list[ViewPicture]:
    """Return the poses as the report shows them; only images that the report shows are decoded."""
    pictured = pictured_poses(results).names
    return [
        ViewPicture(
            m.view.name,
            m.image.decoded() if m.view.name in pictured else None,
            m.view.points_px,
            m.view.points_px - r,
            m.view.ids,
        )
        for m, r in zip(solution.measurements, solution.calibration.residuals_px, strict=True)
        if m.view is not None and m.image is not None
    ]
