"""Rows of the report's tables about the run as a whole: item, inputs, software, alerts, deviations.

Each function takes a part of results.json and returns rows of printed text. The rows are empty if the part is missing;
the page then omits the table.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bench.records.events import FailureData, LedgerPlace
from bench.records.results import Results, RunData
from bench.report.bench_knowledge import passport_rows, readings_rows
from bench.report.pose_tables import gates
from bench.report.target_words import words_of
from bench.report.text import NOTHING, moment, value_text

_ENDS = {"open": "without an end"}
"""Words for the ends of runs in the ledger."""


def identification(results: Results) -> list[tuple[str, str]]:
    """Identify what was calibrated, by whom, where and when (ISO/IEC 17025, 7.8.2.1)."""
    run = results["run"]
    camera = (results.get("devices") or {}).get("camera") or {}
    ledger, collimator = run.get("ledger"), run.get("collimator")
    entered = _ledger_rows(ledger) if ledger else []
    item = " ".join(str(camera[key]) for key in ("maker", "model", "sensor") if camera.get(key))
    return [
        ("Item", item or NOTHING),
        ("Serial number", value_text(camera.get("serial"))),
        ("Firmware", value_text(camera.get("firmware"))),
        ("Lens", value_text(camera.get("lens"))),
        *([("Collimator", _collimator(collimator))] if collimator else []),
        *([("Target", _target(run["target"]))] if run.get("target") else []),
        ("Laboratory", value_text(run.get("laboratory"))),
        ("Operator", value_text(run.get("operator"))),
        ("Sequence", value_text(run.get("sequence"))),
        ("Station", value_text(run.get("station"))),
        *_times(run),
        *entered,
    ]


def inputs(results: Results) -> list[tuple[str, str]]:
    """List what the calibration used besides its recordings: the passport of the collimator, the gimbal's readings."""
    readings = results.get("gimbal_readings")
    if readings and words_of(results).is_board and not readings["entered"]:
        readings = None  # the board was moved, not the camera
    return [
        *passport_rows(results.get("passport")),
        *readings_rows(readings, results["calibration"].get("gimbal")),
    ]


def _times(run: RunData) -> list[tuple[str, str]]:
    """List when the run was, or when files were calibrated without devices."""
    if run.get("offline"):
        of_run = [("Calibrated from run", str(run["of_run"]))] if run.get("of_run") else []
        return [*of_run, ("Calibrated, without devices", moment(run.get("calibrated_utc")))]
    return [("Started", moment(run.get("started_utc"))), ("Finished", moment(run.get("finished_utc")))]


def _collimator(details: Mapping[str, Any]) -> str:
    """Return in one line what the station file says about the collimator."""
    parts = []
    if "serial" in details:
        parts.append(f"serial number {details['serial']}")
    if "nominal_r_mm" in details:
        parts.append(f"nominal focal length {details['nominal_r_mm']:g} mm")
    certificate = details.get("certificate")
    if isinstance(certificate, Mapping):
        parts.append(f"certificate {certificate['number']}")
    elif certificate:
        parts.append(f"certificate {certificate}")
    if "temperature_c" in details:
        parts.append(f"at {details['temperature_c']:g} °C")
    return ", ".join(parts) or NOTHING


def _target(details: Mapping[str, Any]) -> str:
    """Return in one line what the station file says about the target as an object."""
    serial = [f"serial number {details['serial']}"] if "serial" in details else []
    return ", ".join([*serial, *([str(details["description"])] if "description" in details else [])])


def software(results: Results) -> list[tuple[str, str]]:
    """List the programs that computed the result, and the seed of a simulated bench."""
    run = results["run"]
    plugins = run.get("plugins") or {}
    rows = [
        (str(name), f"{version} (plug-in: {', '.join(plugins[name])})" if name in plugins else str(version))
        for name, version in (run.get("software") or {}).items()
    ]
    if run.get("seed") is not None:
        rows.append(("seed", str(run["seed"])))
    return rows


def alerts(results: Results) -> list[str]:
    """List what a reader must know before using the values: doubts of the calibration, gates, and every deviation.

    Returns: A sentence for each note that doubts the values, each gate that did not pass, each ``until`` that did not
      meet its goals, and each deviation.
    """
    calibration = results["calibration"]
    remarks = calibration.get("remarks") or ()
    doubts = [note for note in calibration.get("notes") or () if note not in remarks]
    details = [
        f"Gate {row.name}: {row.verdict} ({row.values}, limit {row.limit}; {row.count} passed)."
        for row in gates(results.get("gates") or [], words_of(results))
        if row.verdict != "pass"
    ]
    missed = [
        f"The goal of a step was not met. {decided['why']}"
        for decided in results.get("untils") or []
        if decided.get("ended", "met") != "met"
    ]
    return details + missed + doubts + deviations(results)


def deviations(results: Results) -> list[str]:
    """List the errors that ended the run before it was resumed, and every departure from the sequence."""
    failures = [_failure_text(error) for error in results.get("failures") or []]
    return failures + [str(deviation) for deviation in results.get("deviations") or []]


def _failure_text(error: FailureData) -> str:
    place = f" ({error['where']})" if error["where"] else ""
    return f"The run failed and was resumed. {error['kind']}{place}: {error['what']}"


def _ledger_rows(ledger: LedgerPlace) -> list[tuple[str, str]]:
    rows = [("Number of the run", _place_in_ledger(ledger)), ("Line of the ledger", str(ledger["head"]))]
    return rows + [("Ledger", f"BROKEN. {fault}") for fault in ledger.get("faults") or []]


def _place_in_ledger(ledger: LedgerPlace) -> str:
    earlier = dict(ledger["of_camera"])
    earlier["open"] = earlier.get("open", 0) - 1  # this run was entered when it began
    counts = ", ".join(f"{count} {_ENDS.get(how, how)}" for how, count in earlier.items() if count > 0)
    return f"{ledger['number']} of this bench; earlier runs of this camera: {counts or 'none'}"
