"""Runs a script: which step comes next, what follows a failure, and how every way out ends safe.

Drives the state machine through the steps not yet done and journals each; the work itself stands in
`bench.run.state_work`. However a run ends, the stage is stopped, the light off and the camera stopped.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from bench.base.clock import Aborted, BenchClock, Interrupted
from bench.base.errors import BenchError, StorageError
from bench.plan.job import DEVICE_STEPS, Job, ParkStep, ScriptStep
from bench.records.history import Event, RunLog
from bench.records.journal import Journal
from bench.records.run_folder import RunFolder
from bench.results.result import Outcome, ResultWriter
from bench.run.attempts import Attempts
from bench.run.control import Inbox
from bench.run.heartbeat import Pulse
from bench.run.holding import HoldNews
from bench.run.interlocks import Trip
from bench.run.machine import RunMachine
from bench.run.resumption import crash_looped, ground, remaining, steps_of_pose
from bench.run.state_work import StateWork
from bench.stations.devices import Devices
from bench.terminal.progress import Progress
from calib.errors import CalibrationError
from drivers.errors import CameraLost, DriverError, PortLost, ReplyTimeout
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

LOST = (PortLost, CameraLost, ReplyTimeout)
"""A device went away, or says nothing any more."""
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
    notify
        Called with the occasion (``hold``, ``failure``), a few words and the hash of the journal's line, whenever
        somebody should hear of the run before it ends.
    results
        Computes and writes the results; a ``ResultWriter`` of the folder unless told otherwise.
    """

    def __init__(
        self,
        job: Job,
        folder: RunFolder,
        journal: Journal,
        open_devices: Callable[[], Devices],
        clock: BenchClock,
        progress: Progress,
        notify: Callable[[str, str, str], None] = lambda _occasion, _what, _key: None,
        results: ResultWriter | None = None,
    ) -> None:
        self._notify = notify
        self._left_out: dict[int, set[int]] = {}  # steps of the poses that are skipped
        self._hold_news = HoldNews(clock, notify)
        self._job = job
        self._folder = folder
        self._log = RunLog(journal)
        self._clock = clock
        self._progress = progress
        self._work = StateWork(job, folder, self._log, open_devices, clock, progress.say, results)
        self._machine = RunMachine(self._work.table(), self._tell)
        self._attempts = Attempts(self, folder, self._log, job.camera_kind.ending, progress.say)
        names = {pose.index: pose.name for pose in job.plan.poses}
        self._pulse = Pulse(folder.path, clock)
        self._interlocks = self._work.interlocks
        looks = (self._pulse.beat, self._see_supervisor, self._interlocks.look)
        self._inbox = Inbox(folder.path, self._log, names, clock, looks)

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
            with self._inbox:
                self._work_through()
            self._log.tell(Event.RUN_ENDED, how="finished", why="")
        except Aborted as stop:
            return self._end_early("aborted", stop.reason, "abort_done")
        except _FORESEEN as error:
            return self._end_early("failed", str(error), "fail")
        except BaseException as error:
            self._end_early("failed", f"unforeseen: {type(error).__name__}: {error}", "fail", crashed=True)
            raise
        finally:
            with self._clock.shielded():
                self._work.make_safe()
                self._work.close()
        return RunEnd("finished", "", self._folder.path, self._work.results.outcome, self._work.unsafe)

    def _work_through(self) -> None:
        history = self._log.history
        if history.resumed:
            self._machine.fire("recover")
            self._check_what_was_stored()
            for pose_index, why in crash_looped(history).items():
                self._skip(pose_index, why)
        steps = remaining(self._job.steps, history.done_steps)
        if any(isinstance(step, DEVICE_STEPS) for step in steps):
            self._guarded(None, partial(self._machine.fire, "preflight"))
            self._guarded(None, partial(self._make_ready, steps))
        for step in steps:
            if isinstance(step, (*DEVICE_STEPS, WaitStep)):
                self._guarded(step, partial(self._next, step))
            else:
                self._next(step)
        self._machine.fire("finish")

    def _make_ready(self, steps: list[ScriptStep]) -> None:
        """Find the stage's reference, and set the light as the script last set it."""
        self._interlocks.heed()
        if self._machine.state != "preflight":  # an interlock held meanwhile
            self._machine.fire("preflight")
        self._machine.fire("home")
        self._rearm(steps)

    def _next(self, step: ScriptStep) -> None:
        """Do a step, unless its pose is skipped."""
        self._safe_point(step)
        if step.number in self._skipped_steps():
            self._leave_out(step)
        else:
            self._do(step)

    def _end_early(self, how: str, why: str, last_edge: str, *, crashed: bool = False) -> RunEnd:
        """Make the bench safe and tell the journal, which may be what failed."""
        with self._clock.shielded():
            try:
                self._folder.release_reserve()
                if self._machine.can("abort"):  # not where it had finished, and only that could not be told
                    self._machine.fire("abort")
                    self._machine.fire(last_edge)
                self._log.tell(Event.RUN_ENDED, how=how, why=why, **({"crashed": True} if crashed else {}))
            except StorageError as error:
                why = f"{why} Besides, the journal could not be told: {error}"
            finally:
                self._work.make_safe()
        return RunEnd(how, why, self._folder.path, None, self._work.unsafe)

    # ------------------------------------------------------------------ which steps

    def _rearm(self, steps: list[ScriptStep]) -> None:
        """Set the light as the script last set it, where a resumed run goes on with recordings."""
        if self._log.history.resumed and steps:
            first = next((step for step in steps if isinstance(step, RecordStep)), None)
            light = self._job.light_before(first)
            if light is not None and light not in steps:
                self._set_light_again(light)

    def _set_light_again(self, light: LightStep) -> None:
        self._work.step = light
        self._machine.fire("set_light", step=light.number)

    def _check_what_was_stored(self) -> None:
        """Look at recordings that were stored, but not looked at when the process died."""
        history = self._log.history
        for step in self._job.steps:
            if isinstance(step, RecordStep) and (attempt := history.unchecked(step.pose.index)) is not None:
                self._work.step = step
                self.fire_at("check", step, attempt=attempt.attempt)
                if step.pose.index in history.accepted():
                    self._log.tell(Event.STEP_DONE, step=step.number)

    # ------------------------------------------------------------------ what interlocks ask for

    def _guarded(self, step: ScriptStep | None, work: Callable[[], None]) -> None:
        """Do work with devices; where an interlock holds before or in the midst of it, wait, and do it again."""
        again = False
        while True:
            try:
                if again and step is not None:
                    self._interlocks.heed()
                    self._prepare_again(step)
                work()
            except Interrupted:
                self._hold_by_rule(step, self._interlocks.take())
            except LOST as error:
                trip = self._interlocks.lost(str(error))
                if trip is None:
                    raise
                self._hold_by_rule(step, trip)
                if step is not None:
                    self._guarded(None, partial(self._make_ready, []))
            else:
                return
            again = True

    def _hold_by_rule(self, step: ScriptStep | None, trip: Trip) -> None:
        if self._machine.state == "recording" and isinstance(step, RecordStep):
            self._attempts.lose(step, trip.text)
        self._work.step, self._work.holding.trip = step, trip
        self._progress.say(f"Held by {trip.text}; the run goes on by itself once that is over.")
        number = {} if step is None else {"step": step.number}
        self._machine.fire("hold", **number, rule=trip.interlock.name, why=trip.why)

    # ------------------------------------------------------------------ what operators ask for

    def _safe_point(self, step: ScriptStep) -> None:
        """Between two pieces of work, before ``step``: stop, hold, or skip poses, as asked."""
        self._clock.check()
        self._interlocks.heed()
        holder = self._log.history.holder
        if holder and self._machine.can("hold"):
            self._hold(step, holder)
        history = self._log.history
        accepted = history.accepted()
        for pose_index, by in list(history.to_skip.items()):
            if pose_index not in history.skipped and pose_index not in accepted:
                self._skip(pose_index, f"{by} asked for it")
        if holder and step.number not in self._skipped_steps():
            self._prepare_again(step)

    def _hold(self, step: ScriptStep, by: str) -> None:
        begin_s = self._clock.monotonic()
        self._work.step = step
        self._progress.say(f"Held by {by}; `starbench release` lets the run go on.")
        self._machine.fire("hold", step=step.number, by=by)
        held_s = self._clock.monotonic() - begin_s
        before = "parking" if isinstance(step, ParkStep) else f"step {step.number}"
        self._log.tell(Event.DEVIATION, what=f"Held by {by} for {held_s:.0f} s before {before}.")

    def _prepare_again(self, step: ScriptStep) -> None:
        """After a hold, where recordings follow: the light as it was, and the move they stand on, repeated."""
        here = self._job.place(step)
        if not any(isinstance(coming, RecordStep) for coming in self._job.steps[here:]):
            return
        light = self._job.light_before(step)
        if light is not None and not isinstance(step, LightStep):
            self._set_light_again(light)
        for stood_on in ground(self._job.steps, step):
            self._work.step = stood_on
            self._take(stood_on)

    def _skip(self, pose_index: int, why: str) -> None:
        name = self._job.record_step(pose_index).pose.name
        what = f"Pose {pose_index} ({name}) was skipped: {why}."
        self._log.tell(Event.POSE_SKIPPED, pose=pose_index, pose_name=name, what=what)
        self._progress.say(what)

    def _skipped_steps(self) -> set[int]:
        for pose in self._log.history.skipped.keys() - self._left_out.keys():
            self._left_out[pose] = {s.number for s in steps_of_pose(self._job.steps, pose)}
        return set[int]().union(*self._left_out.values())

    def _leave_out(self, step: ScriptStep) -> None:
        if step.number not in self._log.history.done_steps:
            self._log.tell(Event.STEP_DONE, step=step.number, skipped=True)

    # ------------------------------------------------------------------ one step

    def _do(self, step: ScriptStep) -> None:
        self._work.step = step
        if isinstance(step, RecordStep):
            self._attempts.record(step)
        else:
            self._take(step)
        if step.number not in self._log.history.done_steps:
            self._log.tell(Event.STEP_DONE, step=step.number)
        done_s = self._job.done_after_s(step)
        if done_s is not None:
            self._progress.done(done_s)

    def _take(self, step: ScriptStep) -> None:
        """Take the one edge of a step that records nothing."""
        if isinstance(step, MoveStep):
            self.fire_at("slew", step, target_deg=dict(step.pose.angles_deg))
        else:
            self._machine.fire(_TRIGGERS[type(step)], step=step.number)

    # ------------------------------------------------------------------ what attempts at a recording need

    def fire_at(self, trigger: str, step: MoveStep | RecordStep, **facts: Any) -> None:
        """Take an edge for a step at its pose, and do the work of the state it leads to."""
        self._machine.fire(trigger, step=step.number, pose=step.pose.index, pose_name=step.pose.name, **facts)

    def ask(self, question: PromptStep, step: RecordStep) -> None:
        """Hold for the answer to a question about a step. Raises Aborted where it is no."""
        self._work.step = question
        self._machine.fire("hold", step=step.number)
        self._work.step = step

    def between(self, step: RecordStep) -> None:
        """Be at a safe point between two attempts of a step."""
        self._safe_point(step)
        self._work.step = step

    # ------------------------------------------------------------------ what others are told

    def _see_supervisor(self) -> None:
        """Note that nobody watches this process any more, and go on: the run is as good as before."""
        if self._pulse.lost_supervisor():
            self._log.tell(Event.SUPERVISOR_LOST)
            self._notify(
                "failure", "goes on, but what watched it is gone: nothing follows it", self._log.journal.head
            )

    def _tell(self, event: str, facts: Mapping[str, Any]) -> None:
        self._log.tell(Event(event), **facts)
        if event == Event.ENTERING:
            self._pulse.entering(facts["state"])
            self._interlocks.entering(facts["state"])
            self._progress.show(
                facts["state"], pose=facts.get("pose"), detail=str(facts.get("pose_name", ""))
            )
            if facts["state"] == "holding":
                self._hold_news.entering(facts, self._log.journal.head)
        else:
            self._interlocks.left_off()
