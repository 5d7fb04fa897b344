"""Rows of the report's tables about the poses: angles and stars, recordings, gates; none for a missing part."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from bench.records.events import GateData, ImageFacts
from bench.records.results import Numbers, PoseData
from bench.report.text import NOTHING, STARS, TargetWords, duration, fixed, number, value_text

_POSE_PREFIX = re.compile(r"pose \d+: ")
_VERDICTS = ("pass", "marginal", "fail")
_STATUS_VERDICTS = {"used": "pass", "not used": "marginal", "refused": "fail"}


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


def poses(found: Sequence[PoseData]) -> list[PoseRow]:
    """List poses with commanded and measured angles and stars; a kind of image is explained where it is first."""
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


def _status(pose: PoseData) -> str:
    """Return whether a pose is part of the calibration."""
    if pose.get("rms_px") is not None:
        return "used"
    accepted = any(attempt["accepted"] for attempt in pose.get("attempts") or [])
    return "not used" if accepted else "refused"


def _stars(pose: PoseData) -> str:
    """Return the number of stars of a pose, and what identified them if it was not the tag."""
    return number(pose.get("stars")) + (
        ", identified by the gimbal" if pose.get("named_by") == "gimbal" else ""
    )


def recordings(found: Sequence[PoseData], words: TargetWords = STARS) -> list[RecordingRow]:
    """List every recording, including refused ones."""
    return [
        RecordingRow(
            pose=str(pose["name"]),
            attempt=str(attempt["attempt"]),
            accepted=bool(attempt["accepted"]),
            reasons=words.fitting("; ".join(attempt.get("reasons") or [])),
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


def gates(found: Sequence[GateData], words: TargetWords = STARS) -> list[GateRow]:
    """List each gate once, with the range of the values it judged and its worst verdict."""
    kinds: dict[tuple[str, str, str], list[GateData]] = {}
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
            GateRow(
                words.fitting(name),
                f"{limit} {unit}".strip(),
                values_text,
                f"{passed} of {len(judged)}",
                worst,
            )
        )
    return rows


def _angles(found: Numbers | None, decimals: int) -> str:
    axes = {axis: angle for axis, angle in (found or {}).items() if not axis.endswith("_encoder")}
    return ", ".join(f"{axis} {fixed(angle, decimals)}" for axis, angle in axes.items()) or NOTHING


def _motion(before: Numbers, after: Numbers) -> str:
    moved = [abs(after[axis] - before[axis]) for axis in before if axis in after]
    return f"{3600 * max(moved):.1f}" if moved else NOTHING


def _image(image: ImageFacts) -> str:
    details = [str(image["kind"])] if image.get("kind") else []
    if image.get("periods"):
        details.append(f"{value_text(image['periods'])} periods")
    if image.get("events_per_edge") is not None:
        details.append(f"{number(image['events_per_edge'], 2)} events per edge")
    if (on_share := image.get("on_share")) is not None:
        details.append(f"{100 * on_share:.0f} % ON")
    if image.get("hot_pixels") is not None:
        details.append(f"{value_text(image['hot_pixels'])} hot pixels")
    return ", ".join(details) or NOTHING
