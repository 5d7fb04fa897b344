"""Runs a script: which step comes next, what follows a failure, and how every way out ends safe.

Drives the state machine through the steps not yet done and journals each; the work itself stands in
`bench.state_work`. However a run ends, the stage is stopped, the light off and the camera stopped.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.clock import Aborted, BenchClock
from bench.devices import Devices
from bench.errors import BenchError, PoseFailed, StorageError
from bench.history import Event, RunLog
from bench.job import DEVICE_STEPS, Job, ParkStep, ScriptStep
from bench.journal import Journal
from bench.machine import RunMachine
from bench.progress import Progress
from bench.result import Outcome
from bench.run_folder import RunFolder
from bench.state_work import StateWork
from calib.errors import CalibrationError
from drivers.errors import DriverError, RecordingFailed
from sequences.script import (
    LightStep,
    MoveStep,
    PromptStep,
    RecordStep,
    ReportStep,
    SettleStep,
    SolveStep,
    WaitStep,
)

_FORESEEN = (BenchError, DriverError, CalibrationError)

_TRIGGERS: Mapping[type, str] = {
    LightStep: "set_light",
    MoveStep: "slew",
    SettleStep: "settle",
    WaitStep: "wait",
    PromptStep: "hold",
    ParkStep: "park",
    SolveStep: "solve",
    ReportStep: "report",
}
"""The edge a step takes; a RecordStep takes several."""


@dataclass(frozen=True)
class RunEnd:
    """How a run ended.

    Attributes
    ----------
    how, why
        ``finished``, ``aborted`` or ``failed``; and why it did not finish.
    folder
        The run folder.
    outcome
        Its result, where there is one.
    unsafe
        Devices that did not confirm that they are safe, in plain words; empty when all did.
    """

    how: str
    why: str
    folder: Path
    outcome: Outcome | None
    unsafe: Sequence[str] = ()


class Runner:
    """One process's work on one run.

    Parameters
    ----------
    job
        What is to be run: script, station, seed.
    folder, journal
        The run's, held by this process.
    open_devices
        Opens the station's devices; called when, and only if, a step needs them.
    clock
        The run's clock; a stop requested of it ends the run safely.
    progress
        Where to tell the operator.
    """

    def __init__(
        self,
        job: Job,
        folder: RunFolder,
        journal: Journal,
        open_devices: Callable[[], Devices],
        clock: BenchClock,
        progress: Progress,
    ) -> None:
        self._job = job
        self._folder = folder
        self._log = RunLog(journal)
        self._clock = clock
        self._progress = progress
        self._work = StateWork(job, folder, self._log, open_devices, clock, progress.say)
        self._machine = RunMachine(self._work.table(), self._tell)

    def run(self) -> RunEnd:
        """Do every step not yet done.

        Returns
        -------
        RunEnd
            Also when it was aborted or failed: the bench is then safe and the run can be resumed.

        Raises
        ------
        Exception
            Only what nobody foresaw; the bench is safe even then.
        """
        try:
            self._work_through()
            self._log.tell(Event.RUN_ENDED, how="finished", why="")
        except Aborted as stop:
            return self._end_early("aborted", stop.reason, "abort_done")
        except _FORESEEN as error:
            return self._end_early("failed", str(error), "fail")
        except BaseException as error:
            self._end_early("failed", f"unforeseen: {type(error).__name__}: {error}", "fail")
            raise
        finally:
            with self._clock.shielded():
                self._work.make_safe()
                self._work.close()
        return RunEnd("finished", "", self._folder.path, self._work.results.outcome, self._work.unsafe)

    def _work_through(self) -> None:
        if self._log.history.resumed:
            self._machine.fire("recover")
            self._check_what_was_stored()
        steps = self._remaining()
        if any(isinstance(step, DEVICE_STEPS) for step in steps):
            self._machine.fire("preflight")
            self._machine.fire("home")
            self._rearm(steps)
        for step in steps:
            self._clock.check()
            self._do(step)
        self._machine.fire("finish")

    def _end_early(self, how: str, why: str, last_edge: str) -> RunEnd:
        """Make the bench safe and tell the journal, which may be what failed."""
        with self._clock.shielded():
            try:
                self._folder.release_reserve()
                self._machine.fire("abort")
                self._machine.fire(last_edge)
                self._log.tell(Event.RUN_ENDED, how=how, why=why)
            except StorageError as error:
                why = f"{why} Besides, the journal could not be told: {error}"
            finally:
                self._work.make_safe()
        return RunEnd(how, why, self._folder.path, None, self._work.unsafe)

    # ------------------------------------------------------------------ which steps

    def _remaining(self) -> list[ScriptStep]:
        """Steps to do: those not done, and those done that the first of them stands on.

        A recording (or settling) stands on the move before it, a report on the solution before it.
        """
        done, steps = self._log.history.done_steps, self._job.steps
        todo = [i for i, step in enumerate(steps) if step.number not in done]
        again: set[int] = set()
        for wanted, ground, kept in (
            ((MoveStep, SettleStep, RecordStep), MoveStep, (MoveStep, SettleStep)),
            ((SolveStep, ReportStep), SolveStep, (SolveStep,)),
        ):
            first = next((i for i in todo if isinstance(steps[i], wanted)), None)
            if first is not None and not isinstance(steps[first], ground):
                begin = max((i for i in range(first) if isinstance(steps[i], ground)), default=first)
                again |= {i for i in range(begin, first) if isinstance(steps[i], kept)}
        return [steps[i] for i in sorted({*again, *todo})]

    def _rearm(self, steps: list[ScriptStep]) -> None:
        """Set the light as the script last set it, where a resumed run goes on with recordings."""
        if not self._log.history.resumed:
            return
        light = self._job.light_before(next((s for s in steps if isinstance(s, RecordStep)), None))
        if light is not None and light not in steps:
            self._work.step = light
            self._machine.fire("set_light", step=light.number)

    def _check_what_was_stored(self) -> None:
        """Look at recordings that were stored, but not looked at when the process died."""
        history = self._log.history
        for step in self._job.steps:
            if isinstance(step, RecordStep) and (attempt := history.unchecked(step.pose.index)) is not None:
                self._work.step = step
                self._fire("check", step, attempt=attempt.attempt)
                if step.pose.index in history.accepted():
                    self._log.tell(Event.STEP_DONE, step=step.number)

    # ------------------------------------------------------------------ one step

    def _do(self, step: ScriptStep) -> None:
        self._work.step = step
        if isinstance(step, RecordStep):
            self._record_until_accepted(step)
        elif isinstance(step, MoveStep):
            self._fire("slew", step, target_deg=dict(step.pose.angles_deg))
        else:
            self._machine.fire(_TRIGGERS[type(step)], step=step.number)
        if step.number not in self._log.history.done_steps:
            self._log.tell(Event.STEP_DONE, step=step.number)
        done_s = self._job.done_after_s(step)
        if done_s is not None:
            self._progress.done(done_s)

    def _record_until_accepted(self, step: RecordStep) -> None:
        """Record until accepted; once the attempts are used up, do as the sequence says."""
        while (reasons := self._attempts(step)) is not None:
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
                self._progress.say(f"{what} Skipped.")
                return
            question = f"{what} Try it again?"
            self._work.step = PromptStep(step.number, step.where, step.path, question, "abort", step.hold_s)
            self._machine.fire("hold", step=step.number)
            self._work.step = step

    def _attempts(self, step: RecordStep) -> list[str] | None:
        """Record up to so many times; return why the last one did not count, or None when one did."""
        history, pose = self._log.history, step.pose
        reasons: list[str] = []
        if pose.index in history.accepted():  # the process died between accepting it and saying so
            return None
        for i in range(step.attempts):
            if i:
                self._fire("back_off", step, wait_s=step.backoff_s * 2 ** (i - 1))
            attempt = history.next_attempt(pose.index)
            try:
                self._fire("record", step, attempt=attempt)
                self._fire("check", step, attempt=attempt)
            except RecordingFailed as error:
                reasons = [str(error)]
                self._lose(step, attempt, error)
                continue
            if pose.index in history.accepted():
                return None
            reasons = list((history.attempts_at(pose.index)[-1].checked or {}).get("reasons", []))
            self._progress.say(f"Pose {pose.index} ({pose.name}), attempt {attempt}: {'; '.join(reasons)}")
        self._fire("back_off", step, wait_s=0.0)
        return reasons

    def _lose(self, step: RecordStep, attempt: int, error: RecordingFailed) -> None:
        """Keep what there is of a recording that the camera could not complete."""
        kept = self._folder.set_part_aside(step.pose.index, attempt)
        self._log.tell(
            Event.ATTEMPT_LOST,
            pose=step.pose.index,
            pose_name=step.pose.name,
            attempt=attempt,
            why=str(error),
            kept=kept,
        )

    def _fire(self, trigger: str, step: MoveStep | RecordStep, **facts: Any) -> None:
        self._machine.fire(trigger, step=step.number, pose=step.pose.index, pose_name=step.pose.name, **facts)

    def _tell(self, event: str, facts: Mapping[str, Any]) -> None:
        self._log.tell(Event(event), **facts)
        if event == Event.ENTERING:
            self._progress.show(
                facts["state"], pose=facts.get("pose"), detail=str(facts.get("pose_name", ""))
            )
