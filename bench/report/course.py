"""The course of an ``until``: the expanded uncertainty after each pose, as a table and a plot, and how the step ended.

The data are the decisions of the journal, as results.json holds them under ``untils``. The plot is drawn by
`bench.report.course_plot`, so that text alone needs no arrays.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bench.records.events import UntilDecided
from bench.report.text import NOTHING, fixed, number
from bench.report.until_text import goals_text, meaning_of_goal

_ENDS = {
    "met": "The goals are met",
    "unreachable": "A goal cannot be reached",
    "at_most": "The goals are not met",
    "minutes": "The goals are not met",
    "failures": "The goals are not met",
    "no_pose": "The goals are not met",
}


@dataclass(frozen=True)
class CourseRow:
    """One decision, as printed."""

    poses: str
    model: str
    reached: tuple[str, ...]  # Expanded uncertainty for each goal, px
    chosen: str
    angles: str
    expected: tuple[str, ...]  # Expanded uncertainty that the choice expected for each goal, px
    why: str  # Why there is no calibration yet, why this pose was chosen, or how the step ended


@dataclass(frozen=True)
class Course:
    """The course of one ``until``, as printed."""

    goals: str
    columns: tuple[str, ...]
    rows: tuple[CourseRow, ...]  # The decisions, in order
    met: bool  # Whether the goals are met
    end: str
    minutes: str
    plot: str  # SVG; empty if nothing is drawn or no uncertainty was reached
    factors: str


def courses(decisions: Sequence[UntilDecided], *, draw: bool = True) -> list[Course]:
    """Return the course of each ``until`` of a run.

    decisions: ``untils`` of results.json: what each ``until`` decided, in order.
    draw: Whether to draw the plots.
    Returns: One for each ``until``, in the order of the run.
    """
    by_until: dict[int, list[UntilDecided]] = {}
    for decided in decisions:
        by_until.setdefault(decided["until"], []).append(decided)
    return [_course(own, draw=draw) for own in by_until.values()]


def _course(decisions: Sequence[UntilDecided], *, draw: bool) -> Course:
    last = decisions[-1]
    wanted = last["wanted"]
    end = last.get("ended")
    plot = ""
    if draw and any(decided["now"] for decided in decisions):
        from bench.report.course_plot import course_plot

        plot = course_plot(decisions)
    return Course(
        goals_text(wanted),
        tuple(meaning_of_goal(name) for name in wanted),
        tuple(_row(decided) for decided in decisions),
        end == "met",
        _end_text(end, last.get("why", "")),
        fixed(last["worked_s"] / 60.0, 1),
        plot,
        _factors(decisions),
    )


def _factors(decisions: Sequence[UntilDecided]) -> str:
    """Return the range of the coverage factors."""
    found = [k for decided in decisions if (k := decided.get("coverage_factor"))]
    if not found:
        return NOTHING
    least, most = number(min(found), 3), number(max(found), 3)
    return least if least == most else f"{least} to {most}"


def _end_text(end: str | None, why: str) -> str:
    if end == "met":
        return f"{_ENDS[end]}."
    return f"{_ENDS[end]}. {why}" if end in _ENDS else "The step did not end."


def _row(decided: UntilDecided) -> CourseRow:
    chosen: Mapping[str, Any] = decided.get("chosen") or {}
    expected: Mapping[str, float] = chosen.get("expected", {})
    goals = decided["wanted"]
    angles = ", ".join(f"{axis} {number(angle, 4)}" for axis, angle in chosen.get("angles_deg", {}).items())
    return CourseRow(
        number(decided["poses"]),
        decided["model"] or NOTHING,
        tuple(number(decided["now"].get(name), 3) for name in goals),
        chosen.get("pose_name", NOTHING),
        angles or NOTHING,
        tuple(number(expected.get(name), 3) for name in goals),
        decided.get("problem") or chosen.get("why") or _ENDS.get(decided.get("ended", ""), NOTHING).lower(),
    )
