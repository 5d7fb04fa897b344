"""What a plan is expected to reach: the course of each ``until``, and the uncertainty that the poses then give.

A course takes the choices and the ends of a run (`bench.solve.next_pose`), on the bench that the station expects.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from bench.plan.plan import Plan
from bench.solve.forecasts import (
    QUANTITIES,
    forecast_bench,
    forecast_if_enough,
    further_poses,
    largest_part,
    last_solve,
    poses_deg,
)
from bench.solve.next_pose import Choice, Wish, choose_pose, would_leave
from bench.wording.goals import beside_goal, goals_text, meaning_of_goal
from bench.wording.numbers import number
from calib.errors import DegenerateViews, TooFewStars
from calib.studies.planning import Forecast, forecast
from calib.studies.predicted_views import ExpectedBench
from sequences.script import ChooseStep, RecordStep, Until

Poses = list[dict[str, float]]

_UNITS = ("_px", "_mm")


@dataclass(frozen=True)
class ExpectedCourse:
    """What an ``until`` is expected to do."""

    until: int  # Number of its first step
    # Expected number of accepted recordings of the step; None if it will not meet its goals.
    poses: int | None
    reached: Mapping[str, float]  # Expanded uncertainties expected at its end, px, by name of the goal
    text: str


@dataclass(frozen=True)
class PlanForecast:
    """The forecast of a plan."""

    forecast: Forecast | None  # With all poses; None if they do not determine the camera
    poses: int
    chosen: int  # How many of them the run is expected to choose
    courses: tuple[ExpectedCourse, ...]
    # What the operator should know: limits that will not be met, and why; what limits the forecast.
    remarks: tuple[str, ...]

    @property
    def poses_text(self) -> str:
        """The number of poses as people read it: ``9 poses``, or ``about 9 poses`` if the run chooses some."""
        return f"{'about ' if self.courses else ''}{self.poses} pose{'' if self.poses == 1 else 's'}"


def expected_uncertainty(planned: Plan) -> PlanForecast | None:
    """Predict the uncertainties that a plan's poses give, also those that an ``until`` is expected to choose.

    None if the station expects nothing, or no poses are planned.
    """
    if planned.station.value.expected is None or not planned.poses:
        return None
    bench = forecast_bench(planned)
    poses, courses = _poses_at_end(planned, bench)
    try:
        predicted = forecast(bench, poses) if poses else None
        remarks = (*_missed(planned, bench, poses, predicted), *predicted.remarks) if predicted else ()
    except (TooFewStars, DegenerateViews) as error:
        place = f"{error.where}: " if error.where else ""
        predicted, remarks = None, (f"No uncertainty can be predicted: {place}{error.what}",)
    return PlanForecast(predicted, len(poses), len(poses) - len(planned.poses), tuple(courses), remarks)


def _poses_at_end(planned: Plan, bench: ExpectedBench) -> tuple[Poses, list[ExpectedCourse]]:
    """Return all poses that a run is expected to record, and the course of each ``until``."""
    poses: Poses = []
    courses: dict[int, ExpectedCourse] = {}
    for step in planned.script:
        if isinstance(step, RecordStep) and not step.pose.chosen_in_run:
            poses += poses_deg([step.pose])
        elif isinstance(step, ChooseStep) and step.until.first not in courses:
            courses[step.until.first] = _course(planned, bench, step.until, poses)
    return poses, list(courses.values())


def _course(planned: Plan, bench: ExpectedBench, until: Until, poses: Poses) -> ExpectedCourse:
    """Add the poses that an ``until`` is expected to choose to those before it, and return its course."""
    first = until.poses.start
    record = next(s for s in planned.script if isinstance(s, RecordStep) and s.pose.index == first)
    wish = Wish(until.goals, {}, roll=False, needs_tag=True, min_stars=record.gates.min_stars)
    earlier = len(poses) - until.starts
    while True:
        recorded, expected = len(poses) - earlier, forecast_if_enough(bench, poses)
        reached = (
            {name: expected.limited[name.removesuffix("_px")] for name in until.goals} if expected else {}
        )
        if reached and all(reached[name] <= goal for name, goal in until.goals.items()):
            text = f"Expected: about {recorded} poses until {goals_text(until.goals)}."
            return ExpectedCourse(until.first, recorded, reached, text)
        if recorded >= until.at_most:
            why = f"{until.at_most} poses do not suffice until {goals_text(until.goals)}."
            break
        choice = choose_pose(
            planned.station,
            None,
            bench.passport,
            taken_deg=poses,
            refused_deg=[],
            wish=replace(wish, now=reached, more=until.at_most - recorded),
            readings=bench.readings,
        )
        if not isinstance(choice, Choice):
            why = choice
            break
        if missed := choice.hopeless(until.goals, reached):
            goal = until.goals[missed]
            why = f"{meaning_of_goal(missed)} cannot reach the goal of {goal:g} px."
            why += f" {would_leave(missed, goal, choice.at_end[missed], until.at_most)}"
            break
        poses.append(dict(choice.angles_deg))
    if expected is not None:
        worst = max(reached, key=lambda name: reached[name] / until.goals[name])
        left = beside_goal(reached[worst], until.goals[worst], 2)
        why += (
            f" The step ends after about {recorded} poses; {meaning_of_goal(worst)} is then about {left} px."
        )
        why += f" {largest_part(expected, QUANTITIES[worst])}."
    return ExpectedCourse(until.first, None, reached, f"Expected: {why}")


def _missed(planned: Plan, bench: ExpectedBench, poses: Poses, forecast: Forecast) -> Iterator[str]:
    """Yield a sentence for each limit that the forecast exceeds; for U, with what more poses would leave."""
    step = last_solve(planned)
    twice: Forecast | None = None
    for name, most in (step.limits if step else {}).items():
        plain = next((name.removesuffix(unit) for unit in _UNITS if name.endswith(unit)), name)
        expected = forecast.limited.get(plain)
        if expected is None or expected <= most:
            continue
        unit = name.removeprefix(plain).removeprefix("_")
        text = f"{meaning_of_goal(name)} of at most {most:g} {unit}".rstrip()
        cause = ""
        if name in QUANTITIES:
            twice = twice or _with_twice(planned, bench, poses)
            later = (
                ""
                if twice is None
                else f"; twice as many poses would leave {number(twice.limited[plain], 2)} px"
            )
            cause = f" {largest_part(forecast, QUANTITIES[name])}{later}."
        yield f"{text} will not be met: {beside_goal(expected, most, 2)} expected.{cause}"


def _with_twice(planned: Plan, bench: ExpectedBench, poses: Poses) -> Forecast | None:
    """Return the forecast with twice as many poses; None if the stage does not reach so many."""
    try:
        further = further_poses(planned, bench, poses, len(poses))
    except (TooFewStars, DegenerateViews):
        return None
    return forecast_if_enough(bench, [*poses, *(dict(pose.angles_deg) for pose in further)])
