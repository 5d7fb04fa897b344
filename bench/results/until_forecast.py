"""Forecast of an ``until`` before anything moves: how many poses it will need, and what it will reach.

The poses are chosen as in a run, on the bench that the station expects.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from bench.plan.plan import Plan
from bench.report.until_text import goals_text, meaning_of_goal
from bench.results.fixed_parts import fixed_parts
from bench.results.forecasts import forecast_bench
from bench.results.next_pose import Choice, Wish, choose_pose
from calib.errors import DegenerateViews, TooFewStars
from calib.studies.planning import Forecast, forecast
from calib.studies.predicted_views import ExpectedBench
from sequences.script import RecordStep, Until

HOPELESS = 4.0
"""The forecast ends when it expects this many times more poses than are allowed."""


@dataclass(frozen=True)
class ExpectedCourse:
    """What an ``until`` is expected to do."""

    until: int  # Number of its first step
    # Expected number of accepted recordings of the step; None if it will not meet its goals.
    poses: int | None
    reached: Mapping[str, float]  # Expanded uncertainties expected at its end, px, by name of the goal
    text: str

    def to_dict(self) -> dict[str, Any]:
        """Return the expectation for JSON output."""
        return asdict(self)


def expected_courses(planned: Plan) -> list[ExpectedCourse]:
    """Predict what each ``until`` of a plan will do.

    planned: A plan without faults.
    Returns: One for each ``until``; empty if the station expects nothing.
    """
    if planned.station.value.expected is None:
        return []
    return [_course(planned, until) for until in planned.untils]


def _course(planned: Plan, until: Until) -> ExpectedCourse:
    before = [
        step.pose
        for step in planned.script
        if isinstance(step, RecordStep) and not step.pose.chosen_in_run and step.pose.index < until.poses.stop
    ]
    record = next(
        s for s in planned.script if isinstance(s, RecordStep) and s.pose.index == until.poses.start
    )
    taken = [{f"{axis}_deg": angle for axis, angle in pose.angles_deg.items()} for pose in before]
    earlier, bench = len(taken) - until.starts, forecast_bench(planned)
    wish = Wish(until.goals, {}, roll=False, needs_tag=True, min_stars=record.gates.min_stars)
    while True:
        recorded = len(taken) - earlier
        found = _forecast(bench, taken)
        reached = {name: found.limited[name.removesuffix("_px")] for name in until.goals} if found else {}
        if reached and all(reached[name] <= goal for name, goal in until.goals.items()):
            text = f"about {recorded} poses until {goals_text(until.goals)}"
            return ExpectedCourse(until.first, recorded, reached, f"Expected: {text}.")
        if why := _why_not(until, found, reached, recorded, len(taken)):
            return ExpectedCourse(until.first, None, reached, f"Expected: {why}")
        choice = choose_pose(
            planned.station,
            None,
            bench.passport,
            taken_deg=taken,
            refused_deg=[],
            wish=wish,
            readings=bench.readings,
        )
        if not isinstance(choice, Choice):
            return ExpectedCourse(until.first, None, reached, f"Expected: {choice}")
        taken.append(dict(choice.angles_deg))


def _forecast(bench: ExpectedBench, taken: list[dict[str, float]]) -> Forecast | None:
    """Return the forecast for these poses; None if they do not suffice."""
    try:
        return forecast(bench, taken) if taken else None
    except (TooFewStars, DegenerateViews):
        return None


def _why_not(
    until: Until, found: Forecast | None, reached: Mapping[str, float], recorded: int, poses: int
) -> str:
    """Return why the goals will not be met; empty if further poses can still help."""
    if found is None or not reached:
        return "" if recorded < until.at_most else "the poses will not determine the camera."
    goals = until.goals
    parts = fixed_parts(found.budget_rows, max(1.0, (poses + until.at_most - recorded) / poses))
    for name, goal in goals.items():
        sources = parts.get(name, {})
        if np.sqrt(sum(part**2 for part in sources.values())) > goal:
            largest = max(sources, key=lambda source: sources[source])
            return (
                f"the goal of {goal:g} px for {meaning_of_goal(name)} cannot be reached. More poses do not reduce "
                f"all parts of U. The largest of these parts: {largest}, {sources[largest]:.2g} px (k = 2)."
            )
    share = max(reached[name] / goal for name, goal in goals.items())
    if recorded >= until.at_most or recorded * share**2 > HOPELESS * until.at_most:
        return f"{until.at_most} poses do not suffice until {goals_text(goals)}."
    return ""
