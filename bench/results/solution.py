"""The solution of a run: the calibration from its accepted recordings, how it was judged, and the checks of it.

All of it follows from the run folder alone: journal, recordings, sequence, station, passport. A run, and a verification
that calculates it again, use the same function.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

from bench.plan.job import Job
from bench.plan.passports import PassportInUse
from bench.records.events import Solved
from bench.records.history import History
from bench.report.target_words import TargetWords, words_for
from bench.results.board_words import errors_in
from bench.results.comparison import planar_calibration
from bench.results.cross_checks import gimbal_check, split_half_check
from bench.results.measure_again import measure_again
from bench.results.parallax_check import parallax_check
from bench.results.solve_options import (
    limited_numbers,
    readings_result,
    require_enough_views,
    solve_options,
)
from bench.views.gates import Gate, solution_gates
from bench.views.measure import Measurement, aligned_poses
from calib.engine import Calibration, calibrate
from sequences.script import SolveStep


@dataclass(frozen=True)
class Solution:
    """A calibration, the data that it was made of, and how it was judged."""

    calibration: Calibration
    # Calibration by the planar model on the same points; None if that is the calibration's own model.
    planar: Calibration | None
    measurements: Sequence[Measurement]
    judged: Sequence[Gate]
    # `halves`, `gimbal` and `parallax` of the results, as far as they can be calculated.
    checks: Mapping[str, Any]
    # Whether the readings of the gimbal entered, with what statement, or why not.
    readings: Mapping[str, Any]
    passport: PassportInUse | None = None  # The collimator's passport that the calibration used, if any


def solve_run(
    job: Job,
    folder: Path,
    step: SolveStep,
    history: History,
    measured: Mapping[int, Measurement],
    check: Callable[[], None] = lambda: None,
) -> Solution:
    """Calibrate from the accepted recordings of a run.

    check: Called between pieces of work; raises if the run is to stop.
    Raises calib.errors.CalibrationError: If the views do not determine the camera.
    Raises BenchError: If no stars are found in an accepted recording any more.
    """
    measurements = []
    accepted = sorted(history.accepted().items())
    for index, attempt in accepted:
        check()
        measurements.append(measured.get(index) or measure_again(job, folder, attempt))
    views = [m.view for m in measurements if m.view is not None]
    readings = [attempt.stored["measured_deg"] for _, attempt in accepted]
    options = solve_options(job, step, readings)
    require_enough_views(views, options)
    notes, words = _notes(job, step, history, measurements), words_for(job.board)
    with errors_in(words):
        calibration = _with_notes(calibrate(views, options), notes, words)
    check()
    planar = planar_calibration(views, options) if calibration.model != "planar" else None
    checks = {
        "halves": split_half_check(views, options),
        "gimbal": gimbal_check(calibration, readings),
        "parallax": parallax_check(calibration, views, job.station, str(history.started["sequence"])),
    }
    check()
    return Solution(
        calibration,
        planar,
        measurements,
        solution_gates(step.limits, limited_numbers(calibration)),
        {name: found for name, found in checks.items() if found is not None},
        readings_result(
            calibration,
            options,
            witness=step.readings == "witness",
            stated=job.station.gimbal is not None,
        ),
        job.plan.passport.in_use if options.passport is not None else None,
    )


def main_numbers(calibration: Calibration) -> Solved:
    """Return the numbers of a calibration that the journal holds."""
    return {
        "model": calibration.model,
        "converged": calibration.converged,
        "rms_px": calibration.rms_px,
        "values": dict(zip(calibration.parameter_names, calibration.values.tolist(), strict=True)),
        "sigma": dict(calibration.sigma),
        "coverage_factor": calibration.coverage_factor,
        "coverage_factors": dict(calibration.coverage_factors),
        "shared": shared_parts(calibration),
    }


def shared_parts(calibration: Calibration) -> dict[str, float]:
    """Return the standard uncertainty of each parameter that all runs on this bench share, from the budget.

    Only what was evaluated from the views of this run (type A) is its own. Certificate, glass, print and the
    statements about the gimbal (type B) are the same in each run.
    """
    own = {row.name for row in calibration.budget_rows if row.type == "A"}
    parts = [part for source, part in calibration.budget.items() if source not in own]
    return {name: math.hypot(*(part.get(name, 0.0) for part in parts)) for name in calibration.sigma}


def _notes(job: Job, step: SolveStep, history: History, measurements: Sequence[Measurement]) -> list[str]:
    """Return what a reader must know besides the engine's notes: about the recordings and about the passport."""
    notes = []
    if aligned := aligned_poses(m.facts for m in measurements):
        notes.append(_alignment_note(aligned, len(measurements)))
    in_use = job.plan.passport.in_use
    if in_use is not None and job.plan.passport_for(step) is not None:
        day = datetime.fromisoformat(history.started_utc).date()
        notes += in_use.cautions(job.station.collimator, day)
    return notes


def _with_notes(calibration: Calibration, notes: Sequence[str], words: TargetWords) -> Calibration:
    fitting = tuple(words.fitting(note) for note in (*calibration.notes, *notes))
    return replace(calibration, notes=fitting, remarks=tuple(map(words.fitting, calibration.remarks)))


def _alignment_note(aligned: int, total: int) -> str:
    """Return the note on recordings that show that the stated uncertainties may be too small."""
    return (
        f"In {aligned} of {total} recordings the stars' edges run along the pixels' rows or diagonals, and "
        "neighbouring stars err alike: the uncertainties may be up to 1.6 times too small. Roll the camera by about "
        "10 degrees against the target."
    )
