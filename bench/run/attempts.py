"""Records at a pose until a recording counts, as often as the step allows; then skips, asks or fails, as it says.

Every attempt stays as evidence. Knows the policy of a step; the states it passes and what is done in them are others'.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from bench.base.errors import PoseFailed
from bench.records.history import Event, RunLog
from bench.records.run_folder import RunFolder
from drivers.errors import RecordingFailed
from sequences.script import PromptStep, RecordStep


class Stepping(Protocol):
    """Whoever drives the states."""

    def fire_at(self, trigger: str, step: RecordStep, **facts: Any) -> None:
        """Take an edge for a step at its pose, and do the work of the state it leads to."""
        ...

    def ask(self, question: PromptStep, step: RecordStep) -> None:
        """Hold for the answer to a question about a step. Raises Aborted where it is no."""
        ...

    def between(self, step: RecordStep) -> None:
        """Be at a safe point between two attempts of a step."""
        ...


class Attempts:
    """The attempts of one run.

    Parameters
    ----------
    states
        Drives the states.
    folder, log
        The run's.
    ending
        How the names of recordings end.
    say
        Shows a line to the operator.
    """

    def __init__(
        self, states: Stepping, folder: RunFolder, log: RunLog, ending: str, say: Callable[[str], None]
    ) -> None:
        self._states = states
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
        while (reasons := self._round(step)) is not None:
            pose = step.pose
            what = f"Pose {pose.index} ({pose.name}) failed {step.attempts} attempts: {'; '.join(reasons)}."
            if step.on_failure == "fail":
                raise PoseFailed(
                    what,
                    where=step.where,
                    remedy="Mend the cause, then go on with `starbench resume`; all attempts are kept.",
                )
            if step.on_failure == "skip":
                self._log.tell(Event.DEVIATION, what=f"{what} It was skipped, as the sequence says.")
                self._say(f"{what} Skipped.")
                return
            question = f"{what} Try it again?"
            self._states.ask(
                PromptStep(step.number, step.where, step.path, question, "abort", step.hold_s), step
            )

    def lose(self, step: RecordStep, why: str) -> None:
        """Keep, aside, what there is of a recording at work that was not completed, and tell of it."""
        pose, attempt = step.pose, self._log.history.next_attempt(step.pose.index)
        kept = self._folder.quarantine_part(pose.index, attempt, self._ending)
        self._log.tell(
            Event.ATTEMPT_LOST, pose=pose.index, pose_name=pose.name, attempt=attempt, why=why, kept=kept
        )

    def _round(self, step: RecordStep) -> list[str] | None:
        """Record up to so many times; return why the last one did not count; None when one did, or none is wanted."""
        history, pose = self._log.history, step.pose
        reasons: list[str] = []
        if pose.index in history.accepted():  # the process died between accepting it and saying so
            return None
        for i in range(step.attempts):
            if i:
                self._states.fire_at("back_off", step, wait_s=step.backoff_s * 2 ** (i - 1))
                self._states.between(step)
                if pose.index in history.skipped:
                    return None
            attempt = history.next_attempt(pose.index)
            try:
                self._states.fire_at("record", step, attempt=attempt)
                self._states.fire_at("check", step, attempt=attempt)
            except RecordingFailed as error:
                reasons = [str(error)]
                self.lose(step, str(error))
                continue
            if pose.index in history.accepted():
                return None
            reasons = list((history.attempts_at(pose.index)[-1].checked or {}).get("reasons", []))
            self._say(f"Pose {pose.index} ({pose.name}), attempt {attempt}: {'; '.join(reasons)}")
        self._states.fire_at("back_off", step, wait_s=0.0)
        self._states.between(step)
        return None if pose.index in history.skipped else reasons
