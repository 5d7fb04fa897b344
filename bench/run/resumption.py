"""Which steps of a script a run still has to do, and what a step stands on. Knows steps and history, no devices.

A recording (or settling) stands on the move before it, a report on the solution before it: where the one has still
to be done, the other is done again.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from bench.plan.job import Job, ScriptStep
from bench.records.history import History, count_crash
from sequences.script import MoveStep, RecordStep, ReportStep, SettleStep, SolveStep

CRASHES_ALLOWED = 1
"""A pose at which the process crashed by itself more often than that is not tried again."""


def remaining(steps: Sequence[ScriptStep], done: Iterable[int]) -> list[ScriptStep]:
    """Find the steps to do: those not done, and those done that the first of them stands on."""
    done = set(done)
    undone = [i for i, step in enumerate(steps) if step.number not in done]
    again: set[int] = set()
    for wanted in ((MoveStep, SettleStep, RecordStep), (SolveStep, ReportStep)):
        first = next((i for i in undone if isinstance(steps[i], wanted)), None)
        if first is not None:
            again |= set(_places_to_repeat(steps, first))
    return [steps[i] for i in sorted({*again, *undone})]


def steps_to_repeat(steps: Sequence[ScriptStep], step: ScriptStep) -> list[ScriptStep]:
    """Find what the next recording stands on among the steps before ``step``: the move and the settling after it.

    Nothing where a move comes before the next recording anyway, or where no recording follows.
    """
    here = next(i for i, candidate in enumerate(steps) if candidate is step)
    coming = (s for s in steps[here:] if isinstance(s, MoveStep | RecordStep))
    if not isinstance(next(coming, None), RecordStep):
        return []
    begin = max((i for i in range(here) if isinstance(steps[i], MoveStep)), default=here)
    return [s for s in steps[begin:here] if isinstance(s, MoveStep | SettleStep)]


def steps_of_pose(steps: Sequence[ScriptStep], pose_index: int) -> list[ScriptStep]:
    """Find the steps that are there for one recording only: it, and its move where no other stands on that."""
    here = next(i for i, s in enumerate(steps) if isinstance(s, RecordStep) and s.pose.index == pose_index)
    moves = [i for i, s in enumerate(steps) if isinstance(s, MoveStep)]
    begin = max((i for i in moves if i < here), default=here)
    end = min((i for i in moves if i > here), default=len(steps))
    if sum(isinstance(s, RecordStep) for s in steps[begin:end]) > 1:
        return [steps[here]]
    return [s for s in steps[begin : here + 1] if isinstance(s, MoveStep | SettleStep | RecordStep)]


def crash_looped(history: History) -> dict[int, str]:
    """Find the poses that must not be tried again, and say why: the process crashed there too often."""
    accepted = history.accepted()
    return {
        pose: f"the process crashed {crashes} times while it was at work there"
        for pose, crashes in history.crashes.items()
        if crashes > CRASHES_ALLOWED and pose not in accepted and pose not in history.skipped
    }


def intentions(job: Job, history: History, crash: str | None) -> list[str]:
    """Say what resuming a run will do, a line each, before it is done.

    Parameters
    ----------
    job, history
        The run.
    crash
        How the process that worked on it crashed (`bench.run.crash_log`); None when it did not.
    """
    history = replace(history, crashes=dict(history.crashes))
    count_crash(history, crash)
    names = {pose.index: pose.name for pose in job.plan.poses}
    accepted = history.accepted()
    if history.ended == "finished":
        return ["The run is finished; only its seal is missing. It will be sealed; no device is opened."]
    how = f"{history.ended}: {history.why}" if history.ended else crash or "killed or cut off"
    lines = [f"The run was stopped ({how}); {len(accepted)} of {len(names)} poses are recorded and stay."]
    looped = crash_looped(history)
    lines += [f"Skipped: pose {p} ({names[p]}), for {why}." for p, why in looped.items()]
    lines += [f"Skipped: pose {p} ({names[p]}), as {who} asked." for p, who in history.to_skip.items()]
    gone = {*history.skipped, *looped, *history.to_skip}
    steps = remaining(job.steps, history.done_steps)
    record = [s.pose for s in steps if isinstance(s, RecordStep) and s.pose.index not in gone]
    lines += [f"To record: pose {pose.index} ({pose.name})." for pose in record]
    again = [s.pose for s in steps if isinstance(s, MoveStep) and s.number in history.done_steps]
    lines += [f"Moved to again: {pose.name}." for pose in again if pose.index not in gone]
    rest = [what for kind, what in ((SolveStep, "solve"), (ReportStep, "report")) if _has(steps, kind)]
    return [*lines, f"Then: {', '.join([*rest, 'seal'])}."]


def _has(steps: Sequence[ScriptStep], kind: type) -> bool:
    return any(isinstance(step, kind) for step in steps)


def _places_to_repeat(steps: Sequence[ScriptStep], first: int) -> list[int]:
    """Places of what the step at ``first`` stands on, and of what lies between and belongs to it."""
    solving = isinstance(steps[first], SolveStep | ReportStep)
    base: type = SolveStep if solving else MoveStep
    if isinstance(steps[first], base):
        return []
    kept = (SolveStep,) if solving else (MoveStep, SettleStep)
    begin = max((i for i in range(first) if isinstance(steps[i], base)), default=first)
    return [i for i in range(begin, first) if isinstance(steps[i], kept)]
