"""Records at a pose until a recording counts, as often as the step allows; then skips, asks or fails, as it says.

Every attempt stays as evidence. This module holds the policy of a step; the work of each state stands in
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
from drivers.errors import RecordingFailed
from sequences.script import PromptStep, RecordStep


class Attempts:
    """The attempts of one run.

    Parameters
    ----------
    machine, steps, safe_points
        The run's state machine, what takes steps through it, and what is done between two attempts.
    folder, log
        The run.
    ending
        How the names of recordings end.
    say
        Shows a line to the operator.
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
        """Record until accepted; once the attempts are used up, do as the sequence says.

        Raises
        ------
        PoseFailed
            When it says so.
        Aborted
            When an operator who was asked, or the default, does not want to try again.
        """
        while (reasons := self._try_attempts(step)) is not None:
            pose = step.pose
            what = f"Pose {pose.index} ({pose.name}) failed {step.attempts} attempts: {'; '.join(reasons)}."
            if step.on_failure == "fail":
                raise PoseFailed(
                    what,
                    where=step.where,
                    remedy="Mend the cause, then go on with `starbench resume`; all attempts are kept.",
                )
            if step.on_failure == "skip":
                self._log.write(Event.DEVIATION, what=f"{what} It was skipped, as the sequence says.")
                self._say(f"{what} Skipped.")
                return
            question = f"{what} Try it again?"
            self._machine.fire(
                "hold", PromptStep(step.number, step.where, step.path, question, "abort", step.hold_s)
            )

    def keep_lost_recording(self, step: RecordStep, why: str) -> None:
        """Keep, aside, what there is of a recording at work that was not completed, and tell of it."""
        pose, attempt = step.pose, self._log.history.next_attempt(step.pose.index)
        kept = self._folder.quarantine_part(pose.index, attempt, self._ending)
        self._log.write(
            Event.ATTEMPT_LOST, pose=pose.index, pose_name=pose.name, attempt=attempt, why=why, kept=kept
        )

    def _try_attempts(self, step: RecordStep) -> list[str] | None:
        """Record up to so many times; return why the last one did not count; None when one did, or none is wanted."""
        history, pose = self._log.history, step.pose
        reasons: list[str] = []
        if pose.index in history.accepted():  # the process died between accepting it and saying so
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
