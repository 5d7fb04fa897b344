"""The content of results.json of a run: what its journal and its documents state, and what was calculated."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench import __version__
from bench.base.program import differing_software, forms
from bench.measure.camera_kinds import CameraKind
from bench.plan.job import Job
from bench.record.as_data import as_data
from bench.record.conformity import conformity
from bench.record.events import AttemptData, CauseData, Solved
from bench.record.history import Attempt, History
from bench.record.measured_facts import GateData
from bench.record.results import (
    Conditions,
    Direction,
    PoseData,
    Projection,
    RunData,
    SupportedPart,
    WorstCorner,
)
from bench.report.supported import reach_px, star_distance
from bench.solve.solution import Solution, compare_with_truth
from calib.calibration import Calibration, ViewSummary
from calib.model.camera import CameraModel
from calib.model.result_parts import WORST_CORNER
from calib.uncertainty.projection_uncertainty import URAD_PER_ARCSEC, ProjectionMap, projection_uncertainty
from calib.view import View

Array = NDArray[np.float64]

_CORNERS = {
    "top left": (0, 0),
    "top right": (0, -1),
    "bottom left": (-1, 0),
    "bottom right": (-1, -1),
}
SCHEMA = "starbench/results/1"


def projection_facts(
    camera: CameraModel, covariance: Array, k: float, points: Sequence[Array]
) -> Projection | None:
    """Return ``projection`` of results.json: the expanded uncertainty of a direction, and the part stars support.

    By the camera's covariance, (K, K), along the worse direction; U = k u (JCGM 100:2008, 6.2.1); ``points`` (N, 2) px
    a view. None if no corner has an uncertainty.
    """
    uncertainty, size = projection_uncertainty(camera, covariance), camera.image_size
    corners = {name: float(uncertainty.sigma_px[at]) for name, at in _CORNERS.items()}
    known = {name: sigma for name, sigma in corners.items() if np.isfinite(sigma)}
    if not known:
        return None
    worst = max(known, key=lambda name: known[name])
    middle_px, middle_arcsec = np.nanmedian(uncertainty.sigma_px), np.nanmedian(uncertainty.sigma_arcsec)
    worst_urad = URAD_PER_ARCSEC * float(uncertainty.sigma_arcsec[_CORNERS[worst]])
    return Projection(
        k,
        WorstCorner(worst, k * known[worst], k * worst_urad),
        Direction(k * float(middle_px), k * URAD_PER_ARCSEC * float(middle_arcsec)),
        _supported(uncertainty, np.concatenate(points), size, k) if points else None,
    )


def _supported(
    projection_map: ProjectionMap, points: Array, size: tuple[int, int], k: float
) -> SupportedPart:
    """Return how much of the sensor the stars support, and the largest uncertainty there."""
    distance, reach = star_distance(points, size), reach_px(size)
    grid = np.rint(projection_map.grid_px).astype(int)
    near = (distance[grid[..., 1], grid[..., 0]] <= reach) & np.isfinite(projection_map.sigma_px)
    inside = [
        float(np.max(values[near])) if near.any() else None
        for values in (projection_map.sigma_px, projection_map.sigma_arcsec)
    ]
    return SupportedPart(
        reach,
        float(np.mean(distance <= reach)),
        None if inside[0] is None else k * inside[0],
        None if inside[1] is None else k * URAD_PER_ARCSEC * inside[1],
    )


def results_content(
    job: Job,
    history: History,
    solution: Solution,
    truth: Mapping[str, Any] | None,
    software_used: Mapping[str, str],
) -> dict[str, Any]:
    """Return the content of results.json of a run, without the comparison with an earlier run.

    The parts are in the order of the file; those that do not apply are missing. `Results` is what a reader gets of it.
    """
    calibration, checks = solution.calibration, solution.checks
    gates = [as_data(gate, GateData) for gate in solution.judged] + _pose_gates(history)
    failed = [gate["name"] for gate in gates if gate["verdict"] == "fail"]
    # PASS or FAIL by the limits of the station and the sequence, and by a check, as far as there are any.
    judged_limits = conformity(calibration, job.limits, failed, checks=checks.check is not None)
    results: dict[str, Any] = {
        "schema": SCHEMA,
        "run": {**run_data(job, history), "software": dict(software_used)},
        "devices": history.devices,
        "conditions": _conditions(history, job.camera_kind),
        "calibration": calibration.to_dict(),
        "projection": projection(calibration, [view.view for view in solution.views]),
        "passport": solution.passport.to_dict() if solution.passport else None,
        "gimbal_readings": solution.readings,
    }
    found = {**vars(checks), "check": checks.check.to_dict() if checks.check else None}
    results |= {name: part for name, part in found.items() if part is not None}
    results["poses"] = pose_data(history, calibration.views, job.camera_kind)
    results["gates"] = gates
    if judged_limits is not None:
        results["conformity"] = judged_limits
    _add_course(results, history)
    results["causes"] = causes_without_earlier_run(history.solved)
    results["truth"] = dict(truth) if truth is not None else None
    results["comparison"] = compare_with_truth(calibration, truth) if truth is not None else []
    return results


def causes_without_earlier_run(solved: Solved) -> list[CauseData]:
    """Return the causes of a calibration that rest on the run and its station: a customer has no earlier run.

    One that names a pose has the pose before it in ``before``; others have the earlier run there.
    """
    return [cause for cause in solved.get("causes", ()) if cause["pose"] or not cause["before"]]


def run_data(job: Job, history: History) -> RunData:
    """Return ``run`` of results.json, without its software."""
    started = history.started
    run: RunData = {
        "id": started["id"],
        "sequence": started["sequence"],
        "station": started["station"],
        "started_utc": history.started_utc,
        "finished_utc": history.states[-1]["utc"],
        "seed": started["seed"],
        "operator": started["operator"],
        "laboratory": job.station.laboratory,
        "collimator": collimator_data(job),
    }
    if stated := target_data(job):
        run["target"] = stated
    run["simulated"] = job.simulated
    run["camera"] = job.camera_kind.name
    run["resumed"] = history.resumed
    if started.get("plugins"):
        run["plugins"] = started["plugins"]
    if history.ledger:
        run["ledger"] = history.ledger
    return run


def _add_course(results: dict[str, Any], history: History) -> None:
    """Add what happened on the way: decisions, deviations, pauses, failures, how devices were left, states."""
    if history.decisions:
        results["untils"] = list(history.decisions)
    results["deviations"] = list(history.deviations)
    results["holds"] = list(history.holds)
    if history.failures:
        results["failures"] = list(history.failures)
    if history.devices_left:
        results["devices_left"] = list(history.devices_left)
    results["states"] = list(history.states)


def projection(calibration: Calibration, views: Sequence[View]) -> Projection | None:
    """Return ``projection`` of results.json; None if no corner of the sensor has an uncertainty."""
    camera = calibration.camera
    k = calibration.coverage_factors.get(WORST_CORNER, calibration.coverage_factor)
    return projection_facts(camera, calibration.camera_covariance, k, [view.points_px for view in views])


def collimator_data(job: Job) -> dict[str, Any] | None:
    """Return what the station of a run states about its collimator, as results.json holds it."""
    return job.station.collimator.model_dump(mode="json", exclude_none=True) or None


def target_data(job: Job) -> dict[str, str]:
    """Return ``serial`` and ``description`` of the target as far as the station states them."""
    target = job.station.target
    stated = {"serial": target.serial, "description": target.description}
    return {name: text for name, text in stated.items() if text}


def software() -> dict[str, str]:
    """Return versions of the software that makes a result and its report, and hashes (`bench.base.program.forms`)."""
    parts = {"starbench": __version__, "python": platform.python_version()}
    for name in ("numpy", "scipy", "opencv-python-headless", "numba", "h5py"):
        parts[name] = version(name)
    return parts | forms()


def other_software(used: Mapping[str, str], names: Sequence[str] | None = None) -> str:
    """Return which software, by results.json or the journal, differs here: ``numpy 2.1 (here 2.2)``, with commas."""
    here = software()
    return differing_software(used, {name: here[name] for name in names or here})


def _conditions(history: History, kind: CameraKind) -> Conditions:
    """Return the settings of light and camera, as read back at the last accepted recording."""
    stored = [a.stored for _, a in sorted(history.accepted().items())]
    light = stored[-1]["light"]
    if light.get("waveform") == "steady":  # the settings of a flicker do not apply
        light = {"waveform": light["waveform"], "high_v": light["high_v"]}
    return {"light": light, "camera": kind.conditions([s["facts"] for s in stored])}


def pose_data(history: History, views: Sequence[ViewSummary], kind: CameraKind) -> list[PoseData]:
    """Return ``poses`` of results.json: each pose with its recordings."""
    summaries = {view.name: view for view in views}
    poses: list[PoseData] = []
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
                "flicker_duty": measured.get("flicker_duty"),
                "named_by": measured.get("named_by"),
                "stars": summary.n if summary else 0,
                "rms_px": summary.rms_px if summary else None,
                "mean_px": summary.mean_px if summary else None,
            }
        )
    return poses


def pose_row(index: int, name: str, attempt: Attempt | None, summary: ViewSummary | None) -> dict[str, Any]:
    """Return what is stated of a pose that was calibrated without devices: its recording, if known, and its stars."""
    return {
        "index": index,
        "name": name,
        "commanded_deg": attempt.stored["commanded_deg"] if attempt else None,
        "measured_deg": attempt.stored["measured_deg"] if attempt else None,
        "stars": summary.n if summary else 0,
        "rms_px": summary.rms_px if summary else None,
        "mean_px": summary.mean_px if summary else None,
    }


def _attempt(attempt: Attempt, kind: CameraKind) -> AttemptData:
    stored = attempt.stored
    return {
        "attempt": attempt.attempt,
        "capture": stored["capture"],
        "sha256": stored["sha256"],
        "accepted": attempt.accepted,
        "reasons": list(attempt.reasons),
        **kind.counts(stored["facts"]),
    }


def _pose_gates(history: History) -> list[GateData]:
    """Return the gates of the accepted recordings, each named with its pose."""
    return [
        {**gate, "name": f"pose {index}: {gate['name']}", "gate": gate["name"], "pose": index}
        for index, attempt in sorted(history.accepted().items())
        for gate in attempt.gates
    ]
