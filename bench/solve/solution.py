"""The solution of a run: the calibration from its accepted recordings, how it was judged, and the checks of it.

It follows from the run folder alone; a run, and a verification that calculates it again, use the same function.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from bench.base.encoding import counted
from bench.base.errors import BenchError
from bench.camera_files.reader import CameraFile
from bench.measure.gates import Gate, at_most, solution_gates
from bench.measure.measure import Measurement, aligned_poses
from bench.measure.views_file import StoredView
from bench.plan.job import Job
from bench.plan.passports import PassportInUse
from bench.record.events import Solved
from bench.record.history import Attempt, History
from bench.record.measured_facts import MeasuredFacts
from bench.record.results import (
    ComparisonRow,
    GimbalComparison,
    Halves,
    MountFace,
    ParallaxData,
    ReadingsUse,
    StatedCheck,
)
from bench.solve.checks import gimbal_check, mount_faces, parallax_check, split_half_check
from bench.solve.measured_again import measure_again
from bench.solve.solve_options import limited_numbers, readings_result, require_enough_views, solve_options
from calib.engine import Calibration, CalibrationOptions, calibrate
from calib.model.result_parts import CameraCheck
from calib.studies.camera_check import check_camera
from calib.view import View
from sequences.script import SolveStep

CHECK_SEED = 20_260_101
"""Of the drawn changes of a check: the same files give the same numbers."""
_COMPARED = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "x", "y", "r")
_MOVE_THE_CENTRE = ("defocus", "coma", "astigmatism", "field_curvature")
"""Errors of a collimator by which the apparent centre moves across the beam when the pupil does."""


def calibrated(
    views: Sequence[View],
    options: CalibrationOptions,
    notes: Sequence[str],
    check: Callable[[], None] = lambda: None,
    *,
    board: bool = False,
) -> Calibration:
    """Calibrate, with further notes. ``board``: the views show a board."""
    require_enough_views(views, options, board=board)
    calibration = calibrate(views, options)
    check()
    return replace(calibration, notes=(*calibration.notes, *notes))


def compare_with_truth(calibration: Calibration, truth: Mapping[str, Any]) -> list[ComparisonRow]:
    """Compare each value with the simulated truth: ``name value sigma truth error error_sigmas``, in its own unit.

    A collimator with errors displaces the apparent centre: then x and y, which the truth holds of the ideal one, are
    left out.
    """
    true = {**truth["camera"], **truth["collimator"]}
    if any(true.get(name) for name in _MOVE_THE_CENTRE):
        true = {name: value for name, value in true.items() if name not in ("x", "y")}
    values, sigmas = calibration.values, calibration.sigma
    return [
        ComparisonRow(
            name,
            values[name],
            sigmas[name],
            true[name],
            values[name] - true[name],
            (values[name] - true[name]) / sigmas[name],
        )
        for name in _COMPARED
        if name in values and name in true
    ]


def _stars_found_again(job: Job, folder: Path, attempt: Attempt) -> Measurement:
    measurement = measure_again(job, folder, attempt)
    if measurement.view is None:
        raise BenchError(
            f"{attempt.stored['capture']} was accepted, but now no stars are found in it: {measurement.fault}",
            where=str(folder),
            remedy="Another version of the program recorded it. Use that version, or `starbench calibrate`.",
        )
    return measurement


def accepted_measurements(
    job: Job,
    folder: Path,
    history: History,
    measured: MutableMapping[int, Measurement],
    check: Callable[[], None] = lambda: None,
) -> tuple[list[Measurement], list[Mapping[str, float]]]:
    """Return the measurements of the accepted recordings by pose, and the readings of the stage there.

    A recording that ``measured`` lacks is measured again; ``check``, called between them, raises to stop.
    """
    accepted = sorted(history.accepted().items())
    for index, attempt in accepted:
        check()
        measurement = measured.get(index) or _stars_found_again(job, folder, attempt)
        view = measurement.view
        if view is not None and view.recorded_s is None:
            measurement = replace(measurement, view=replace(view, recorded_s=attempt.begun_s))
        measured[index] = measurement
    readings = [attempt.stored["measured_deg"] for _, attempt in accepted]
    return [measured[index] for index, _ in accepted], readings


def views_in(measurements: Iterable[Measurement]) -> list[View]:
    """Return the views of measurements."""
    return [measurement.view for measurement in measurements if measurement.view is not None]


@dataclass(frozen=True)
class Checks:
    """What results.json states of a calibration besides its values; None for what cannot be calculated."""

    halves: Halves | None
    gimbal: GimbalComparison | None
    parallax: ParallaxData | None
    mount_faces: Sequence[MountFace] | None
    check: StatedCheck | None


@dataclass(frozen=True)
class Solution:
    """A calibration, the data that it was made of, and how it was judged."""

    calibration: Calibration
    views: Sequence[StoredView]
    judged: Sequence[Gate]
    checks: Checks
    # Whether the readings of the gimbal entered, with what statement, or why not.
    readings: ReadingsUse
    passport: PassportInUse | None = None  # The collimator's passport that the calibration used, if any


def solve_run(
    job: Job,
    folder: Path,
    step: SolveStep,
    history: History,
    measured: MutableMapping[int, Measurement],
    check: Callable[[], None] = lambda: None,
) -> Solution:
    """Calibrate from a run's accepted recordings; ``check``, called between pieces of work, raises to stop."""
    measurements, readings = accepted_measurements(job, folder, history, measured, check)
    views = views_in(measurements)
    options = solve_options(job, step, readings)
    notes = _notes(job, step, history, measurements)
    calibration = calibrated(views, options, notes, check)
    checks = Checks(
        halves=split_half_check(views, options),
        gimbal=gimbal_check(calibration, views, readings, job.station.gimbal),
        parallax=parallax_check(calibration, views, job.station, str(history.started["sequence"])),
        mount_faces=mount_faces(calibration, job.station),
        check=stated_camera_check(job, step, calibration),
    )
    check()
    return Solution(
        calibration,
        _stored_views(measurements, calibration),
        [*solution_gates(step.limits, limited_numbers(calibration)), *check_gates(checks.check)],
        checks,
        readings_result(
            calibration,
            options,
            witness=step.readings == "witness",
            stated=job.station.gimbal is not None,
        ),
        job.plan.passport.in_use if options.passport is not None else None,
    )


def stated_camera_check(job: Job, step: SolveStep, calibration: Calibration) -> StatedCheck | None:
    """Compare the calibration with the stated one of a step ``check``: ``check`` of results.json."""
    stated = job.plan.checked.in_use
    if stated is None or step.checked is None:
        return None
    return StatedCheck(**vars(compared_with(stated.file, calibration)), stated=stated.to_dict())


def compared_with(stated: CameraFile, calibration: Calibration) -> CameraCheck:
    """Compare a calibration with the camera that a file states."""
    rng = np.random.default_rng(CHECK_SEED)
    return check_camera(
        stated.camera, stated.covariance, calibration.camera, calibration.camera_covariance, rng
    )


def check_gates(check: CameraCheck | None) -> list[Gate]:
    """Return the gate of a check: its largest E_n is at most 1."""
    if check is None:
        return []
    return [at_most("largest E_n of the check", check.worst.normalised, 1.0, "")]


def main_numbers(calibration: Calibration) -> Solved:
    """Return the numbers of a calibration that the journal holds."""
    return {
        "model": calibration.model,
        "converged": calibration.converged,
        "rms_px": calibration.rms_px,
        "values": dict(calibration.values),
        "sigma": dict(calibration.sigma),
        "coverage_factor": calibration.coverage_factor,
        "coverage_factors": dict(calibration.coverage_factors),
        "shared": shared_parts(calibration),
    }


def shared_parts(calibration: Calibration) -> dict[str, float]:
    """Return each parameter's standard uncertainty that all runs on this bench share: all but type A of these views."""
    own = {row.name for row in calibration.budget_rows if row.type == "A"}
    parts = [part for source, part in calibration.budget.items() if source not in own]
    return {name: math.hypot(*(part.get(name, 0.0) for part in parts)) for name in calibration.sigma}


def silent_line_notes(facts: Sequence[MeasuredFacts]) -> list[str]:
    """Return a sentence about the rows and columns of the sensor that sent no events in a recording; or nothing."""
    images = [fact["image"] for fact in facts if "image" in fact]
    rows = max((image.get("silent_rows", 0) for image in images), default=0)
    columns = max((image.get("silent_columns", 0) for image in images), default=0)
    if not rows and not columns:
        return []
    lines = f"{counted(columns, 'column')} and {counted(rows, 'row')} of the sensor"
    why = "dead, or missed by the readout"
    return [
        f"{lines} sent no events beside others that did: they are {why}. They are left out of the images."
    ]


def _notes(job: Job, step: SolveStep, history: History, measurements: Sequence[Measurement]) -> list[str]:
    """Return what a reader must know besides the engine's notes: about the recordings and about the passport."""
    notes = []
    if aligned := aligned_poses(m.facts for m in measurements):
        notes.append(
            f"In {aligned} of {len(measurements)} recordings the stars' edges run along the pixels' rows or diagonals, "
            "and neighbouring stars have the same error. The uncertainties may be up to 1.6 times too small. Roll the "
            "camera by about 10 degrees against the target."
        )
    notes += silent_line_notes([m.facts for m in measurements])
    in_use = job.plan.passport.in_use
    if in_use is not None and job.plan.passport_for(step) is not None:
        day = datetime.fromisoformat(history.started_utc).date()
        notes += in_use.cautions(job.station.collimator, day)
    return notes


def _stored_views(measurements: Sequence[Measurement], calibration: Calibration) -> list[StoredView]:
    return [
        StoredView(m.view, residuals, m.image.decoded if m.image is not None else None)
        for m, residuals in zip(measurements, calibration.residuals_px, strict=True)
        if m.view is not None
    ]
