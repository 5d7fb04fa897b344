"""Rows of the report's tables on the run: who and what took part, poses, recordings, gates, conditions.

Knows the structure of results.json; each function takes a part of it and gives rows of printed text, empty where the
part is missing, so that the page can leave the table out.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bench.report.text import NOTHING, duration, fixed, moment, number, value_text

Json = Mapping[str, Any]

_POSE_PREFIX = re.compile(r"pose \d+: ")
_VERDICTS = ("pass", "marginal", "fail")


@dataclass(frozen=True)
class DeviceRow:
    """One device as it named itself."""

    name: str
    model: str
    serial: str
    firmware: str
    details: str


@dataclass(frozen=True)
class PoseRow:
    """One pose as it was made and found."""

    name: str
    commanded: str
    measured: str
    moved: str
    stars: str
    rms: str
    flicker: str
    image: str
    reason: str


@dataclass(frozen=True)
class RecordingRow:
    """One recording, accepted or not."""

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
    """One gate over all recordings it was asked of."""

    name: str
    limit: str
    values: str
    count: str
    verdict: str


def identification(results: Json) -> list[tuple[str, str]]:
    """Say what was calibrated, by whom, where and when."""
    run = results["run"]
    camera = (results.get("devices") or {}).get("camera") or {}
    ledger, collimator = run.get("ledger"), run.get("collimator")
    entered = [("In the laboratory's ledger", _place_in_ledger(ledger))] if ledger else []
    item = " ".join(str(camera[key]) for key in ("maker", "model", "sensor") if camera.get(key))
    return [
        ("Item", item or NOTHING),
        ("Serial number", value_text(camera.get("serial"))),
        ("Firmware", value_text(camera.get("firmware"))),
        ("Lens", value_text(camera.get("lens"))),
        *([("Collimator", _collimator(collimator))] if collimator else []),
        ("Laboratory", value_text(run.get("laboratory"))),
        ("Operator", value_text(run.get("operator"))),
        ("Sequence", value_text(run.get("sequence"))),
        ("Station", value_text(run.get("station"))),
        ("Started", moment(run.get("started_utc"))),
        ("Finished", moment(run.get("finished_utc"))),
        *entered,
    ]


def _collimator(details: Json) -> str:
    """Say in one line what the station file says of the collimator."""
    parts = []
    if "serial" in details:
        parts.append(f"serial {details['serial']}")
    if "nominal_r_mm" in details:
        parts.append(f"nominal focal length {details['nominal_r_mm']:g} mm")
    if "certificate" in details:
        parts.append(f"certificate {details['certificate']}")
    return ", ".join(parts)


def software(results: Json) -> list[tuple[str, str]]:
    """Name the programs that took part, and the seed of a simulated bench."""
    run = results["run"]
    rows = [(str(name), str(version)) for name, version in (run.get("software") or {}).items()]
    if run.get("seed") is not None:
        rows.append(("seed", str(run["seed"])))
    return rows


def conditions(found: Json) -> list[tuple[str, str]]:
    """List the settings and surroundings of the recordings."""
    rows = []
    for part, settings in found.items():
        if isinstance(settings, Mapping):
            rows += [(f"{part}: {_readable(key)}", _with_unit(key, value)) for key, value in settings.items()]
        else:
            rows.append((_readable(part), _with_unit(part, settings)))
    return rows


def devices(found: Json) -> list[DeviceRow]:
    """List who the devices said they were."""
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


def poses(found: Sequence[Json]) -> list[PoseRow]:
    """Give each pose as it was commanded, measured and found."""
    rows = []
    for pose in found:
        image = pose.get("image") or {}
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
                reason=str(image.get("reason") or ""),
            )
        )
    return rows


def _stars(pose: Json) -> str:
    """Number of stars of a pose, and what named them where it was not the tag."""
    return number(pose.get("stars")) + (", named by the gimbal" if pose.get("named_by") == "gimbal" else "")


def recordings(found: Sequence[Json]) -> list[RecordingRow]:
    """List every recording, refused ones too."""
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
        for attempt in pose["attempts"]
    ]


def gates(found: Sequence[Json]) -> list[GateRow]:
    """Give each gate once, with the range of values it judged and its worst verdict."""
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
    """Tell what a reader must know before the numbers: verdicts that are no pass, and every deviation."""
    details = [
        f"Gate {row.verdict}: {row.name}: {row.values}, limit {row.limit} ({row.count} passed)."
        for row in gates(results.get("gates") or [])
        if row.verdict != "pass"
    ]
    return details + [str(deviation) for deviation in results.get("deviations") or []]


def _place_in_ledger(ledger: Json) -> str:
    standing = ", ".join(f"{count} {how}" for how, count in ledger["of_camera"].items())
    return f"run {ledger['number']}; of this camera {standing}, this one included"


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
        details.append(f"{number(image['events_per_edge'], 2)} events an edge")
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
