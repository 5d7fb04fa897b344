"""A plan as text for the terminal, narrow enough for 80 columns if names are short."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping

from bench.base.encoding import counted, size_text
from bench.plan.passports import PassportInUse
from bench.plan.plan import Plan, PlannedStep
from bench.wording.goals import meaning_of_goal
from bench.wording.numbers import duration
from calib.calibration import REFERENCE_MODELS
from sequences.script import Flicker, LightStep, MoveStep, PromptStep, RecordStep, SolveStep, Step

MOST_LINES = 120
"""In a longer plan the steps in the middle are left out: some screens."""
DRAWN_ROWS, MOST_DRAWN = 17, 40
"""Size of the drawing of the beam, in lines of a terminal; of more poses, the numbers hide each other."""


def render_plan(plan: Plan) -> str:
    """Write a plan as text: faults and remarks first, then the steps."""
    simulated = " (SIMULATED)" if plan.station.value.is_simulated else ""
    lines = [f"{plan.sequence.value.name} on {plan.station.value.name}{simulated}", ""]
    if plan.faults:
        lines += [
            f"This plan cannot be run: {counted(len(plan.faults), 'fault')}.",
            *map(str, plan.faults),
            "",
        ]
    if plan.remarks:
        lines += ["Remarks:", *map(str, plan.remarks), ""]
    lines += [_steps(plan), "", *_poses_in_the_beam(plan)]
    if plan.passport.in_use is not None:
        lines += [*_passport_lines(plan.passport.in_use), ""]
    lines.append(_totals(plan))
    return "\n".join(lines)


def _poses_in_the_beam(plan: Plan) -> list[str]:
    """Return the beam with the number of each pose where the camera looks, from the collimator; none without a beam.

    Tilt is drawn upwards, pan to the right; of poses at one place, the first is shown.
    """
    expected, poses = plan.station.value.expected, plan.poses
    if expected is None or not 0 < len(poses) <= MOST_DRAWN:
        return []
    edge_deg = expected.half_angle_deg
    reach_deg = max(edge_deg, *(abs(pose.angles_deg.get(a, 0.0)) for pose in poses for a in ("pan", "tilt")))
    rows = [[" "] * (2 * DRAWN_ROWS) for _ in range(DRAWN_ROWS)]

    def put(pan_deg: float, tilt_deg: float, text: str) -> None:
        row = round((1 - tilt_deg / reach_deg) * (DRAWN_ROWS - 1) / 2)
        column = round((1 + pan_deg / reach_deg) * (DRAWN_ROWS - 1))
        if rows[row][column] in " .":
            rows[row][column : column + len(text)] = text

    for turn in range(0, 360, 5):
        put(edge_deg * math.cos(math.radians(turn)), edge_deg * math.sin(math.radians(turn)), ".")
    for pose in poses:
        put(pose.angles_deg.get("pan", 0.0), pose.angles_deg.get("tilt", 0.0), str(pose.index))
    title = f"Where the poses look; dots: the rim of the beam, {edge_deg:g} degrees from its axis."
    return [title, *("  " + "".join(row).rstrip() for row in rows), ""]


def _steps(plan: Plan) -> str:
    rows = [row for planned in plan.steps for row in _rows(planned, plan)]
    if len(rows) > MOST_LINES:
        kept = MOST_LINES // 2
        rows = [*rows[:kept], f"      ... {len(rows) - 2 * kept} steps ...", *rows[-kept:]]
    return "\n".join([f"{'step':>5}  {'':<52}{'takes':>10}{'elapsed':>12}", *rows])


def _rows(planned: PlannedStep, plan: Plan) -> list[str]:
    """Return the lines of a step. The rounds of an ``until`` share two lines, at its first choice."""
    step = planned.step
    until = next((until for until in plan.untils if until.first <= step.number <= until.last), None)
    if until is None or step.number < until.first + 3 * until.starts:
        return [_row(step.number, _what(step, plan), planned.duration_s, planned.done_after_s)]
    if step.number > until.first + 3 * until.starts:
        return []
    rounds = [p for p in plan.steps if step.number <= p.step.number <= until.last]
    minutes = "" if until.minutes is None else f", at most {until.minutes:g} min"
    further = counted(until.at_most - until.starts, "pose")
    goals = ", ".join(f"{meaning_of_goal(goal)} <= {most:g} px" for goal, most in until.goals.items())
    what = f"choose and record up to {further}{minutes}"
    longest_s = sum(p.duration_s for p in rounds)
    return [_row(step.number, what, longest_s, rounds[-1].done_after_s), f"{'':>5}  until {goals}"]


def _row(number: int, what: str, takes_s: float, after_s: float) -> str:
    return f"{number:>5}  {what:<52}{duration(takes_s):>10}{duration(after_s):>12}"


def _what(step: Step, plan: Plan) -> str:
    match step:
        case LightStep(flicker=None):
            what = "light off"
        case LightStep(flicker=Flicker() as flicker):
            duty = f", {flicker.duty_percent:g} % duty" if flicker.waveform == "square" else ""
            what = f"light {flicker.waveform} {flicker.frequency_hz:g} Hz{duty}"
        case MoveStep(pose=pose):
            what = f"move to {_angles(pose.angles_deg)} ({pose.name})"
        case RecordStep():
            attempts = counted(step.attempts, "attempt")
            what = f"record pose {step.pose.index}, {step.window_ms:g} ms, up to {attempts}"
        case PromptStep():
            what = f"ask: {step.text} [{step.default}]"
        case SolveStep():
            lens = step.distortion if isinstance(step.distortion, str) else " ".join(step.distortion)
            what = f"solve {plan.model_for(step)}, {lens or 'no distortion'}"
            if step.model in REFERENCE_MODELS:
                what += f", {step.loss or 'huber'}"
            if plan.passport.in_use is not None and plan.passport_for(step) is not None:
                what += f", passport {plan.passport.in_use.name}"
        case _:
            what = step.word
    return what


def _angles(angles_deg: Mapping[str, float]) -> str:
    return ", ".join(f"{axis} {angle:g}" for axis, angle in angles_deg.items()) + " deg"


def _totals(plan: Plan) -> str:
    poses = counted(len(plan.poses), "pose")
    size, most = size_text(plan.size_bytes), size_text(plan.most_bytes)
    about = "about"
    if plan.untils:
        poses, about = f"{len(plan.poses)} to {counted(plan.most_poses, 'pose')}", "at most about"
    return f"{poses}, {about} {duration(plan.duration_s)}, {about} {size} on disk ({most} at most)."


def _passport_lines(in_use: PassportInUse) -> list[str]:
    """Return lines with name, hash and seal of a passport."""
    lines = [f"Passport {in_use.name}", f"  SHA-256 {hashlib.sha256(in_use.data).hexdigest()}"]
    if in_use.seal is not None:
        lines.append(f"  sealed by {in_use.seal.fingerprint}")
    return [*lines, "  not sealed"] if in_use.is_unsealed else lines
