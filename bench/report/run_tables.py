"""Rows of the report's tables about the run: item and devices, poses, recordings, gates, conditions.

Each function takes a part of results.json and returns rows of printed text. The rows are empty if the part is missing;
the page then omits the table.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bench.base.device_ends import DeviceEnd
from bench.report.bench_knowledge import passport_rows, readings_rows
from bench.report.text import NOTHING, duration, fixed, moment, number, value_text

Json = Mapping[str, Any]

_POSE_PREFIX = re.compile(r"pose \d+: ")
_VERDICTS = ("pass", "marginal", "fail")
_STATUS_VERDICTS = {"used": "pass", "not used": "marginal", "refused": "fail"}
_ENDS = {"open": "without an end"}
"""Words for the ends of runs in the ledger."""


@dataclass(frozen=True)
class DeviceRow:
    """The identity that one device reported, as printed."""

    name: str
    model: str
    serial: str
    firmware: str
    details: str


@dataclass(frozen=True)
class PoseRow:
    """One pose as printed: its angles, its stars and its image."""

    name: str
    commanded: str
    measured: str
    moved: str
    stars: str
    rms: str
    flicker: str
    image: str
    reason: str
    status: str
    verdict: str


@dataclass(frozen=True)
class RecordingRow:
    """One recording as printed, accepted or refused."""

    pose: str
    attempt: str
    accepted: bool
    reasons: str
    events: str
    rate: str
    triggers: str
    duration: str
    pictures: str
    saturated: str
    capture: str
    sha256: str


@dataclass(frozen=True)
class GateRow:
    """One gate as printed, with the values of all recordings it judged."""

    name: str
    limit: str
    values: str
    count: str
    verdict: str


def identification(results: Json) -> list[tuple[str, str]]:
    """Identify what was calibrated, by whom, where and when (ISO/IEC 17025, 7.8.2.1).

    Parameters
    ----------
    results
        Content of results.json.

    Returns
    -------
    list of tuple
        Name and value.
    """
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


def inputs(results: Json) -> list[tuple[str, str]]:
    """List what the calibration used besides its recordings: the passport of the collimator, the gimbal's readings.

    Parameters
    ----------
    results
        Content of results.json.

    Returns
    -------
    list of tuple
        Name and value.
    """
    return [
        *passport_rows(results.get("passport")),
        *readings_rows(results.get("gimbal_readings"), results["calibration"].get("gimbal")),
    ]


def _times(run: Json) -> list[tuple[str, str]]:
    """List when the run was, or when files were calibrated without devices."""
    if run.get("offline"):
        of_run = [("Calibrated from run", str(run["of_run"]))] if run.get("of_run") else []
        return [*of_run, ("Calibrated, without devices", moment(run.get("calibrated_utc")))]
    return [("Started", moment(run.get("started_utc"))), ("Finished", moment(run.get("finished_utc")))]


def _collimator(details: Json) -> str:
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


def _target(details: Json) -> str:
    """Return in one line what the station file says about the target as an object."""
    serial = [f"serial number {details['serial']}"] if "serial" in details else []
    return ", ".join([*serial, *([str(details["description"])] if "description" in details else [])])


def software(results: Json) -> list[tuple[str, str]]:
    """List the programs that computed the result, and the seed of a simulated bench.

    Parameters
    ----------
    results
        Content of results.json.

    Returns
    -------
    list of tuple
        Name and version.
    """
    run = results["run"]
    rows = [(str(name), str(version)) for name, version in (run.get("software") or {}).items()]
    if run.get("seed") is not None:
        rows.append(("seed", str(run["seed"])))
    return rows


def conditions(found: Json) -> list[tuple[str, str]]:
    """List the settings of light and camera, and the temperature.

    Parameters
    ----------
    found
        ``conditions`` of results.json.

    Returns
    -------
    list of tuple
        Name of the device and the setting, and the value with its unit.
    """
    rows = []
    for part, settings in found.items():
        if isinstance(settings, Mapping):
            rows += [(f"{part}: {_readable(key)}", _with_unit(key, value)) for key, value in settings.items()]
        else:
            rows.append((_readable(part), _with_unit(part, settings)))
    return rows


def devices(found: Json) -> list[DeviceRow]:
    """List the identities that the devices reported.

    Parameters
    ----------
    found
        ``devices`` of results.json.

    Returns
    -------
    list of DeviceRow
        A row for each device that has a serial number.
    """
    rows = []
    for part, identities in found.items():
        for identity in identities if isinstance(identities, list) else [identities]:
            if "serial" not in identity:  # settings, not a device
                continue
            facts = dict(identity)
            name = f"{part}: {facts.pop('name')}" if "name" in facts else part
            model = " ".join(str(facts.pop(key)) for key in ("maker", "model") if facts.get(key))
            serial, firmware = value_text(facts.pop("serial")), value_text(facts.pop("firmware", None))
            details = ", ".join(
                f"{_readable(key)} {value_text(value)}" for key, value in facts.items() if value is not None
            )
            rows.append(DeviceRow(name, model or NOTHING, serial, firmware, details))
    return rows


def connections(found: Json) -> list[tuple[str, str]]:
    """List what the devices answered about the cables between them and to the computer.

    Parameters
    ----------
    found
        ``devices`` of results.json.

    Returns
    -------
    list of tuple
        Name and value; empty if the run did not ask.
    """
    return [(_readable(name), str(value)) for name, value in (found.get("connections") or {}).items()]


def left(found: Sequence[Mapping[str, str]]) -> list[tuple[str, str, str]]:
    """List how each device was left after the last step that needs devices.

    Parameters
    ----------
    found
        ``devices_left`` of results.json.

    Returns
    -------
    list of tuple
        Device, state, and what it answered, or what may be the case.
    """
    ends = [DeviceEnd.from_dict(end) for end in found]
    return [(end.device, end.state, " ".join(filter(None, (end.said, end.advice)))) for end in ends]


def poses(found: Sequence[Json]) -> list[PoseRow]:
    """List the poses with their commanded and measured angles and their stars.

    Parameters
    ----------
    found
        ``poses`` of results.json.

    Returns
    -------
    list of PoseRow
        A row for each pose. The reason for a kind of image stands in the first row that has this kind.
    """
    rows: list[PoseRow] = []
    kinds: set[object] = set()
    for pose in found:
        image, status = pose.get("image") or {}, _status(pose)
        rows.append(
            PoseRow(
                name=str(pose["name"]),
                commanded=_angles(pose.get("commanded_deg"), 3),
                measured=_angles(pose.get("measured_deg"), 4),
                moved=_motion(pose.get("measured_deg") or {}, pose.get("measured_after_deg") or {}),
                stars=_stars(pose),
                rms=number(pose.get("rms_px"), 3),
                flicker=number(pose.get("flicker_hz"), 6),
                image=_image(image),
                reason="" if image.get("kind") in kinds else str(image.get("reason") or ""),
                status=status,
                verdict=_STATUS_VERDICTS[status],
            )
        )
        kinds.add(image.get("kind"))
    return rows


def _status(pose: Json) -> str:
    """Return whether a pose is part of the calibration."""
    if pose.get("rms_px") is not None:
        return "used"
    accepted = any(attempt["accepted"] for attempt in pose.get("attempts") or [])
    return "not used" if accepted else "refused"


def _stars(pose: Json) -> str:
    """Return the number of stars of a pose, and what identified them if it was not the tag."""
    return number(pose.get("stars")) + (
        ", identified by the gimbal" if pose.get("named_by") == "gimbal" else ""
    )


def recordings(found: Sequence[Json]) -> list[RecordingRow]:
    """List every recording, including refused ones.

    Parameters
    ----------
    found
        ``poses`` of results.json.

    Returns
    -------
    list of RecordingRow
        A row for each attempt at each pose.
    """
    return [
        RecordingRow(
            pose=str(pose["name"]),
            attempt=str(attempt["attempt"]),
            accepted=bool(attempt["accepted"]),
            reasons="; ".join(attempt.get("reasons") or []),
            events=number(attempt.get("events")),
            rate=number(attempt.get("event_rate_mev_s"), 3),
            triggers=number(attempt.get("triggers")),
            duration=duration(attempt["duration_s"]) if attempt.get("duration_s") else NOTHING,
            pictures=number(attempt.get("pictures")),
            saturated=number(attempt.get("saturated_percent"), 2),
            capture=str(attempt.get("capture") or NOTHING),
            sha256=str(attempt.get("sha256") or NOTHING),
        )
        for pose in found
        for attempt in pose.get("attempts") or []
    ]


def gates(found: Sequence[Json]) -> list[GateRow]:
    """List each gate once, with the range of the values it judged and its worst verdict.

    Parameters
    ----------
    found
        ``gates`` of results.json.

    Returns
    -------
    list of GateRow
        A row for each combination of gate, limit and unit.
    """
    kinds: dict[tuple[str, str, str], list[Json]] = {}
    for gate in found:
        name = _POSE_PREFIX.sub("", str(gate["name"]), count=1)
        limit = str(gate["limit"]).replace(">=", "≥").replace("<=", "≤")
        kinds.setdefault((name, limit, str(gate["unit"])), []).append(gate)
    rows = []
    for (name, limit, unit), judged in kinds.items():
        numbers = [gate["value"] for gate in judged]
        lowest, highest = number(min(numbers), 3), number(max(numbers), 3)
        values_text = lowest if lowest == highest else f"{lowest} \N{HORIZONTAL ELLIPSIS} {highest}"
        worst = max((gate["verdict"] for gate in judged), key=_VERDICTS.index)
        passed = sum(gate["verdict"] != "fail" for gate in judged)
        rows.append(
            GateRow(name, f"{limit} {unit}".strip(), values_text, f"{passed} of {len(judged)}", worst)
        )
    return rows


def alerts(results: Json) -> list[str]:
    """List what a reader must know before using the values: gates that did not pass, and every deviation.

    Parameters
    ----------
    results
        Content of results.json.

    Returns
    -------
    list of str
        A sentence for each gate, each ``until`` that did not meet its goals, and each deviation.
    """
    details = [
        f"Gate {row.name}: {row.verdict} ({row.values}, limit {row.limit}; {row.count} passed)."
        for row in gates(results.get("gates") or [])
        if row.verdict != "pass"
    ]
    missed = [
        f"The goal of a step was not met. {decided['why']}"
        for decided in results.get("untils") or []
        if decided.get("ended", "met") != "met"
    ]
    return details + missed + deviations(results)


def deviations(results: Json) -> list[str]:
    """List the errors that ended the run before it was resumed, and every departure from the sequence.

    Parameters
    ----------
    results
        Content of results.json.

    Returns
    -------
    list of str
        A sentence or two for each.
    """
    failures = [_failure_text(error) for error in results.get("failures") or []]
    return failures + [str(deviation) for deviation in results.get("deviations") or []]


def _failure_text(error: Json) -> str:
    place = f" ({error['where']})" if error["where"] else ""
    return f"The run failed and was resumed. {error['kind']}{place}: {error['what']}"


def _ledger_rows(ledger: Json) -> list[tuple[str, str]]:
    rows = [("Number of the run", _place_in_ledger(ledger)), ("Line of the ledger", str(ledger["head"]))]
    return rows + [("Ledger", f"BROKEN. {fault}") for fault in ledger.get("faults") or []]


def _place_in_ledger(ledger: Json) -> str:
    earlier = dict(ledger["of_camera"])
    earlier["open"] = earlier.get("open", 0) - 1  # this run was entered when it began
    counts = ", ".join(f"{count} {_ENDS.get(how, how)}" for how, count in earlier.items() if count > 0)
    return f"{ledger['number']} of this bench; earlier runs of this camera: {counts or 'none'}"


def _angles(found: Json | None, decimals: int) -> str:
    axes = {axis: angle for axis, angle in (found or {}).items() if not axis.endswith("_encoder")}
    return ", ".join(f"{axis} {fixed(angle, decimals)}" for axis, angle in axes.items()) or NOTHING


def _motion(before: Json, after: Json) -> str:
    moved = [abs(after[axis] - before[axis]) for axis in before if axis in after]
    return f"{3600 * max(moved):.1f}" if moved else NOTHING


def _image(image: Json) -> str:
    details = [str(image["kind"])] if image.get("kind") else []
    if image.get("periods"):
        details.append(f"{value_text(image['periods'])} periods")
    if image.get("events_per_edge") is not None:
        details.append(f"{number(image['events_per_edge'], 2)} events per edge")
    if image.get("on_share") is not None:
        details.append(f"{100 * image['on_share']:.0f} % ON")
    if image.get("hot_pixels") is not None:
        details.append(f"{value_text(image['hot_pixels'])} hot pixels")
    return ", ".join(details) or NOTHING


_UNIT_ENDINGS = {"_hz": "Hz", "_c": "°C", "_v": "V", "_percent": "%", "_lux": "lx", "_us": "µs", "_s": "s"}


def _readable(key: str) -> str:
    for ending in _UNIT_ENDINGS:
        key = key.removesuffix(ending)
    return key.replace("_", " ")


def _with_unit(key: str, value: Any) -> str:
    unit = next((unit for ending, unit in _UNIT_ENDINGS.items() if key.endswith(ending)), "")
    printed = value_text(value)
    return printed if printed == NOTHING or not unit else f"{printed} {unit}"
