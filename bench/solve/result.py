"""From accepted recordings to results.json, images, exports and report, without a device.

Besides the run folder, the ledger of the bench and earlier runs are read for the change since the last calibration; and
the views are kept for later calculations.

The truth of a simulated world is used only at the end, for a comparison, after all estimates are made.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, MutableMapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.base.bounded_json import canonical_json
from bench.base.errors import BenchError
from bench.measure.camera_kinds import EventKind, FrameKind
from bench.measure.kept_views import KeptViews, view_key
from bench.measure.measure import Measurement
from bench.measure.views_file import VIEWS, StoredView, views_file
from bench.plan.job import Job
from bench.record.as_data import as_data
from bench.record.coverage import coverage_factor
from bench.record.events import CauseData, Solved, VerdictData
from bench.record.history import History
from bench.record.ledger import Ledger, bench_ledger
from bench.record.ledger_marks import LedgerRun
from bench.record.recovery import EXPORTS
from bench.record.results import CameraData, PreviousData, ProjectionChange, Results
from bench.record.run_folder import REPORT, RESULTS, RunFolder
from bench.record.run_log import RunLog
from bench.record.stored_calibration import camera_covariance
from bench.record.stored_run import results_of
from bench.report.html import ReportData, render_report
from bench.report.maps import change_maps
from bench.report.pictured_poses import pictured_poses
from bench.report.verdict import verdict
from bench.solve.causes import beside_last_run, causes_of_run
from bench.solve.earlier_runs import NotComparableError, earlier_runs, last_results, read_sealed
from bench.solve.exports import exports
from bench.solve.results_content import results_content
from bench.solve.software import run_software
from bench.solve.solution import Solution, main_numbers, solve_run
from bench.solve.view_sources import decided_by_run
from calib.boards.board import Board
from calib.calibration import Calibration
from calib.model.lens import is_fisheye
from calib.target import StarTarget
from sequences.script import SolveStep

FIRST = "This is the first calibration of this camera on this bench."


def keep_views_of_run(job: Job, history: History, measured: Mapping[int, Measurement]) -> int:
    """Keep the views of a run's accepted recordings, unless it is a rehearsal."""
    if type(job.camera_kind) not in {EventKind, FrameKind}:
        return 0
    kept, count = KeptViews.of_bench(), 0
    for index, attempt in history.accepted().items():
        measurement = measured.get(index)
        if measurement is None or measurement.view is None:
            continue
        options = decided_by_run(job, job.record_steps[index], attempt)
        kept.write(view_key(str(attempt.stored["sha256"]), options), measurement.view)
        count += 1
    return count if not kept.remarks else 0


@dataclass(frozen=True)
class Outcome:
    """Result of a run."""

    results: Results
    report: Path
    # Hash of the journal's last line when the results were made; the report prints it.
    journal_head: str = ""
    verdict: VerdictData | None = None  # As the report prints it
    causes: Sequence[CauseData] = ()  # Those that rest on an earlier run, too


class ResultWriter:
    """Calculates and writes the results of one run."""

    def __init__(self, job: Job, folder: RunFolder) -> None:
        self.outcome: Outcome | None = None
        self._job = job
        self._folder = folder
        self._solution: Solution  # `solve` sets it: each plan solves before it reports

    def solve(
        self,
        step: SolveStep,
        history: History,
        measured: MutableMapping[int, Measurement],
        check: Callable[[], None],
    ) -> Solved:
        """Calibrate from the accepted recordings; ``check`` is called between pieces of work, and raises to stop."""
        keep_views_of_run(self._job, history, measured)
        self._solution = solve_run(self._job, self._folder.path, step, history, measured, check)
        solved = main_numbers(self._solution.calibration)
        shown = self._job, history, self._solution.calibration
        last = last_results(bench_ledger(), history)
        causes = beside_last_run(*shown, last) if last is not None else causes_of_run(*shown)
        return {**solved, "causes": [as_data(cause, CauseData) for cause in causes]}

    def write(self, log: RunLog, truth: Mapping[str, Any] | None) -> None:
        """Write results.json, views.h5, exports and the report; a real bench has no ``truth``."""
        solution = self._solution
        with log.held() as history:
            head, causes = log.journal.head, history.solved.get("causes", ())
            content = results_content(self._job, history, solution, truth, run_software(self._job.station))
            ledger = history.ledger
        if previous := previous_calibration(bench_ledger(), ledger, content):
            content["previous"] = previous
        data = canonical_json(content)
        results = results_of(data, self._folder.path / RESULTS)  # the report is made of what a reader gets
        self._folder.write_atomic(RESULTS, data)
        self._folder.write_atomic(VIEWS, views_file(solution.views))
        shown = shown_files(
            results, solution.calibration, self._job.camera_name, self._job.target, solution.views, head
        )
        for name, data in shown.items():
            self._folder.write_atomic(name, data)
        judged = verdict(results)
        self.outcome = Outcome(
            results, self._folder.path / REPORT, head, {"kind": judged.kind, "headline": judged.line}, causes
        )


def shown_files(
    results: Results,
    calibration: Calibration,
    camera_name: str,
    target: StarTarget | Board | None,
    views: Sequence[StoredView],
    head: str = "",
) -> dict[str, bytes]:
    """Return the exports and, last, the report by name; ``head``, empty without a journal, is printed in it.

    Only the images that the report shows are decoded.
    """
    written = exports(calibration, camera_name=camera_name, target=target)
    files = {f"{EXPORTS}/{name}": data for name, data in written.items()}
    pictured = pictured_poses(results).names
    pictures = [view.shown(pictured=view.view.name in pictured) for view in views]
    return {**files, REPORT: render_report(ReportData(results, pictures, head)).encode()}


def previous_calibration(
    ledger: Ledger, place: Mapping[str, object], results: Mapping[str, Any]
) -> PreviousData | None:
    """Return the camera's last calibration before this run in the ledger, and the change since, for ``previous``."""
    if not place:
        return None
    try:
        earlier = earlier_runs(ledger, place)
    except BenchError as error:
        return {"run": None, "why_not": f"The ledger of this bench cannot be read: {error.what}"}
    if earlier is None:
        return None
    if not earlier:
        return {"run": None, "why_not": FIRST}
    why = ""
    for run in earlier:
        try:
            return _compared(run, *read_sealed(Path(run.folder), run.seal or ""), results)
        except NotComparableError as error:
            why = why or f"The last calibration of this camera, {run.run_id}, cannot be compared: {error}"
    return {"run": None, "why_not": why}


def _refuse_other_camera(earlier: Results, results: Mapping[str, Any]) -> None:
    """Refuse a result whose images, lens or lens model are others."""
    then, now = earlier["calibration"], results["calibration"]
    if not then["converged"]:
        raise NotComparableError("it did not converge.")
    if list(then["image_size"]) != list(now["image_size"]):
        raise NotComparableError("its images had another size.")
    if is_fisheye(then["camera"]) != is_fisheye(now["camera"]):
        raise NotComparableError("it used another kind of lens model.")
    lens, own = ((either.get("devices") or {}).get("camera", {}).get("lens") for either in (earlier, results))
    if lens != own:
        raise NotComparableError(f"the camera had another lens: {lens or 'not stated'}.")


def _compared(run: LedgerRun, last: Results, sha256: str, results: Mapping[str, Any]) -> PreviousData:
    """Return the earlier calibration with the change of the projection, in px and in units of its uncertainty."""
    _refuse_other_camera(last, results)
    then = last["calibration"]
    covariance = camera_covariance(then["camera"], then.get("covariance"))
    if covariance is None:
        raise NotComparableError("its uncertainties are not complete.")
    run_of, conditions = last["run"], last.get("conditions")
    earlier: CameraData = {
        "image_size": list(then["image_size"]),
        "model": then["model"],
        "camera": dict(then["camera"]),
        "sigma": {name: then["sigma"][name] for name in then["camera"]},
        "covariance": {"names": list(then["camera"]), "matrix": covariance.tolist()},
        "coverage_factor": coverage_factor(then),
        "coverage_factors": then.get("coverage_factors", {}),
    }
    return {
        "run": run.run_id,
        "number": run.number,
        "finished_utc": run_of.get("finished_utc"),
        "sequence": run_of.get("sequence"),
        "temperature_c": conditions["camera"].get("temperature_c") if conditions else None,
        "seal": run.seal or "",
        "results_sha256": sha256,
        "calibration": earlier,
        "change": change_since(earlier, results["calibration"]),
    }


def change_since(then: CameraData, now: CameraData) -> ProjectionChange | None:
    """Return ``change`` of results.json, the projection's over the sensor; None without a covariance."""
    maps = change_maps(then, now)
    if maps is None:
        return None
    offset, expanded = (values.ravel() for values in maps[1:])
    seen = np.isfinite(offset) & np.isfinite(expanded) & (expanded > 0)
    if not seen.any():
        return None
    ratio = offset[seen] / expanded[seen]
    worst = int(np.argmax(ratio))
    return ProjectionChange(
        rms_px=float(np.sqrt(np.mean(offset[seen] ** 2))),
        largest_px=float(offset[seen].max()),
        largest_ratio=float(ratio[worst]),
        px_there=float(offset[seen][worst]),
        at_px=maps[0].reshape(-1, 2)[seen][worst].tolist(),
    )
