"""The last calibration of the same camera, found by the bench's ledger, and the change since then.

The values of the earlier run are copied into results.json, with the hash of its seal and of its results. So the report
can be rendered again from its own folder, and a reader can check which run it was compared with.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np

from bench.base.bounded_json import parse_json
from bench.base.errors import BenchError
from bench.evidence.seal import read_manifest
from bench.records.ledger import Ledger
from bench.records.ledger_breaks import LedgerRun
from bench.records.results import (
    CalibrationData,
    CameraData,
    ChangeData,
    CovarianceData,
    PreviousData,
    Results,
)
from bench.records.run_facts import coverage_factor
from bench.records.run_folder import MANIFEST, RESULTS
from bench.report.pose_plot import camera_covariance, change_maps
from calib.model.lens import is_fisheye


class _Sealed(NamedTuple):
    """Results as sealed, with the hash of the seal and of the file."""

    results: Results
    seal: str
    sha256: str


_MOST_READ = 20
"""Runs whose results are read before the search is given up."""
_LARGEST_BYTES = 100_000_000
FIRST = "This is the first calibration of this camera on this bench."


def previous_calibration(
    ledger: Ledger, place: Mapping[str, object], results: Results
) -> PreviousData | None:
    """Return the last calibration of the same camera before this run, and the change since then.

    place: What the ledger returned for this run when it was entered.
    Returns: ``previous`` of results.json (docs/results.md); None if this run is not in the ledger.
    """
    if not place:
        return None
    try:
        runs = ledger.runs()
    except BenchError as error:
        return {"run": None, "why_not": f"The ledger of this bench cannot be read: {error.what}"}
    own = next((run for run in runs if run.number == place.get("number")), None)
    if own is None:
        return None
    earlier = [run for run in runs[: own.number - 1] if _is_comparable(run, own)]
    if not earlier:
        return {"run": None, "why_not": FIRST}
    why = ""
    for run in list(reversed(earlier))[:_MOST_READ]:
        found, why_not = _read(Path(run.folder), run.seal or "")
        if found is not None:
            why_not = _not_comparable(found.results, results)
            if not why_not:
                return _compared(run, found, results)
        why = why or f"The last calibration of this camera, {run.run_id}, cannot be compared: {why_not}"
    return {"run": None, "why_not": why}


def _is_comparable(run: LedgerRun, own: LedgerRun) -> bool:
    """Return whether a run calibrated the same camera in the same world, and was sealed."""
    same = (run.camera, run.simulated) == (own.camera, own.simulated)
    return same and run.how == "finished" and run.seal is not None


def _read(folder: Path, seal: str) -> tuple[_Sealed | None, str]:
    """Read sealed results; return why it cannot be done if the ledger, the seal and the file do not agree."""
    try:
        manifest = (folder / MANIFEST).read_bytes()
        is_sealed = _sha256(manifest) == seal
        listed = read_manifest(manifest).get(RESULTS) if is_sealed else None
        if listed is None:
            return None, "it has no result." if is_sealed else "its folder has another seal than the ledger."
        data = b"" if (folder / RESULTS).stat().st_size > _LARGEST_BYTES else (folder / RESULTS).read_bytes()
        found = parse_json(data) if _sha256(data) == listed else None
    except OSError:
        return None, "its folder cannot be read."
    except (BenchError, ValueError):
        return None, "its results are not readable."
    if not isinstance(found, dict):
        return None, "its results were changed after sealing."
    return _Sealed(cast("Results", found), seal, listed or ""), ""


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _not_comparable(found: Results, results: Results) -> str:
    """Return why two results cannot be compared; empty if they can."""
    try:
        then, now = found["calibration"], results["calibration"]
        if not then["converged"]:
            return "it did not converge."
        if list(then["image_size"]) != list(now["image_size"]):
            return "its images had another size."
        if is_fisheye(then["camera"]) != is_fisheye(now["camera"]):
            return "it used another kind of lens model."
        lenses = [(one.get("devices") or {}).get("camera", {}).get("lens") for one in (found, results)]
        if lenses[0] != lenses[1]:
            return f"the camera had another lens: {lenses[0] or 'not stated'}."
        return "" if camera_covariance(then) is not None else "its uncertainties are not complete."
    except (KeyError, TypeError, AttributeError):
        return "its results are not readable."


def _compared(run: LedgerRun, found: _Sealed, results: Results) -> PreviousData:
    """Return the earlier calibration with the change of the projection, in px and in units of its uncertainty."""
    then, now, run_of = found.results["calibration"], results["calibration"], found.results["run"]
    conditions = found.results.get("conditions")
    earlier: CameraData = {
        "image_size": list(then["image_size"]),
        "model": then["model"],
        "camera": dict(then["camera"]),
        "sigma": {name: then["sigma"][name] for name in then["camera"]},
        "covariance": _of_camera(then),
        "coverage_factor": coverage_factor(then),
        "coverage_factors": then.get("coverage_factors", {}),
    }
    return {
        "run": run.run_id,
        "number": run.number,
        "finished_utc": run_of.get("finished_utc"),
        "sequence": run_of.get("sequence"),
        "temperature_c": conditions["camera"].get("temperature_c") if conditions else None,
        "seal": found.seal,
        "results_sha256": found.sha256,
        "calibration": earlier,
        "change": change_since(earlier, now),
    }


def _of_camera(calibration: CalibrationData) -> CovarianceData:
    covariance = camera_covariance(calibration)
    assert covariance is not None
    return {"names": list(calibration["camera"]), "matrix": covariance.tolist()}


def change_since(then: CameraData, now: CameraData) -> ChangeData | None:
    """Return the change of the projection over the sensor.

    Returns: ``change`` of results.json (docs/results.md); None if this calibration states no covariance.
    """
    maps = change_maps(then, now)
    if maps is None:
        return None
    offset, expanded = (values.ravel() for values in maps[1:])
    seen = np.isfinite(offset) & np.isfinite(expanded) & (expanded > 0)
    if not seen.any():
        return None
    ratio = offset[seen] / expanded[seen]
    worst = int(np.argmax(ratio))
    return {
        "rms_px": float(np.sqrt(np.mean(offset[seen] ** 2))),
        "largest_px": float(offset[seen].max()),
        "largest_ratio": float(ratio[worst]),
        "px_there": float(offset[seen][worst]),
        "at_px": maps[0].reshape(-1, 2)[seen][worst].tolist(),
    }
