"""Plot of the course of an ``until``: the expanded uncertainty against the number of poses, with its goals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.report.drawing import INK, MUTED, WIDE
from bench.report.plot_frame import Words, axes_in
from bench.report.scales import Scale
from bench.report.svg_plot import Axes, Picture
from bench.report.until_text import meaning_of_goal

_COLOURS = ("#0072b2", "#d55e00")
_HEIGHT, _GAP = 195.0, 12.0
_MOST_POSES = 8


def course_plot(decisions: Sequence[Mapping[str, Any]]) -> str:
    """Draw the expanded uncertainties against the number of poses, with their goals.

    decisions: Decisions of one ``until``, in order; at least one has reached an uncertainty.
    """
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
    reached: Sequence[Mapping[str, Any]],
    name: str,
    colour: str,
) -> None:
    """Draw one expanded uncertainty with its goal, and with the part that poses do not lower."""
    goal = reached[-1]["wanted"][name]
    points = [(decided["poses"], decided["now"][name]) for decided in reached]
    fixed_px = sum(part**2 for part in reached[-1]["fixed"].get(name, {}).values()) ** 0.5
    heights = [height for _, height in points] + [goal] + ([fixed_px] if fixed_px > 0 else [])
    words = Words((f"{meaning_of_goal(name)}, px",), "poses")
    up = Scale(0.7 * min(heights), 1.5 * max(heights), "log")
    axes = axes_in(picture, _poses_scale([n for n, _ in points]), up, words, place=place, grid="y")
    _goal_line(axes, goal, "goal", INK)
    if fixed_px > 0:
        _goal_line(axes, fixed_px, "does not depend on the poses", MUTED)
    axes.line(points, colour, 1.2)
    axes.dots(points, colour, 4.5)


def _poses_scale(poses: Sequence[int]) -> Scale:
    """Return the axis of the numbers of poses, with ticks at whole numbers."""
    first, last = poses[0], poses[-1]
    beside = 0.04 * (last - first) or 0.5
    step = max(1, -(-(last - first) // _MOST_POSES))
    return Scale(first - beside, last + beside, ticks=[(n, f"{n}") for n in range(first, last + 1, step)])


def _goal_line(axes: Axes, height: float, name: str, colour: str) -> None:
    axes.level(height, colour, 0.9, "4 2.5")
    axes.text((axes.x.high, height), name, by=(-2.0, -3.0), colour=colour, anchor="end", size=8.5)


def _about(last: Mapping[str, Any], wanted: Mapping[str, float]) -> str:
    parts = [
        f"{meaning_of_goal(name)} {last['now'][name]:.3g} px, wanted {goal:g} px"
        for name, goal in wanted.items()
    ]
    return f"After {last['poses']} poses: {'; '.join(parts)}."
