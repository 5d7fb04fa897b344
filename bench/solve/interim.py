"""Decisions of an ``until``: the uncertainty after the poses so far, and the next pose, or why the step ends.

A decision depends on history and calibration alone: no clock, no chance. The journal keeps it for a resumed run.
"""

from __future__ import annotations

from collections.abc import Callable, MutableMapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bench.measure.expected_grid import engine_angles_deg
from bench.measure.measure import Measurement, aligned_poses
from bench.plan.job import Job
from bench.record.events import ChosenPose, UntilDecided, UntilEnd
from bench.record.history import History
from bench.solve.forecasts import QUANTITIES
from bench.solve.next_pose import Choice, Wish, choose_pose, would_leave
from bench.solve.solution import accepted_measurements, views_in
from bench.solve.solve_options import limited_numbers, solve_options
from bench.wording.goals import meaning_of_goal, missed_text
from bench.wording.numbers import number
from calib.engine import Calibration, calibrate
from calib.errors import CalibrationError
from calib.model.passport import Passport
from sequences.flatten import POSES_FAILED
from sequences.script import ChooseStep, Until

_FEWEST_LABELLED = 3
"""Poses that must show the tag before a pose without it is chosen; docs/sequences.md gives the reason."""
Decide = Callable[[ChooseStep, History, MutableMapping[int, Measurement], Callable[[], None]], UntilDecided]
"""Decides for the ``until`` steps of one run: `decide_until` with the job and the folder of the run."""


@dataclass(frozen=True)
class Interim:
    """A calibration from the poses so far."""

    # Measurements of the accepted recordings, in the order of their poses.
    measurements: Sequence[Measurement]
    calibration: Calibration | None  # The calibration; None if the poses do not determine the camera
    why: str = ""  # Why there is no calibration; empty if there is one
    passport: Passport | None = None  # Passport that the calibration uses, if any


def decide_until(
    job: Job,
    folder: Path,
    step: ChooseStep,
    history: History,
    measured: MutableMapping[int, Measurement],
    check: Callable[[], None],
) -> UntilDecided:
    """Calibrate from the accepted recordings, and decide what follows; ``check`` raises to stop the run."""
    measurements, readings = accepted_measurements(job, folder, history, measured, check)
    options = solve_options(job, step.solve, readings)
    try:
        calibration, why = calibrate(views_in(measurements), options), ""
    except CalibrationError as error:
        calibration, why = None, str(error)
    check()
    return decide(step, job, history, Interim(measurements, calibration, why, options.passport))


def decide(step: ChooseStep, job: Job, history: History, interim: Interim) -> UntilDecided:
    """Decide what follows in an ``until``: the next pose, or the end."""
    until, accepted, calibration = step.until, history.accepted(), interim.calibration
    recorded = sum(pose in accepted for pose in until.poses)
    decided: UntilDecided = {
        "step": step.number,
        "until": until.first,
        "until_last": until.last,
        "recorded": recorded,
        "poses": len(accepted),
        "worked_s": round(sum(history.worked_s.get(n, 0.0) for n in range(until.first, until.last + 1)), 3),
        "wanted": dict(until.goals),
        "now": _reached(until, calibration) if calibration else {},
        "at_end": {},
        "coverage_factor": calibration.coverage_factor if calibration else None,
        "model": calibration.model if calibration else "",
        "lacks": "",
    }
    if calibration is None:
        decided["problem"] = interim.why
    failed = [pose for pose in history.chosen if pose in until.poses and pose not in accepted]
    end = _end(until, decided, interim, len(failed))
    if end is not None:
        return {**decided, "ended": end[0], "why": end[1]}
    choice = _choose(step, job, history, interim, decided, failed)
    if isinstance(choice, Choice):
        if decided["now"]:
            decided["at_end"] = {goal: value for goal, value in choice.at_end.items() if np.isfinite(value)}
            missed = choice.hopeless(until.goals, decided["now"])
            if missed:
                why = would_leave(missed, until.goals[missed], choice.at_end[missed], until.at_most)
                return {
                    **decided,
                    "ended": "unreachable",
                    "why": f"{_missed(decided, interim)} {why} {_largest_source(calibration, missed)}",
                }
        return {**decided, "lacks": choice.lacks, "chosen": _chosen(step, choice)}
    return {**decided, "ended": "no_pose", "why": f"{_missed(decided, interim)} {choice}".strip()}


def _reached(until: Until, calibration: Calibration) -> dict[str, float]:
    """Return the expanded uncertainties that are reached, px, by the name of the goal."""
    numbers = limited_numbers(calibration)
    return {goal: numbers[goal.removesuffix("_px")] for goal in until.goals}


def _end(until: Until, decided: UntilDecided, interim: Interim, failed: int) -> tuple[UntilEnd, str] | None:
    """Return how and why the ``until`` ends now; None if a further pose is wanted and allowed."""
    now, wanted = decided["now"], decided["wanted"]
    if now and all(now[goal] <= most for goal, most in wanted.items()):
        return "met", "The goals are met."
    bound: tuple[UntilEnd, str] | None = None
    if decided["recorded"] >= until.at_most:
        bound = "at_most", f"{decided['recorded']} recordings are accepted; the step takes no more."
    elif failed >= POSES_FAILED:
        bound = "failures", f"{failed} chosen poses were not recorded."
    elif until.minutes is not None and decided["worked_s"] >= 60.0 * until.minutes:
        bound = "minutes", f"The step has worked for {until.minutes:g} minutes; it takes no longer."
    if bound is None:
        return None
    largest = max(now, key=lambda goal: now[goal] / wanted[goal], default="")
    source = _largest_source(interim.calibration, largest)
    return bound[0], f"{_missed(decided, interim)} {bound[1]} {source}".strip()


def _missed(decided: UntilDecided, interim: Interim) -> str:
    """Return the goals that are not met, as text, and why there is no calibration."""
    return f"{missed_text(decided['now'], decided['wanted'])} {interim.why}".strip()


def _largest_source(calibration: Calibration | None, goal: str) -> str:
    """Return the source that contributes most to what a goal limits, as text."""
    if calibration is None or not goal or not calibration.budget_rows:
        return ""
    largest = max(calibration.budget_rows, key=lambda row: row.contribution.get(QUANTITIES[goal], 0.0))
    part = calibration.coverage_factor * largest.contribution.get(QUANTITIES[goal], 0.0)
    return f"The largest part of {meaning_of_goal(goal)} comes from: {largest.name}, {number(part, 2)} px."


def _choose(
    step: ChooseStep,
    job: Job,
    history: History,
    interim: Interim,
    decided: UntilDecided,
    failed: Sequence[int],
) -> Choice | str:
    """Return the pose to record next, or why there is none.

    One without the tag comes last: the gimbal must then identify the stars, and none may have failed.
    """
    taken = [engine_angles_deg(a.stored["measured_deg"]) for _, a in sorted(history.accepted().items())]
    chosen = history.chosen
    labelled = sum(m.facts.get("named_by", "tag") in {"tag", "part of the tag"} for m in interim.measurements)
    record = job.record_steps[step.pose.index] if step.pose is not None else None
    wish = Wish(
        decided["wanted"],
        decided["now"],
        roll=2 * aligned_poses(m.facts for m in interim.measurements) > len(taken),
        needs_tag=True,
        min_stars=record.gates.min_stars if record else 0,
        more=max(1, step.until.at_most - decided["recorded"]),
    )
    readings = solve_options(job, step.solve, []).gimbal
    choice: Choice | str = ""
    for needs_tag in (True,) if labelled < _FEWEST_LABELLED or failed else (True, False):
        choice = choose_pose(
            job.plan.station,
            interim.calibration,
            interim.passport,
            taken_deg=taken,
            refused_deg=[engine_angles_deg(chosen[pose]) for pose in failed],
            wish=replace(wish, needs_tag=needs_tag),
            readings=readings,
        )
        if isinstance(choice, Choice):
            break
    return choice


def _chosen(step: ChooseStep, choice: Choice) -> ChosenPose:
    assert step.pose is not None
    return {
        "pose": step.pose.index,
        "pose_name": step.pose.name,
        "angles_deg": {axis.removesuffix("_deg"): angle for axis, angle in choice.angles_deg.items()},
        "expected": {name: value for name, value in choice.expected.items() if np.isfinite(value)},
        "why": choice.why,
    }
