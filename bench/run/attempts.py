"""Record at a pose until a recording is accepted; after the last allowed attempt: skip the pose, ask, or fail.

Every attempt is kept as evidence. The sequence step decides what follows; the work of each state is in
`bench.run.state_work`.
"""

from __future__ import annotations

from collections.abc import Callable

from bench.base.errors import PoseFailed
from bench.records.events import Event
from bench.records.run_folder import RunFolder
from bench.records.run_log import RunLog
from bench.run.machine import RunMachine
from bench.run.safe_points import SafePoints
from bench.run.steps import Steps
from bench.terminal.wording import counted
from drivers.errors import RecordingFailed
from sequences.script import PromptStep, RecordStep


class Attempts:
    """The attempts of one run.

    machine, steps, safe_points: State machine of the run, what takes steps through it, and the safe points
      between attempts.
    """

    def __init__(
        self,
        machine: RunMachine,
        steps: Steps,
        safe_points: SafePoints,
        folder: RunFolder,
        log: RunLog,
        ending: str,
        say: Callable[[str], None],
    ) -> None:
        self._machine = machine
        self._steps = steps
        self._safe_points = safe_points
        self._folder = folder
        self._log = log
        self._ending = ending
        self._say = say

    def record(self, step: RecordStep) -> None:
        """Record until a recording is accepted; after the last allowed attempt, do what the sequence specifies.

        Raises PoseFailed: If all attempts failed and the step says ``fail``.
        Raises Aborted: If an operator, or the default answer, decides not to try again.
        """
        while (reasons := self._try_attempts(step)) is not None:
            pose = step.pose
            what = f"Pose {pose.index} ({pose.name}) failed {counted(step.attempts, 'attempt')}: {'; '.join(reasons)}."
            if step.on_failure == "fail":
                raise PoseFailed(
                    what,
                    where=step.where,
                    remedy="Remove the cause, then continue with `starbench resume`; all attempts are kept.",
                )
            if step.on_failure == "skip":
                self._log.write(Event.DEVIATION, what=f"{what} It was skipped, as the sequence specifies.")
                self._say(f"{what} Skipped.")
                return
            question = f"{what} Try it again?"
            self._machine.fire(
                "hold", PromptStep(step.number, step.where, step.path, question, "abort", step.hold_s)
            )

    def keep_lost_recording(self, step: RecordStep, why: str) -> None:
        """Move what exists of an incomplete recording to quarantine, and journal it."""
        pose, attempt = step.pose, self._log.history.next_attempt(step.pose.index)
        kept = self._folder.quarantine_part(pose.index, attempt, self._ending)
        self._log.write(
            Event.ATTEMPT_LOST, pose=pose.index, pose_name=pose.name, attempt=attempt, why=why, kept=kept
        )

    def _try_attempts(self, step: RecordStep) -> list[str] | None:
        """Make up to the allowed number of attempts; return why the last one was rejected.

        None means that a recording was accepted, or that the pose is skipped.
        """
        history, pose = self._log.history, step.pose
        reasons: list[str] = []
        if pose.index in history.accepted():  # the process died between accepting it and journaling that
            return None
        for i in range(step.attempts):
            if i:
                self._steps.fire_at("back_off", step, wait_s=step.backoff_s * 2 ** (i - 1))
                self._safe_points.reach(step)
                if pose.index in history.skipped:
                    return None
            attempt = history.next_attempt(pose.index)
            try:
                self._steps.fire_at("record", step, attempt=attempt)
                self._steps.fire_at("check", step, attempt=attempt)
            except RecordingFailed as error:
                reasons = [str(error)]
                self.keep_lost_recording(step, str(error))
                continue
            if pose.index in history.accepted():
                return None
            reasons = list(history.attempts_at(pose.index)[-1].reasons)
            self._say(f"Pose {pose.index} ({pose.name}), attempt {attempt}: {'; '.join(reasons)}")
        self._steps.fire_at("back_off", step, wait_s=0.0)
        self._safe_points.reach(step)
        return None if pose.index in history.skipped else reasons
