"""Rows of the report's tables about the poses: angles and stars, recordings, gates; and the course of an ``until``.

Rows are empty for a missing part. The course is the expanded uncertainty after each pose, as table and plot.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bench.record.events import UntilDecided
from bench.record.measured_facts import GateData, ImageFacts
from bench.record.results import Numbers, PoseData
from bench.report.svg_plot import INK, MUTED, WIDE, Axes, Picture, Words, axes_in
from bench.report.svg_scale import Scale
from bench.wording.goals import beside_goal, digits_beside, goals_text, meaning_of_goal
from bench.wording.numbers import NOTHING, fixed, number, value_text

_VERDICTS = ("pass", "marginal", "fail")
_COLOURS = ("#0072b2", "#d55e00")
_HEIGHT, _GAP = 195.0, 12.0  # px of the drawing
_MOST_POSES = 8  # Numbers below an axis of a third of the page

_ENDS = {
    "met": "The goals are met",
    "unreachable": "A goal cannot be reached",
    "at_most": "The goals are not met",
    "minutes": "The goals are not met",
    "failures": "The goals are not met",
    "no_pose": "The goals are not met",
}


@dataclass(frozen=True)
class GateRow:
    """One gate as printed, with the values of all recordings it judged."""

    name: str
    limit: str
    values: str
    count: str
    verdict: str


def status_of(pose: PoseData) -> str:
    """Return whether a pose is ``used`` in the calibration, ``not used``, or ``refused``."""
    if pose.get("rms_px") is not None:
        return "used"
    accepted = any(attempt["accepted"] for attempt in pose.get("attempts") or [])
    return "not used" if accepted else "refused"


def explained(pose_data: Sequence[PoseData]) -> set[int]:
    """Return the indices of the poses at which a kind of image is explained: the first ones that have it."""
    first = {(pose.get("image") or {}).get("kind"): pose["index"] for pose in reversed(pose_data)}
    return set(first.values())


def gates(gate_data: Sequence[GateData]) -> list[GateRow]:
    """List each gate once, with the range of the values it judged and its worst verdict."""
    kinds: dict[tuple[str, str, str], list[GateData]] = {}
    for gate in gate_data:
        name = gate.get("gate", gate["name"])
        limit = str(gate["limit"]).replace(">=", "≥").replace("<=", "≤")
        kinds.setdefault((name, limit, str(gate["unit"])), []).append(gate)
    rows = []
    for (name, limit, unit), judged in kinds.items():
        numbers = [gate["value"] for gate in judged]
        lowest, highest = number(min(numbers), 3), number(max(numbers), 3)
        values_text = lowest if lowest == highest else f"{lowest} \N{HORIZONTAL ELLIPSIS} {highest}"
        worst = max((gate["verdict"] for gate in judged), key=_VERDICTS.index)
        passed = sum(gate["verdict"] != "fail" for gate in judged)
        count = f"{passed} of {len(judged)}"
        rows.append(GateRow(name, f"{limit} {unit}".strip(), values_text, count, worst))
    return rows


def angles(numbers: Numbers | None, decimals: int) -> str:
    """Return the angle of each axis, degrees."""
    axes = {axis: angle for axis, angle in (numbers or {}).items() if not axis.endswith("_encoder")}
    return ", ".join(f"{axis} {fixed(angle, decimals)}" for axis, angle in axes.items()) or NOTHING


def motion(pose: PoseData) -> str:
    """Return how far an axis turned at most during a recording, arc seconds."""
    before, after = pose.get("measured_deg") or {}, pose.get("measured_after_deg") or {}
    moved = [abs(after[axis] - before[axis]) for axis in before if axis in after]
    return f"{3600 * max(moved):.1f}" if moved else NOTHING


def image_text(image: ImageFacts) -> str:
    """Return of what the image of a pose was made."""
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


def course_plot(decisions: Sequence[UntilDecided]) -> str:
    """Draw U against the number of poses, with goals; at least one decision has reached an uncertainty."""
    wanted = decisions[-1]["wanted"]
    reached = [decided for decided in decisions if decided["now"]]
    width = WIDE / len(wanted)
    label, about = "Expanded uncertainty after each pose", _about(reached[-1], wanted)
    picture = Picture(WIDE, _HEIGHT, f"course-{decisions[-1]['until']}", label, about)
    for place, (name, colour) in enumerate(zip(wanted, _COLOURS, strict=False)):
        _panel(picture, (place * width, 0.0, width - _GAP, _HEIGHT), reached, name, colour)
    return picture.svg()


def _panel(
    picture: Picture,
    place: tuple[float, float, float, float],
    reached: Sequence[UntilDecided],
    name: str,
    colour: str,
) -> None:
    """Draw one expanded uncertainty with its goal, and with what all allowed poses were last expected to leave."""
    goal = reached[-1]["wanted"][name]
    points = [(decided["poses"], decided["now"][name]) for decided in reached]
    at_end = [decided["at_end"][name] for decided in reached if name in decided.get("at_end", {})][-1:]
    heights = [height for _, height in points] + [goal, *at_end]
    words = Words((f"{meaning_of_goal(name)}, px",), "poses")
    up = Scale(0.7 * min(heights), 1.5 * max(heights), "log")
    axes = axes_in(picture, _poses_scale([n for n, _ in points]), up, words, place=place, grid="y")
    levels = [(goal, "goal", INK), *((height, "expected with all poses allowed", MUTED) for height in at_end)]
    for rank, level in enumerate(sorted(levels, reverse=True)):
        _level(axes, *level, below=rank > 0)
    axes.line(points, colour, 1.2)
    axes.dots(points, colour, 4.5)


def _poses_scale(poses: Sequence[int]) -> Scale:
    """Return the axis of the numbers of poses, with ticks at whole numbers."""
    first, last = poses[0], poses[-1]
    margin = 0.04 * (last - first) or 0.5
    step = max(1, -(-(last - first) // _MOST_POSES))
    return Scale(first - margin, last + margin, ticks=[(n, f"{n}") for n in range(first, last + 1, step)])


def _level(axes: Axes, height: float, name: str, colour: str, *, below: bool) -> None:
    """Draw a level with its name at the left, where the course is far above; the lower of two has it below its line."""
    axes.level(height, colour, 0.9, "4 2.5")
    axes.text((axes.x.low, height), name, by=(3.0, 10.0 if below else -3.0), colour=colour, size=8.5)


def _about(last: UntilDecided, wanted: Mapping[str, float]) -> str:
    parts = [
        f"{meaning_of_goal(name)} {beside_goal(last['now'][name], goal)} px, wanted {goal:g} px"
        for name, goal in wanted.items()
    ]
    return f"After {last['poses']} poses: {'; '.join(parts)}."


def courses(decisions: Sequence[UntilDecided]) -> list[dict[str, Any]]:
    """Return what is printed of the course of each ``until`` of a run, in order, from ``untils`` of results.json."""
    by_until: dict[int, list[UntilDecided]] = {}
    for decided in decisions:
        by_until.setdefault(decided["until"], []).append(decided)
    return [_course(own) for own in by_until.values()]


def _course(decisions: Sequence[UntilDecided]) -> dict[str, Any]:
    last = decisions[-1]
    wanted = last["wanted"]
    return {
        "goals": goals_text(wanted),
        "columns": [meaning_of_goal(name) for name in wanted],
        "rows": [_row(decided) for decided in decisions],
        "end": _end_text(last.get("ended"), last.get("why", "")),
        "minutes": fixed(last["worked_s"] / 60.0, 1),
        "plot": course_plot(decisions) if any(decided["now"] for decided in decisions) else "",
        "factors": _factors(decisions),
    }


def _factors(decisions: Sequence[UntilDecided]) -> str:
    """Return the range of the coverage factors."""
    factors = [k for decided in decisions if (k := decided.get("coverage_factor"))]
    if not factors:
        return NOTHING
    least, most = number(min(factors), 3), number(max(factors), 3)
    return least if least == most else f"{least} to {most}"


def _end_text(end: str | None, why: str) -> str:
    if end == "met":
        return f"{_ENDS[end]}."
    return f"{_ENDS[end]}. {why}" if end in _ENDS else "The step did not end."


def _row(decided: UntilDecided) -> dict[str, Any]:
    chosen: Mapping[str, Any] = decided.get("chosen") or {}
    expected, goals = chosen.get("expected", {}), decided["wanted"]
    axes = chosen.get("angles_deg", {}).items()
    end = _ENDS.get(decided.get("ended", ""), NOTHING).lower()
    return {
        "poses": number(decided["poses"]),
        "model": decided["model"] or NOTHING,
        "reached": [
            number(value, digits_beside(value, goal)) if (value := decided["now"].get(name)) else NOTHING
            for name, goal in goals.items()
        ],
        "chosen": chosen.get("pose_name", NOTHING),
        "angles": ", ".join(f"{axis} {number(angle, 4)}" for axis, angle in axes) or NOTHING,
        "expected": [number(expected.get(name), 3) for name in goals],
        "why": decided.get("problem") or chosen.get("why") or end,
    }
