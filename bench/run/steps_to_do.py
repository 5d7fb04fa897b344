"""Which steps of a script a run still has to do, and which steps these depend on, by its history. No devices.

A recording (or settling) depends on the move before it; a report depends on the solution before it. If the one is still
to be done, the other is repeated.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from copy import copy

from bench.plan.job import Job, ScriptStep
from bench.record.device_end import NO_END
from bench.record.history import History, count_crash
from bench.run.status import RunPlan
from bench.wording.goals import goals_text
from sequences.script import (
    ChooseStep,
    MoveStep,
    RecordStep,
    ReportStep,
    SettleStep,
    SolveStep,
)

CRASHES_ALLOWED = 1
"""A pose at which the process crashed more often than this is not tried again: one crash may be chance."""


def remaining_steps(steps: Sequence[ScriptStep], done: Iterable[int]) -> list[ScriptStep]:
    """Return the steps to do, in order: those not done, and those done that the first of them depends on."""
    done = set(done)
    undone = [i for i, step in enumerate(steps) if step.number not in done]
    unrecorded = next((i for i in undone if isinstance(steps[i], RecordStep)), len(steps))
    # The stage turned on while that recording was checked, and turns again after it is repeated. All is solved again.
    follow = MoveStep | SettleStep | SolveStep | ReportStep
    undone = sorted({*undone, *(i for i, s in enumerate(steps) if i > unrecorded and isinstance(s, follow))})
    again: set[int] = set()
    for wanted in ((MoveStep, SettleStep, RecordStep), (SolveStep, ReportStep)):
        first = next((i for i in undone if isinstance(steps[i], wanted)), None)
        if first is not None:
            again |= set(_places_to_repeat(steps, first))
    return [steps[i] for i in sorted({*again, *undone})]


def steps_to_do(job: Job, history: History) -> list[ScriptStep]:
    """Return the steps that a run still has to do, in order, without those left out by an ``until`` that ended."""
    left_out = {step.number for step in job.steps if history.is_left_out(step.number)}
    gone = {s.number for s in job.steps if isinstance(s, RecordStep) and s.pose.index in history.gone}
    return remaining_steps(job.steps, (history.done_steps | left_out) - gone)


def pose_names(job: Job, history: History) -> dict[int, str]:
    """Return the names of the poses that have angles: those of the sequence and those chosen so far."""
    poses = [step.pose for step in job.steps if isinstance(step, RecordStep)]
    chosen = history.chosen
    return {pose.index: pose.name for pose in poses if not pose.chosen_in_run or pose.index in chosen}


def steps_to_repeat(steps: Sequence[ScriptStep], step: ScriptStep) -> list[ScriptStep]:
    """Return move and settling before ``step`` if the next recording needs them and no move comes before it."""
    here = next(i for i, candidate in enumerate(steps) if candidate.number == step.number)
    coming = (s for s in steps[here:] if isinstance(s, MoveStep | RecordStep))
    if not isinstance(next(coming, None), RecordStep):
        return []
    begin = max((i for i in range(here) if isinstance(steps[i], MoveStep)), default=here)
    return [s for s in steps[begin:here] if isinstance(s, MoveStep | SettleStep)]


def steps_of_pose(steps: Sequence[ScriptStep], pose_index: int) -> list[ScriptStep]:
    """Return the steps of a pose, from 1, to leave out: recording, choice, and the move if no other depends on it."""
    here = next(i for i, s in enumerate(steps) if isinstance(s, RecordStep) and s.pose.index == pose_index)
    moves = [i for i, s in enumerate(steps) if isinstance(s, MoveStep)]
    begin = max((i for i in moves if i < here), default=here)
    end = min((i for i in moves if i > here), default=len(steps))
    if sum(isinstance(s, RecordStep) for s in steps[begin:end]) > 1:
        return [steps[here]]
    own = [s for s in steps[begin : here + 1] if isinstance(s, MoveStep | SettleStep | RecordStep)]
    choices = (s for s in steps[:begin] if isinstance(s, ChooseStep) and s.pose is not None)
    return [*(s for s in choices if s.pose is not None and s.pose.index == pose_index), *own]


def poses_crashed_too_often(history: History) -> dict[int, str]:
    """Return the poses that must not be tried again because the process crashed there too often."""
    accepted = history.accepted()
    return {
        pose: f"the process crashed {crashes} times at this pose"
        for pose, crashes in history.crashes.items()
        if crashes > CRASHES_ALLOWED and pose not in accepted and pose not in history.skipped
    }


def intentions(job: Job, history: History, crash: str | None, gone: Collection[str] = ()) -> list[str]:
    """Return what resuming a run will do, before it is done.

    ``crash`` tells how its process crashed; recordings that are ``gone`` are made again.
    """
    if history.ended == "finished":
        return ["The run is finished; only its seal is missing. It will be sealed; no device is opened."]
    history = copy(history)
    history.crashes = dict(history.crashes)
    history.lose(gone)
    count_crash(history, crash)
    names = pose_names(job, history)
    how = f"{history.ended}: {history.why.rstrip('.')}" if history.ended else crash or NO_END
    poses = RunPlan.from_dict(job.plan.to_dict()).count_poses(history).text
    return [
        f"The run was stopped ({how}). {len(history.accepted())} of {poses} poses are recorded and are kept.",
        *_skip_texts(history, names),
        *_step_texts(job, history),
    ]


def _skip_texts(history: History, names: Mapping[int, str]) -> list[str]:
    """Return which poses will be skipped, and why."""
    crashed = [
        f"Skip pose {p} ({names[p]}), because {why}." for p, why in poses_crashed_too_often(history).items()
    ]
    asked = [f"Skip pose {p} ({names[p]}), because {who} asked for it." for p, who in history.to_skip.items()]
    return crashed + asked


def _step_texts(job: Job, history: History) -> list[str]:
    """Return which poses will be recorded or moved to again, and what follows."""
    skipped = {*history.skipped, *poses_crashed_too_often(history), *history.to_skip}
    steps = steps_to_do(job, history)
    known = pose_names(job, history)
    recorded = [s.pose for s in steps if isinstance(s, RecordStep) and s.pose.index in known]
    repeated = [s.pose for s in steps if isinstance(s, MoveStep) and s.number in history.done_steps]
    kinds = {type(step) for step in steps}
    last = [text for kind, text in ((SolveStep, "solve"), (ReportStep, "report")) if kind in kinds]
    return [
        *(f"Record pose {pose.index} ({pose.name})." for pose in recorded if pose.index not in skipped),
        *(f"Move to pose {pose.name} again." for pose in repeated if pose.index not in skipped),
        *_until_texts(steps, history),
        f"Then: {', '.join([*last, 'seal'])}.",
    ]


def _until_texts(steps: Sequence[ScriptStep], history: History) -> list[str]:
    """Return for each ``until`` that has not ended what it will do."""
    accepted = history.accepted()
    until_of_step = {step.until.first: step.until for step in steps if isinstance(step, ChooseStep)}
    return [
        f"Choose poses until {goals_text(until.goals)}: at most "
        f"{until.at_most - sum(pose in accepted for pose in until.poses)} further recordings."
        for until in until_of_step.values()
    ]


def _places_to_repeat(steps: Sequence[ScriptStep], first: int) -> list[int]:
    """Return the places of the steps before ``first`` that the step at ``first`` depends on."""
    solving = isinstance(steps[first], SolveStep | ReportStep)
    prepared = [_prepares(step, solving=solving) for step in steps[: first + 1]]
    if prepared[first]:
        return []
    begin = max((i for i in range(first) if prepared[i]), default=first)
    settles = () if solving else SettleStep
    return [i for i in range(begin, first) if prepared[i] or isinstance(steps[i], settles)]


def _prepares(step: ScriptStep, *, solving: bool) -> bool:
    """Return whether a report depends on a step, a solution; else whether recordings do: a move."""
    if solving:
        return isinstance(step, SolveStep)
    return isinstance(step, MoveStep)
