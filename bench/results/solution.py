"""The solution of a run: the calibration from its accepted recordings, how it was judged, and the checks of it.

All of it follows from the run folder alone: journal, recordings, sequence, station, passport. A run, and a verification
that calculates it again, use the same function.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any, cast

import numpy as np

from bench.base.errors import BenchError
from bench.plan.job import Job
from bench.plan.passports import PassportInUse
from bench.records.events import Solved
from bench.records.history import Attempt, History
from bench.records.results import CheckData
from bench.report.text import TargetWords, words_for
from bench.results.solve_options import limited_numbers, readings_result, require_enough_views, solve_options
from bench.stations.station import Station
from bench.views.expected_grid import best_angles_deg, grid_from_journal
from bench.views.gates import Gate, at_most, solution_gates
from bench.views.measure import Measurement, aligned_poses
from calib.engine import Calibration, CalibrationOptions, calibrate
from calib.errors import CalibrationError
from calib.model.gimbal_readings import AXES
from calib.studies.camera_check import check_camera
from calib.studies.gimbal_faults import GimbalFault
from calib.studies.gimbal_pairs import PairRatios
from calib.studies.hand_eye import check_hand_eye
from calib.studies.parallax import Parallax, PupilWalk, pupil_walk
from calib.studies.split_half import split_half
from calib.view import View
from sequences.script import SolveStep

# Errors of the engine about a board: they speak of points and of the board, not of stars. Texts only.


@contextmanager
def errors_in(words: TargetWords) -> Iterator[None]:
    """Raise the engine's errors in the words of the target.

    Raises calib.errors.CalibrationError: The error of the block, of the same class and with the same place.
    """
    try:
        yield
    except CalibrationError as error:
        if not words.is_board:
            raise
        said = type(error)(words.fitting(error.what), where=error.where, remedy=words.fitting(error.remedy))
        raise said from error


# Comparison of a calibration with Zhang's planar model on the same points, and with the truth of a
# simulated bench.

CHECK_SEED = 20_260_101
"""Of the drawn changes of a check: the same files give the same numbers."""
_COMPARED = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "x", "y", "r")
_MOVE_THE_CENTRE = ("defocus", "coma", "astigmatism", "field_curvature")
"""Errors of a collimator that displace the apparent centre across the beam, as its place depends on the pupil's."""


def planar_calibration(views: Sequence[View], options: CalibrationOptions) -> Calibration | None:
    """Calibrate with Zhang's planar model on the same points (Zhang, 2000).

    Returns: None if the views do not determine the planar model.
    """
    try:
        return calibrate(
            views, CalibrationOptions("planar", options.distortion, options.loss, options.huber_px)
        )
    except CalibrationError:
        return None


def compare_with_truth(calibration: Calibration, truth: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Compare each value with the simulated truth.

    If the simulated collimator has errors that displace the apparent centre, x and y are not compared: they are those
    of the apparent centre, and the truth holds those of the ideal one.

    truth: ``truth`` of results.json: ``camera`` and ``collimator``.
    Returns: For each value ``name value sigma truth error error_sigmas``: the error in the value's own unit,
      and divided by the value's standard uncertainty.
    """
    true = {**truth["camera"], **truth["collimator"]}
    if any(true.get(name) for name in _MOVE_THE_CENTRE):
        true = {name: value for name, value in true.items() if name not in ("x", "y")}
    values = dict(zip(calibration.parameter_names, calibration.values.tolist(), strict=True))
    sigmas = calibration.sigma
    return [
        {
            "name": name,
            "value": values[name],
            "sigma": sigmas[name],
            "truth": true[name],
            "error": values[name] - true[name],
            "error_sigmas": (values[name] - true[name]) / sigmas[name],
        }
        for name in _COMPARED
        if name in values and name in true
    ]


# Measure an accepted recording of a run again, from its file alone.


def measure_again(job: Job, folder: Path, attempt: Attempt) -> Measurement:
    """Find the stars of an accepted recording again, with the grid that was expected when it was recorded.

    Returns: The measurement; its view is not None.
    Raises BenchError: If no stars are found in the recording any more.
    """
    step = job.record_step(attempt.pose_index)
    path = folder / str(attempt.stored["capture"])
    found = job.camera_kind.measure(
        path, step, job.frequency_hz(step), job.target, grid_from_journal(attempt)
    )
    if found.view is None:
        raise BenchError(
            f"{attempt.stored['capture']} was accepted, but now no stars are found in it: {found.fault}",
            where=str(folder),
            remedy="Another version of the program recorded it. Use that version, or `starbench calibrate`.",
        )
    return found


# Checks that do not influence a result: split half, and the hand-eye check against the gimbal's readings.
#
# Each check returns plain numbers, or None if there are too few poses for it.

_NOT_INDEPENDENT = (
    "The readings also entered the calibration, so this comparison is not independent of them.",
)


def split_half_check(views: Sequence[View], options: CalibrationOptions) -> dict[str, Any] | None:
    """Calibrate every other pose and the rest separately, and compare the projections of the two cameras at infinity.

    Returns: ``rms_px worst_px expected_px ratio``, and ``cameras`` with the values of both halves, from which
      the report draws the difference. None with fewer than four views, or if a half does not determine the
      camera.
    """
    try:
        split = split_half(views, options)
    except CalibrationError:  # too few poses, or a half that constrains nothing: there is no such check then
        return None
    return {
        "rms_px": split.difference.rms_px,
        "worst_px": split.difference.worst_px,
        "expected_px": split.expected_px,
        "ratio": split.ratio,
        "cameras": [half.camera.to_dict() for half in split.halves],
    }


def gimbal_check(
    calibration: Calibration, readings_deg: Sequence[Mapping[str, float]]
) -> dict[str, Any] | None:
    """Compare the estimated rotations with the gimbal's readings.

    readings_deg: For each pose, the angle of each axis (``pan``, ``tilt``, ``roll``), deg. The reading of an
      encoder (``pan_encoder``) replaces that of its axis.
    Returns: ``rms_arcsec scale scale_sigma agrees excess_arcsec verdict says pairs slip faults``, as
      docs/results.md describes them; None with too few poses, or if an axis did not move.
    """
    readings = [{f"{axis}_deg": deg for axis, deg in best_angles_deg(pose).items()} for pose in readings_deg]
    try:
        check = check_hand_eye(
            calibration.rotations,
            calibration.rotation_covariance,
            readings,
            focal_uncertainty=_focal_uncertainty(calibration),
            birge_ratio=calibration.birge_ratio,
            names=[view.name for view in calibration.views],
        )
    except CalibrationError:  # too few poses, or axes that did not move
        return None
    faults = [_fault(fault, claimed=fault in check.claimed_faults) for fault in check.faults]
    slips = [fault for fault in faults if fault["kind"] == "slip" and fault["claimed"]]
    return {
        "rms_arcsec": check.rms_arcsec,
        "scale": dict(check.scale),
        "scale_sigma": dict(check.scale_sigma),
        "agrees": check.consistent,
        "excess_arcsec": check.excess_arcsec,
        "verdict": check.verdict.kind,
        "says": [*check.verdict.says, *(_NOT_INDEPENDENT if _entered(calibration) else ())],
        "pairs": _pairs(check.pairs) if check.pairs is not None else None,
        "slip": slips[0] if slips else None,
        "faults": faults,
    }


def _entered(calibration: Calibration) -> bool:
    """Return whether the readings took part in the calibration."""
    return calibration.gimbal is not None and calibration.gimbal.entered


def _focal_uncertainty(calibration: Calibration) -> float | None:
    """Return the larger U of fx and fy, as a share of the value; None if neither was estimated."""
    values = dict(zip(calibration.parameter_names, calibration.values.tolist(), strict=True))
    sigmas = calibration.sigma
    k, own = calibration.coverage_factor, calibration.coverage_factors
    shares = [own.get(name, k) * sigmas[name] / values[name] for name in ("fx", "fy") if name in values]
    return max(shares, default=None)


def _pairs(pairs: PairRatios) -> dict[str, Any]:
    """Return the ratios of the pairs of poses, for results.json."""
    return {
        "ratio": pairs.ratio,
        "spread": pairs.spread,
        "count": pairs.count,
        "by_axis": {AXES[axis]: ratio for axis, ratio in pairs.by_axis.items()},
        "by_axis_sigma": {AXES[axis]: sigma for axis, sigma in pairs.by_axis_sigma.items()},
    }


def _fault(fault: GimbalFault, *, claimed: bool) -> dict[str, Any]:
    """Return a fault, for results.json; poses count from 0."""
    return {
        "kind": fault.kind,
        "axis": None if fault.axis is None else AXES[fault.axis],
        "pose": fault.pose,
        "size_deg": fault.size_deg,
        "sigma_deg": fault.sigma_deg,
        "probability": fault.probability,
        "claimed": claimed,
    }


def mount_faces(calibration: Calibration, station: Station) -> list[dict[str, Any]] | None:
    """Return how the camera looks against the faces of its mount that the station states.

    Returns: As docs/results.md describes it; None without faces or without a boresight.
    """
    found = calibration.boresight
    if found is None or station.gimbal is None or not station.gimbal.faces:
        return None
    answer = []
    for name, face in station.gimbal.faces.items():
        angle, expanded = found.angle_to(np.array(face.normal), math.radians(face.sigma_deg))
        normal = found.rotation @ np.array(face.normal) / np.linalg.norm(face.normal)
        answer.append(
            {
                "name": name,
                "normal_in_camera": normal.tolist(),
                "angle_deg": angle,
                "expanded_deg": expanded,
            }
        )
    return answer


# Check that does not influence a result: where the entrance pupil is, and the parallax that follows.
#
# The rims of the beam show how far the entrance pupil is off the pivot (`calib.studies.parallax`). The
# defocus comes from the station, or from the calibration if its model has it. The function returns plain
# data for results.json.

PARALLAX_TEST = "Parallax test"
"""Name of the shipped sequence that must have a result here, or say why there is none."""

#: The station's place of the pupil is contradicted from this many standard uncertainties on.
_CONTRADICTED = 2.5


def parallax_check(
    calibration: Calibration, views: Sequence[View], station: Station, sequence: str
) -> dict[str, Any] | None:
    """Measure how far the entrance pupil is off the pivot, and what parallax that causes.

    views: Views of the calibration, in its order.
    station: The station; it may state the defocus of the collimator and the place of the pupil.
    Returns: As docs/results.md describes it. If the rims do not determine the place of the pupil: ``why_not``
      alone for the parallax test, None for other sequences.
    """
    if calibration.collimator is None:
        why_not = "The planar model has no collimator, so the motion of the beam's disc has no scale. Use model: auto."
        return {"why_not": why_not} if sequence == PARALLAX_TEST else None
    try:
        walk = pupil_walk(views, calibration.rotations, calibration.collimator)
    except CalibrationError as error:
        return {"why_not": str(error)} if sequence == PARALLAX_TEST else None
    parallax = _parallax(walk, calibration, station)
    return {
        "walk_mm": walk.walk_mm.tolist(),
        "walk_covariance_mm2": walk.covariance_mm2.tolist(),
        "pupil_off_pivot_mm": {"value": walk.pupil_off_pivot_mm, "sigma": walk.sigma_mm},
        "axes_differ": walk.axes_differ,
        "difference_in_sigmas": walk.difference_in_sigmas,
        "without_rim": list(walk.without_rim),
        "station_entry": walk.station_entry,
        "stated_mm": _stated(station),
        "defocus": None
        if parallax is None
        else {
            "value": parallax.bound.defocus,
            "sigma": parallax.bound.defocus_sigma,
            "source": parallax.defocus_source,
        },
        "parallax": None if parallax is None else {"value": parallax.share, "sigma": parallax.share_sigma},
        "fx_px": None if parallax is None else {"value": parallax.fx_px, "sigma": parallax.fx_sigma_px},
        "says": [*walk.says(), *_for_station(walk, station), *_effect(parallax)],
    }


def _parallax(walk: PupilWalk, calibration: Calibration, station: Station) -> Parallax | None:
    """Return the parallax by the station's defocus, or by that of the calibration; None if neither has one."""
    names, stated = calibration.parameter_names, station.collimator.defocus
    if stated is not None:
        defocus, sigma, source = stated.value, stated.sigma, "station"
    elif "pupil_shift" in names:
        defocus = float(calibration.values[names.index("pupil_shift")])
        sigma, source = calibration.sigma["pupil_shift"], "calibration"
    else:
        return None
    assert calibration.collimator is not None
    return walk.parallax(
        defocus, sigma, source=source, r_mm=calibration.collimator.r, fx_px=calibration.camera.fx
    )


def _stated(station: Station) -> dict[str, float] | None:
    """Return the place of the pupil that the station states, mm."""
    off = station.gimbal.pupil_off_pivot_mm if station.gimbal is not None else None
    return None if off is None else {"value": off.value, "sigma": off.sigma}


def _for_station(walk: PupilWalk, station: Station) -> list[str]:
    """Return how the place of the pupil agrees with the station file, and what to write into it."""
    stated = _stated(station)
    if stated is None:
        return [walk.advice]
    sigmas = _difference_in_sigmas(walk, stated["value"], stated["sigma"])
    agrees = sigmas <= _CONTRADICTED
    compared = (
        f"This {'agrees with' if agrees else 'contradicts'} the station file, which states {stated['value']:g} mm, "
        f"standard uncertainty {stated['sigma']:g} mm (largest difference: {sigmas:.1f} standard uncertainties)."
    )
    if agrees and stated["sigma"] <= walk.sigma_mm:
        return [f"{compared} The value of the station file is the more accurate one: keep it."]
    return [compared, walk.advice]


def _difference_in_sigmas(walk: PupilWalk, value: float, sigma: float) -> float:
    """Return the largest difference from a stated place of the pupil: along x, along y, and of both together."""
    off = np.array([*-walk.walk_mm, walk.pupil_off_pivot_mm])
    sigmas = np.array([*walk.walk_sigma_mm, walk.sigma_mm])
    return float((np.abs(off - value) / np.hypot(sigmas, sigma)).max())


def _effect(parallax: Parallax | None) -> list[str]:
    """Return what the parallax does to fx, or what is missing to calculate it."""
    if parallax is None:
        return [
            (
                "The parallax also needs the defocus of the collimator, which the station file does not state "
                "(collimator: {defocus: {value: ..., sigma: ...}})."
            )
        ]
    bound = parallax.bound
    by = "the station file" if parallax.defocus_source == "station" else "this calibration"
    says = (
        f"With a defocus of {bound.defocus:.2g}, standard uncertainty {bound.defocus_sigma:.2g} (by {by}), the "
        f"parallax is {100 * parallax.share:.2g} % of the turn, standard uncertainty "
        f"{100 * parallax.share_sigma:.2g} %. Without a correction for it, readings of the gimbal change fx by "
        f"{parallax.fx_px:.2g} px, standard uncertainty {parallax.fx_sigma_px:.2g} px."
    )
    return [says]


@dataclass(frozen=True)
class Solution:
    """A calibration, the data that it was made of, and how it was judged."""

    calibration: Calibration
    # Calibration by the planar model on the same points; None if that is the calibration's own model.
    planar: Calibration | None
    measurements: Sequence[Measurement]
    judged: Sequence[Gate]
    # `halves`, `gimbal`, `parallax` and `mount_faces` of the results, as far as they can be calculated.
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
    require_enough_views(views, options, board=job.board is not None)
    notes, words = _notes(job, step, history, measurements), words_for(job.board)
    with errors_in(words):
        calibration = _with_notes(calibrate(views, options), notes, words)
    check()
    planar = planar_calibration(views, options) if calibration.model != "planar" else None
    checks: dict[str, Any] = {
        "halves": split_half_check(views, options),
        "gimbal": gimbal_check(calibration, readings),
        "parallax": parallax_check(calibration, views, job.station, str(history.started["sequence"])),
        "mount_faces": mount_faces(calibration, job.station),
    }
    compared = stated_camera_check(job, step, calibration)
    checks["check"] = compared
    check()
    return Solution(
        calibration,
        planar,
        measurements,
        [*solution_gates(step.limits, limited_numbers(calibration)), *check_gates(compared)],
        {name: found for name, found in checks.items() if found is not None},
        readings_result(
            calibration,
            options,
            witness=step.readings == "witness",
            stated=job.station.gimbal is not None,
        ),
        job.plan.passport.in_use if options.passport is not None else None,
    )


def stated_camera_check(job: Job, step: SolveStep, calibration: Calibration) -> CheckData | None:
    """Compare the calibration with the stated one that a step ``check`` names.

    Returns: ``check`` of results.json; None for a step ``solve``.
    Raises calib.errors.InputMismatch: If the sensors have different sizes.
    """
    stated = job.plan.checked.in_use
    if stated is None or step.checked is None:
        return None
    rng, file = np.random.default_rng(CHECK_SEED), stated.file
    found = check_camera(file.camera, file.covariance, calibration.camera, calibration.camera_covariance, rng)
    return cast("CheckData", {**found.to_dict(), "stated": stated.to_dict()})


def check_gates(check: CheckData | None) -> list[Gate]:
    """Return the gate of a check: its largest E_n is at most 1."""
    if check is None:
        return []
    largest = max(one["normalised"] for one in check["regions"])
    return [at_most("largest E_n of the check", largest, 1.0, "")]


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
