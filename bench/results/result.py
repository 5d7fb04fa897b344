"""From accepted recordings to results.json, images, exports and the report.

All of this can be done again from the run folder alone; no device is used. The truth of a simulated world is used
only at the end, for a comparison, after all estimates are made.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from bench import __version__
from bench.base.errors import BenchError
from bench.plan.job import Job
from bench.plan.passports import PassportInUse
from bench.records.events import Solved
from bench.records.history import Attempt, History
from bench.records.run_folder import REPORT, RESULTS, RunFolder
from bench.records.run_log import RunLog
from bench.report.choice import pictured_poses
from bench.report.html import ReportData, render_report
from bench.report.view_picture import ViewPicture
from bench.results.comparison import compare_with_truth, planar_calibration
from bench.results.cross_checks import gimbal_check, split_half_check
from bench.results.exports import exports
from bench.results.parallax_check import parallax_check
from bench.results.previous_calibration import bench_ledger, previous_calibration
from bench.results.projection_facts import projection_facts
from bench.results.solve_options import (
    limited_numbers,
    readings_result,
    require_enough_views,
    solve_options,
)
from bench.views.camera_kinds import CameraKind
from bench.views.expected_grid import grid_from_journal
from bench.views.gates import Gate, solution_gates
from bench.views.measure import Measurement, aligned_poses
from bench.views.views_file import VIEWS, views_file
from calib.engine import Calibration, calibrate
from sequences.script import SolveStep


@dataclass(frozen=True)
class Outcome:
    """Result of a run.

    Attributes
    ----------
    results
        Content of results.json.
    report
        Path of the report.
    """

    results: Mapping[str, Any]
    report: Path


@dataclass(frozen=True)
class Solution:
    """A calibration, the data that it was made of, and how it was judged.

    Attributes
    ----------
    calibration
        The calibration.
    planar
        Calibration by the planar model on the same points; None if that is the calibration's own model.
    measurements
        Measurements of the accepted recordings.
    judged
        Gates of the solve step, as judged.
    checks
        `halves`, `gimbal` and `parallax` of the results, as far as they can be calculated.
    readings
        Whether the readings of the gimbal entered, with what statement, or why not.
    passport
        The collimator's passport that the calibration used, if any.
    """

    calibration: Calibration
    planar: Calibration | None
    measurements: Sequence[Measurement]
    judged: Sequence[Gate]
    checks: Mapping[str, Any]
    readings: Mapping[str, Any]
    passport: PassportInUse | None = None


class ResultWriter:
    """Calculates and writes the results of one run.

    Parameters
    ----------
    job
        Task of the run.
    folder
        Run folder, locked by this process.
    """

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
        """Calibrate from the accepted recordings.

        Parameters
        ----------
        step
            Model, distortion and loss.
        history
            History of the run; it states which recordings were accepted.
        measured
            Measurements already made, by pose; the others are made again from their recordings.
        check
            Called between pieces of work; raises if the run is to stop.

        Returns
        -------
        Solved
            Main numbers, for the journal.

        Raises
        ------
        calib.errors.CalibrationError
            If the views do not determine the camera.
        """
        measurements = []
        accepted = sorted(history.accepted().items())
        for index, attempt in accepted:
            check()
            measurements.append(measured.get(index) or self._measure_again(attempt))
        views = [m.view for m in measurements if m.view is not None]
        readings = [attempt.stored["measured_deg"] for _, attempt in accepted]
        options = solve_options(self._job, step, readings)
        require_enough_views(views, options)
        calibration = _with_notes(calibrate(views, options), self._notes(step, history, measurements))
        check()
        planar = planar_calibration(views, options) if calibration.model != "planar" else None
        found = limited_numbers(calibration)
        checks = {
            "halves": split_half_check(views, options),
            "gimbal": gimbal_check(calibration, readings),
            "parallax": parallax_check(
                calibration, views, self._job.station, str(history.started["sequence"])
            ),
        }
        check()
        self._solution = Solution(
            calibration,
            planar,
            measurements,
            solution_gates(step.limits, found),
            {name: found for name, found in checks.items() if found is not None},
            readings_result(
                calibration,
                options,
                witness=step.readings == "witness",
                stated=self._job.station.gimbal is not None,
            ),
            self._job.plan.passport.in_use if options.passport is not None else None,
        )
        return main_numbers(calibration)

    def write(self, log: RunLog, truth: Mapping[str, Any] | None) -> None:
        """Write results.json, views.h5, exports and the report.

        Parameters
        ----------
        log
            Journal and history of the run.
        truth
            Truth of the simulated world; None on a real bench.

        Raises
        ------
        BenchError
            If there is no calibration.
        StorageError
            If a file cannot be written.
        """
        if self._solution is None:
            raise BenchError(
                "There is nothing to report: no solve step came before the report step.",
                remedy="Add a solve step to the sequence.",
            )
        solution = self._solution
        results = self._results(log.history, solution, truth)
        if previous := previous_calibration(bench_ledger(), log.history.ledger, results):
            results["previous"] = previous
        self._folder.write_atomic(RESULTS, _json_bytes(results))
        residuals = solution.calibration.residuals_px
        self._folder.write_atomic(VIEWS, views_file(solution.measurements, residuals))
        written = exports(solution.calibration, camera_name=self._job.camera_name, target=self._job.target)
        for name, data in written.items():
            self._folder.write_atomic(f"exports/{name}", data)
        html = render_report(ReportData(results, _view_pictures(results, solution), log.journal.head))
        path = self._folder.write_atomic(REPORT, html.encode())
        self.outcome = Outcome(results, path)

    def _notes(self, step: SolveStep, history: History, measurements: Sequence[Measurement]) -> list[str]:
        """Return what a reader must know besides the engine's notes: about the recordings and about the passport."""
        notes = []
        if aligned := aligned_poses(m.facts for m in measurements):
            notes.append(_alignment_note(aligned, len(measurements)))
        in_use = self._job.plan.passport.in_use
        if in_use is not None and self._job.plan.passport_for(step) is not None:
            day = datetime.fromisoformat(history.started_utc).date()
            notes += in_use.cautions(self._job.station.collimator, day)
        return notes

    def _measure_again(self, attempt: Attempt) -> Measurement:
        path = self._folder.path / str(attempt.stored["capture"])
        job, step = self._job, self._job.record_step(attempt.pose_index)
        found = job.camera_kind.measure(
            path, step, job.frequency_hz(step), job.target, grid_from_journal(attempt)
        )
        if found.view is None:
            raise BenchError(
                f"{attempt.stored['capture']} was accepted, but now no stars are found in it: {found.fault}",
                where=str(self._folder.path),
                remedy="Another version of the program recorded it. Use that version, or `starbench calibrate`.",
            )
        return found

    def _results(
        self, history: History, solution: Solution, truth: Mapping[str, Any] | None
    ) -> dict[str, Any]:
        started, calibration = history.started, solution.calibration
        return {
            "schema": "starbench/results/1",
            "run": {
                "id": started["id"],
                "sequence": started["sequence"],
                "station": started["station"],
                "started_utc": history.started_utc,
                "finished_utc": history.states[-1]["utc"],
                "seed": started["seed"],
                "operator": started["operator"],
                "laboratory": self._job.laboratory,
                "collimator": collimator_data(self._job),
                "simulated": self._job.simulated,
                "camera": self._job.camera_kind.name,
                "resumed": history.resumed,
                **({"ledger": dict(history.ledger)} if history.ledger else {}),
                "software": software(),
            },
            "devices": dict(history.devices),
            "conditions": _conditions(history, self._job.camera_kind),
            "calibration": calibration.to_dict(),
            "projection": _projection(calibration, solution.measurements),
            "planar": solution.planar.to_dict() if solution.planar else None,
            "passport": solution.passport.to_dict() if solution.passport else None,
            "gimbal_readings": dict(solution.readings),
            **solution.checks,
            "poses": _poses(history, solution, self._job.camera_kind),
            "gates": [*(gate.as_data() for gate in solution.judged), *_pose_gates(history)],
            **({"untils": list(history.decisions)} if history.decisions else {}),
            "deviations": list(history.deviations),
            **({"failures": list(history.failures)} if history.failures else {}),
            "states": list(history.states),
            "truth": dict(truth) if truth is not None else None,
            "comparison": compare_with_truth(calibration, truth) if truth is not None else [],
        }


def _with_notes(calibration: Calibration, notes: Sequence[str]) -> Calibration:
    return replace(calibration, notes=(*calibration.notes, *notes))


def _projection(calibration: Calibration, measurements: Sequence[Measurement]) -> dict[str, Any] | None:
    points = [m.view.points_px for m in measurements if m.view is not None]
    camera, k = calibration.camera, calibration.coverage_factor
    return projection_facts(camera, calibration.camera_covariance, k, points)


def _alignment_note(aligned: int, total: int) -> str:
    """Return the note on recordings that show that the stated uncertainties may be too small."""
    return (
        f"In {aligned} of {total} recordings the stars' edges run along the pixels' rows or diagonals, and "
        "neighbouring stars err alike: the uncertainties may be up to 1.6 times too small. Roll the camera by about "
        "10 degrees against the target."
    )


def collimator_data(job: Job) -> dict[str, Any] | None:
    """Return what the station of a run states about its collimator, as results.json holds it.

    Parameters
    ----------
    job
        Task of the run.

    Returns
    -------
    dict or None
        None if the station states nothing.
    """
    return job.station.collimator.model_dump(mode="json", exclude_none=True) or None


def main_numbers(calibration: Calibration) -> Solved:
    """Return the numbers of a calibration that the journal holds.

    Parameters
    ----------
    calibration
        The calibration.

    Returns
    -------
    Solved
        Model, values and standard uncertainties.
    """
    return {
        "model": calibration.model,
        "converged": calibration.converged,
        "rms_px": calibration.rms_px,
        "values": dict(zip(calibration.parameter_names, calibration.values.tolist(), strict=True)),
        "sigma": dict(calibration.sigma),
        "coverage_factor": calibration.coverage_factor,
    }


def software() -> dict[str, str]:
    """Return the versions of the software that contributes to a result.

    Returns
    -------
    dict
        Version by name.
    """
    parts = {"starbench": __version__, "python": platform.python_version()}
    for name in ("numpy", "scipy", "opencv-python-headless", "numba"):
        parts[name] = version(name)
    return parts


def _json_bytes(results: Mapping[str, Any]) -> bytes:
    return (json.dumps(results, indent=1, allow_nan=False) + "\n").encode()


def _conditions(history: History, kind: CameraKind) -> dict[str, Any]:
    """Return the settings of light and camera, as read back at the last accepted recording."""
    stored = [a.stored for _, a in sorted(history.accepted().items())]
    light = dict(stored[-1]["light"])
    if light.get("waveform") == "steady":  # the settings of a flicker do not apply
        light = {name: light[name] for name in ("waveform", "high_v")}
    return {"light": light, "camera": kind.conditions([s["facts"] for s in stored])}


def _view_pictures(results: Mapping[str, Any], solution: Solution) -> list[ViewPicture]:
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


def _poses(history: History, solution: Solution, kind: CameraKind) -> list[dict[str, Any]]:
    summaries = {view.name: view for view in solution.calibration.views}
    poses = []
    for index in sorted({a.pose_index for a in history.attempts}):
        attempts = history.attempts_at(index)
        best = history.accepted().get(index)
        shown = best or attempts[-1]
        measured = shown.measured
        summary = summaries.get(shown.pose_name) if best else None
        poses.append(
            {
                "index": index,
                "name": shown.pose_name,
                "commanded_deg": shown.stored["commanded_deg"],
                "measured_deg": shown.stored["measured_deg"],
                "measured_after_deg": shown.stored["measured_after_deg"],
                "attempts": [_attempt(a, kind) for a in attempts],
                "image": measured.get("image"),
                "flicker_hz": measured.get("flicker_hz"),
                "named_by": measured.get("named_by"),
                "stars": summary.n if summary else 0,
                "rms_px": summary.rms_px if summary else None,
                "mean_px": summary.mean_px if summary else None,
            }
        )
    return poses


def _attempt(attempt: Attempt, kind: CameraKind) -> dict[str, Any]:
    stored = attempt.stored
    return {
        "attempt": attempt.attempt,
        "capture": stored["capture"],
        "sha256": stored["sha256"],
        "accepted": attempt.accepted,
        "reasons": list(attempt.reasons),
        **kind.counts(stored["facts"]),
    }


def _pose_gates(history: History) -> list[dict[str, Any]]:
    """Return the gates of the accepted recordings, each named with its pose."""
    return [
        {**gate, "name": f"pose {index}: {gate['name']}"}
        for index, attempt in sorted(history.accepted().items())
        for gate in attempt.gates
    ]
