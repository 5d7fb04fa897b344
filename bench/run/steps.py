"""Take the steps of a script through the state machine: single steps, attempts at a recording, safe points.

At a safe point a run stops, holds or skips poses, as the operator asked. Every attempt at a recording is kept.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Unpack

from bench.base.encoding import counted
from bench.base.errors import PoseFailed
from bench.base.pasteable import pasteable
from bench.plan.job import ParkStep, ScriptStep
from bench.record import events
from bench.record.events import Circumstances
from bench.record.history import History
from bench.record.journal import capture_name
from bench.record.ledger import bench_ledger
from bench.run.machine import RunMachine, Trigger
from bench.run.run_context import RunContext
from bench.run.steps_to_do import steps_of_pose, steps_to_repeat
from bench.solve.earlier_runs import last_results
from bench.wording.numbers import duration
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
        steps, left_out = self._run.job.steps, self._run.log.history.is_left_out
        coming = (following for following in steps[steps.index(step) :] if not left_out(following.number))
        if not any(isinstance(following, RecordStep) for following in coming):
            return
        light = self._run.job.light_before(step)
        if light is not None and not isinstance(step, LightStep):
            self.set_light(light)
        for needed in steps_to_repeat(steps, step):
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
        name = self._run.job.record_steps[pose_index].pose.name
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
        release = pasteable("tell", self._run.folder.path, "release")
        self._run.say(f"Held by {by}. To continue: `{release}`.")
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
            what += seen_before(self._run.log.history, pose.index)
            self._say_last_run(pose.name)
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

    def _say_last_run(self, pose_name: str) -> None:
        """Tell what the last such run saw at a pose. The journal does not: results rest on their run alone."""
        last = last_results(bench_ledger(), self._run.log.history)
        if last is None:
            return
        for pose in last["poses"]:
            if pose["name"] == pose_name and pose["stars"]:
                run, ended = last["run"]["id"], last["run"].get("finished_utc", "")[:16]
                stars = counted(pose["stars"], "star")
                self._run.say(f"Run {run}, which ended at {ended} UTC, saw {stars} at {pose_name}.")

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


def seen_before(history: History, pose_index: int) -> str:
    """Return a sentence about the last good recording of a run, if a pose shows no stars now; else nothing."""
    here, good = history.attempts_at(pose_index), history.last_good(pose_index)
    if (
        good is None
        or good.checked is None
        or not here
        or here[-1].checked is None
        or here[-1].checked["stars"]
    ):
        return ""
    angles = ", ".join(f"{axis} {angle:g}" for axis, angle in good.stored["commanded_deg"].items())
    width_px = good.measured.get("edge_width_px")
    edges = "" if width_px is None else f", with edges {width_px:.2f} px wide"
    pose, stars = f"pose {good.pose_index} (at {angles} degrees)", counted(good.checked["stars"], "star")
    now, then = (datetime.fromisoformat(attempt.stored_utc) for attempt in (here[-1], good))
    return f" {duration((now - then).total_seconds())} before, {pose} showed {stars}{edges}."


def _joined(reasons: Sequence[str]) -> str:
    """Return several reasons as one text without a full stop."""
    return "; ".join(reason.removesuffix(".") for reason in reasons)
