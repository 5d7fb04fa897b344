"""Take the steps of a script through the state machine: single steps, attempts at a recording, safe points.

At a safe point a run stops, holds or skips poses, as the operator asked. Every attempt at a recording is kept.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Unpack

from bench.base.encoding import counted
from bench.base.errors import PoseFailed
from bench.plan.job import Job, ParkStep, ScriptStep
from bench.record import events
from bench.record.device_end import NO_END
from bench.record.events import Circumstances
from bench.record.history import History, count_crash
from bench.record.journal import capture_name
from bench.run.machine import RunMachine, Trigger
from bench.run.run_context import RunContext
from bench.run.status import RunPlan
from bench.wording.goals import goals_text
from drivers.errors import RecordingFailed
from sequences.script import (
    ChooseStep,
    LightStep,
    MoveStep,
    PromptStep,
    RecordStep,
    ReportStep,
    SettleStep,
    SolveStep,
    WaitStep,
)

# Which steps of a script a run still has to do, and which steps these depend on. Uses steps and history, no
# devices.
#
# A recording (or settling) depends on the move before it; a report depends on the solution before it. If
# the one is still to be done, the other is repeated.

CRASHES_ALLOWED = 1
"""A pose at which the process crashed more often than this is not tried again."""


def remaining_steps(steps: Sequence[ScriptStep], done: Iterable[int]) -> list[ScriptStep]:
    """Return the steps to do, in order: those not done, and those done that the first of them depends on."""
    done = set(done)
    undone = [i for i, step in enumerate(steps) if step.number not in done]
    unrecorded = next((i for i in undone if isinstance(steps[i], RecordStep)), len(steps))
    # The stage turned on while that recording was checked, and turns again after it is repeated.
    turned = [i for i, s in enumerate(steps) if i > unrecorded and isinstance(s, MoveStep | SettleStep)]
    undone = sorted({*undone, *turned})
    again: set[int] = set()
    for wanted in ((MoveStep, SettleStep, RecordStep), (SolveStep, ReportStep)):
        first = next((i for i in undone if isinstance(steps[i], wanted)), None)
        if first is not None:
            again |= set(_places_to_repeat(steps, first))
    return [steps[i] for i in sorted({*again, *undone})]


def steps_to_do(job: Job, history: History) -> list[ScriptStep]:
    """Return the steps that a run still has to do, in order, without those left out by an ``until`` that ended."""
    left_out = {step.number for step in job.steps if history.is_left_out(step.number)}
    return remaining_steps(job.steps, history.done_steps | left_out)


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


def intentions(job: Job, history: History, crash: str | None) -> list[str]:
    """Return what resuming a run will do, before it is done; ``crash`` tells how its process crashed."""
    if history.ended == "finished":
        return ["The run is finished; only its seal is missing. It will be sealed; no device is opened."]
    history = replace(history, crashes=dict(history.crashes))
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
    found = {step.until.first: step.until for step in steps if isinstance(step, ChooseStep)}
    return [
        f"Choose poses until {goals_text(until.goals)}: at most "
        f"{until.at_most - sum(pose in accepted for pose in until.poses)} further recordings."
        for until in found.values()
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


_TRIGGERS: Mapping[type, Trigger] = {
    LightStep: "set_light",
    MoveStep: "slew",
    SettleStep: "settle",
    WaitStep: "wait",
    PromptStep: "hold",
    ChooseStep: "choose",
    ParkStep: "park",
    SolveStep: "solve",
    ReportStep: "report",
}
"""The edge that a step takes; a RecordStep takes several."""


class Steps:
    """Steps of one run's script."""

    def __init__(self, run: RunContext, machine: RunMachine) -> None:
        self._run = run
        self._machine = machine
        self._steps_skipped: dict[int, set[int]] = {}
        self._last_move: int | None = None  # Number of the move that the stage took last
        self._in_check: RecordStep | None = None

    @property
    def in_check(self) -> RecordStep | None:
        """The step whose recording is stored and being checked; `conclude` ends that."""
        return self._in_check

    def take(self, step: ScriptStep) -> None:
        """Take the one edge of a step that records nothing."""
        if isinstance(step, MoveStep):
            step = self._run.job.at_its_pose(step, self._run.log.history.chosen)
            self._last_move = step.number
            self.fire_at("slew", step, target_deg=dict(step.pose.angles_deg))
        else:
            self._machine.fire(_TRIGGERS[type(step)], step)

    def fire_at(
        self, trigger: Trigger, step: MoveStep | RecordStep, **circumstances: Unpack[Circumstances]
    ) -> None:
        """Take an edge for a step at its pose."""
        at_pose: Circumstances = {"pose": step.pose.index, "pose_name": step.pose.name, **circumstances}
        self._machine.fire(trigger, self._run.job.at_its_pose(step, self._run.log.history.chosen), **at_pose)

    def set_light(self, light: LightStep) -> None:
        """Set the light as a light step specifies, whether or not the script has reached that step."""
        self._machine.fire("set_light", light)

    def prepare_again(self, step: ScriptStep) -> None:
        """Set up the bench again after a hold: the light, and the move and settling that the next recording needs."""
        here = self._run.job.index_of(step)
        left_out = self._run.log.history.is_left_out
        coming = (later for later in self._run.job.steps[here:] if not left_out(later.number))
        if not any(isinstance(later, RecordStep) for later in coming):
            return
        light = self._run.job.light_before(step)
        if light is not None and not isinstance(step, LightStep):
            self.set_light(light)
        for needed in steps_to_repeat(self._run.job.steps, step):
            self.take(needed)

    def return_to(self, step: ScriptStep) -> None:
        """Move the stage where the next recording needs it, if it went back to an earlier pose in between."""
        needed = steps_to_repeat(self._run.job.steps, step)
        if needed and needed[0].number != self._last_move:
            for move_or_settle in needed:
                self.take(move_or_settle)

    # ------------------------------------------------------------------ safe points

    def reach(self, step: ScriptStep) -> None:
        """Stop, hold or skip poses, as asked, before a step; a hold raises Interrupted."""
        self._run.clock.check()
        self._run.interlocks.require_clear()
        history = self._run.log.history
        holder = history.holder
        if holder and self._machine.can("hold"):
            self._hold(step, holder)
        settled = {*history.accepted(), *history.skipped}
        if self._in_check is not None:
            settled.add(self._in_check.pose.index)
        for pose_index, by in list(history.to_skip.items()):
            if pose_index not in settled:
                self.skip(pose_index, f"{by} asked for it")
        if holder and not self.is_skipped(step):
            self.prepare_again(step)

    def skip(self, pose_index: int, why: str) -> None:
        """Skip a pose, numbered from 1: its steps will not be done."""
        name = self._run.job.record_step(pose_index).pose.name
        what = f"Pose {pose_index} ({name}) was skipped: {why}."
        self._run.log.write(events.PoseSkipped, pose=pose_index, pose_name=name, what=what)
        self._run.say(what)

    def is_skipped(self, step: ScriptStep) -> bool:
        """Return whether a step belongs to a skipped pose alone, or is not needed because its ``until`` ended."""
        for pose in self._run.log.history.skipped.keys() - self._steps_skipped.keys():
            self._steps_skipped[pose] = {s.number for s in steps_of_pose(self._run.job.steps, pose)}
        if self._run.log.history.is_left_out(step.number):
            return True
        return any(step.number in numbers for numbers in self._steps_skipped.values())

    def _hold(self, step: ScriptStep, by: str) -> None:
        begin_s = self._run.clock.monotonic()
        self._run.say(f"Held by {by}. To continue: `starbench tell FOLDER release`.")
        self._machine.fire("hold", step, by=by)
        held_s = self._run.clock.monotonic() - begin_s
        before = "parking" if isinstance(step, ParkStep) else f"step {step.number}"
        self._run.log.write(
            events.Deviation, what=f"Held by {by} for {held_s:.0f} s before {before}.", hold=True
        )

    # ------------------------------------------------------------------ attempts at a recording

    def record(self, step: RecordStep) -> None:
        """Record at a pose. The recording is then `in_check`; one that the camera loses is repeated at once."""
        if step.pose.index in self._run.log.history.accepted():
            return  # the process died between accepting it and journaling that
        lost = self._record_once(step)
        if lost:
            self.conclude(step, lost)
        else:
            self._in_check = step

    def conclude(self, step: RecordStep, reasons: Sequence[str] = ()) -> None:
        """Check a recording; record again until one is accepted. After the last attempt do as the step says, or ask.

        ``reasons`` tell why the first attempt was lost.
        """
        while reasons := self._try_attempts(step, reasons):
            pose = step.pose
            what = f"Pose {pose.index} ({pose.name}) failed {counted(step.attempts, 'attempt')}: {_joined(reasons)}."
            if step.on_failure == "fail":
                raise PoseFailed(
                    what,
                    where=self._last_capture(pose.index),
                    remedy="Remove the cause. All attempts are kept.",
                )
            if step.on_failure == "skip":
                self._run.log.write(
                    events.Deviation, what=f"{what} It was skipped, as the sequence specifies."
                )
                self._run.say(f"{what} Skipped.")
                return
            question = f"{what} Try it again?"
            self._machine.fire(
                "hold", PromptStep(step.number, step.where, step.path, question, "abort", step.hold_s)
            )
            reasons = ()

    def _last_capture(self, pose_index: int) -> str:
        """Return the file of the last recording at a pose; empty if none was stored."""
        stored = self._run.log.history.attempts_at(pose_index)
        return stored[-1].stored["capture"] if stored else ""

    def keep_lost_recording(self, step: RecordStep, why: str) -> None:
        """Move what exists of an incomplete recording to quarantine, and journal it."""
        pose, attempt = step.pose, self._run.log.history.next_attempt(step.pose.index)
        name = capture_name(pose.index, attempt, self._run.job.camera_kind.ending)
        kept = self._run.folder.quarantine_part(name)
        self._run.log.write(
            events.AttemptLost, pose=pose.index, pose_name=pose.name, attempt=attempt, why=why, kept=kept
        )

    def _try_attempts(self, step: RecordStep, reasons: Sequence[str]) -> Sequence[str]:
        """Make up to the allowed attempts; return why the last was rejected, nothing if accepted or skipped.

        The first attempt may have been lost, which ``reasons`` say, or be stored and not yet checked.
        """
        history, pose = self._run.log.history, step.pose
        for i in range(1 if reasons else 0, step.attempts):
            if i:
                self.fire_at("back_off", step, wait_s=step.backoff_s * 2 ** (i - 1))
                self.reach(step)
                if pose.index in history.skipped:
                    return ()
            if history.unchecked(pose.index) is None:
                self.return_to(step)
                reasons = self._record_once(step)
                if reasons:
                    continue
            reasons = self._check(step)
            if not reasons:
                return ()
        self.fire_at("back_off", step, wait_s=0.0)
        self.reach(step)
        return () if pose.index in history.skipped else reasons

    def _record_once(self, step: RecordStep) -> Sequence[str]:
        """Make one attempt; return why it was lost, nothing if it is stored."""
        try:
            self.fire_at("record", step, attempt=self._run.log.history.next_attempt(step.pose.index))
        except RecordingFailed as error:
            self.keep_lost_recording(step, str(error))
            return [str(error)]
        return ()

    def _check(self, step: RecordStep) -> Sequence[str]:
        """End the check of the recording stored last at a pose; return why it is rejected."""
        history, pose = self._run.log.history, step.pose
        attempt = history.attempts_at(pose.index)[-1].attempt
        self._in_check = None
        self.fire_at("check", step, attempt=attempt)
        if pose.index in history.accepted():
            return ()
        reasons = history.attempts_at(pose.index)[-1].reasons
        self._run.say(f"Pose {pose.index} ({pose.name}), attempt {attempt}: {_joined(reasons)}")
        return reasons


def _joined(reasons: Sequence[str]) -> str:
    """Return several reasons as one text without a full stop."""
    return "; ".join(reason.removesuffix(".") for reason in reasons)
