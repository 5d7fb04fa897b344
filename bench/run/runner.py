"""Run a script: choose the next step, react to failures, and leave the bench safe at every end.

However a run ends, the stage is stopped, the light is off and the camera is stopped.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

from bench.base.clock import Aborted, BenchClock, Interrupted
from bench.base.errors import StorageError
from bench.base.failure import FORESEEN, Failure
from bench.base.progress import Progress
from bench.plan.job import DEVICE_STEPS, Job, ScriptStep
from bench.record import events
from bench.record.device_end import DeviceEnd
from bench.record.events import Entering, LeftOff
from bench.record.history import way_on
from bench.record.journal import Journal
from bench.record.recovery import WIRE_LOG
from bench.record.run_folder import RunFolder
from bench.record.run_log import RunLog
from bench.run.control import CommandInbox
from bench.run.heartbeat import BusyWatch, HeartbeatWriter
from bench.run.interlocks import Interlocks, Trip, loss_text
from bench.run.machine import RunMachine
from bench.run.messages.run_messages import HoldNotifier
from bench.run.run_context import RunContext, interlocks_of
from bench.run.run_devices import RunDevices
from bench.run.states import StateWork
from bench.run.status import RunPlan
from bench.run.steps import Steps
from bench.run.steps_to_do import pose_names, poses_crashed_too_often, steps_to_do
from bench.run.time_left import TimeLeft
from bench.solve.interim import Decide, decide_until
from bench.solve.result import Outcome, ResultWriter
from bench.stations.devices import Devices
from bench.wording.goals import decision_text
from drivers.errors import CameraLost, PortLost, ReplyTimeout
from drivers.wire_log import WireLogFile
from sequences.script import ChooseStep, MoveStep, RecordStep, SettleStep, WaitStep

LOST_DEVICE_ERRORS = (PortLost, CameraLost, ReplyTimeout)
"""Errors of a device that was lost, or no longer answers."""
MOST_LOSSES = 5
"""A device that is lost more often in the same step has a fault that opening it again does not mend."""

End = Literal["finished", "aborted", "failed"]


@dataclass(frozen=True)
class RunEnd:
    """How a run ended."""

    how: End  # ``finished``, ``aborted`` or ``failed``
    why: str  # Why it did not finish
    folder: Path
    outcome: Outcome | None  # Result of the run, if there is one
    unsafe: Sequence[str] = ()  # Devices that did not confirm a safe state, as text; empty if all did
    # Error that ended a failed run, with its place and remedy; None for other runs.
    failure: Failure | None = None
    opened: bool = False  # Whether the devices were open at some time
    devices: Sequence[DeviceEnd] = ()
    way_on: tuple[str, str] = ("", "")  # What helps after a run that did not finish (`bench.record.history`)


class Runner:
    """Work of one process on one run. A stop requested from the clock ends the run safely.

    ``notify`` gets the occasion (``hold``, ``failure``), a short text and the hash of the journal line.
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
        wire_log: WireLogFile | None = None,
        results: ResultWriter | None = None,
        decide: Decide | None = None,
    ) -> None:
        self._progress = progress
        self._notify = notify
        self._wire_log = wire_log
        self._hold_notifier = HoldNotifier(clock, notify)
        log = RunLog(journal)
        devices = RunDevices(job, folder, log, open_devices, progress.say)
        self.context = RunContext(
            job,
            folder,
            log,
            clock,
            devices,
            Interlocks(interlocks_of(job.station.interlocks, folder.path, devices), clock),
            results or ResultWriter(job, folder),
            decide or partial(decide_until, job, folder.path),
            progress.say,
        )
        self._machine = RunMachine(StateWork(self.context).on_enter(), self.entering, self.left_off)
        self._steps = Steps(self.context, self._machine)
        self._heartbeat = HeartbeatWriter(folder.path, clock)
        self._names = pose_names(job, log.history)
        self._plan = RunPlan.from_dict(job.plan.to_dict())
        time_left = TimeLeft(self._plan.steps, self._plan.duration_s)
        log.follow(time_left.apply)
        progress.left_s = lambda: time_left.left_s(clock.utc_now(), held=log.history.waits)
        self._count_poses()
        round_tasks = (
            self._heartbeat.beat,
            self._stop_without_supervisor,
            BusyWatch(log, clock).look,
            self.context.interlocks.check_door,
        )
        self.inbox = CommandInbox(folder.path, log, self._names, clock, round_tasks)

    @property
    def state(self) -> str:
        """Present state of the run."""
        return self._machine.state

    def run(self) -> RunEnd:
        """Do every step that is not done yet; the bench is safe at every end, and the run can be resumed."""
        try:
            with self.inbox:
                self._do_remaining_steps()
            with self.context.clock.shielded():
                self.context.devices.make_safe()
            self._note_end_of_wire_log()
            self._write_end("finished", "")
        except Aborted as stop:
            return self._end_early("aborted", stop.reason)
        except FORESEEN as error:
            return self._end_early("failed", str(error), Failure.of(error))
        except BaseException as error:
            why = f"unexpected: {type(error).__name__}: {error}"
            self._end_early("failed", why, Failure.of(error), crashed=True)
            raise
        finally:
            with self.context.clock.shielded():
                self.context.devices.make_safe()
                self.context.devices.close()
        return self._end("finished", "", outcome=self.context.results.outcome)

    def _do_remaining_steps(self) -> None:
        history = self.context.log.history
        if history.resumed:
            self._machine.fire("recover")
            self._check_unchecked()
            for pose_index, why in poses_crashed_too_often(history).items():
                self._steps.skip(pose_index, why)
        steps = steps_to_do(self.context.job, history)
        if any(isinstance(step, DEVICE_STEPS) for step in steps):
            self._with_interlocks(None, partial(self._machine.fire, "preflight"))
            self._with_interlocks(None, partial(self._prepare_bench, steps))
        needs_devices = [place for place, step in enumerate(steps) if isinstance(step, DEVICE_STEPS)]
        for place, step in enumerate(steps):
            if not isinstance(step, MoveStep | SettleStep):
                self._conclude_check()
            if place > max(needs_devices, default=-1):
                self._leave_devices()
            if history.is_left_out(step.number):
                continue
            if isinstance(step, (*DEVICE_STEPS, WaitStep)):
                self._with_interlocks(step, partial(self._do_step, step))
            else:
                self._do_step(step)
        self._conclude_check()
        self._machine.fire("finish")

    def _conclude_check(self) -> None:
        """End the check of the last recording, which went on while the stage turned; go back if it is rejected."""
        step = self._steps.in_check
        if step is not None:
            self._with_interlocks(step, partial(self._steps.conclude, step))
            self._finish_step(step)

    def _leave_devices(self) -> None:
        """Journal how the devices are left, once, when the remaining steps need none; the report states it."""
        history = self.context.log.history
        if history.devices and not history.devices_left:
            with self.context.clock.shielded():
                self.context.devices.leave()

    def _end_early(
        self, how: End, why: str, failure: Failure | None = None, *, crashed: bool = False
    ) -> RunEnd:
        """Make the bench safe and journal the end, even if it is the journal that failed."""
        with self.context.clock.shielded():
            try:
                self.context.folder.release_reserve()
                if self._machine.can("abort"):  # not if the run had finished and only its journal line failed
                    self._machine.fire("abort")
                    self._machine.fire("abort_done" if how == "aborted" else "fail")
                self.context.devices.make_safe()
                self._write_end(how, why, failure, crashed=crashed)
            except StorageError as error:
                why = f"{why} In addition, the journal could not be written: {error}"
            finally:
                self.context.devices.make_safe()
        return self._end(how, why, failure=failure)

    def _end(
        self, how: End, why: str, *, outcome: Outcome | None = None, failure: Failure | None = None
    ) -> RunEnd:
        devices = self.context.devices
        return RunEnd(
            how,
            why,
            self.context.folder.path,
            outcome,
            devices.unsafe,
            failure,
            devices.was_opened,
            devices.ends(),
            way_on(self.context.log.history, self.context.folder.path),
        )

    def _write_end(
        self, how: End, why: str, failure: Failure | None = None, *, crashed: bool = False
    ) -> None:
        """Journal the end of the run, how it leaves each device, and how late the computer was."""
        facts: dict[str, Any] = {"error": failure.to_dict()} if failure is not None else {}
        facts |= {"crashed": True} if crashed else {}
        facts["devices"] = [asdict(end) for end in self.context.devices.ends()]
        if lateness := self.context.clock.lateness():
            facts["lateness"] = lateness
        self.context.log.write(events.RunEnded, how=how, why=why, **facts)

    # ------------------------------------------------------------------ which steps

    def _prepare_bench(self, steps: list[ScriptStep]) -> None:
        """Home the stage, and set the light as the script last set it."""
        self.context.interlocks.require_clear()
        if self._machine.state != "preflight":  # an interlock held the run in between
            self._machine.fire("preflight")
        self._machine.fire("home")
        self._set_light_of_resumed(steps)

    def _set_light_of_resumed(self, steps: list[ScriptStep]) -> None:
        """Set the light as the script last set it, if a resumed run continues with recordings."""
        if self.context.log.history.resumed and steps:
            first = next((step for step in steps if isinstance(step, RecordStep)), None)
            light = self.context.job.light_before(first)
            if light is not None and light not in steps:
                self._steps.set_light(light)

    def _check_unchecked(self) -> None:
        """Measure recordings that were stored, but not yet measured when the process died."""
        history = self.context.log.history
        for step in self.context.job.steps:
            if isinstance(step, RecordStep) and (attempt := history.unchecked(step.pose.index)) is not None:
                self._steps.fire_at("check", step, attempt=attempt.attempt)
                if step.pose.index in history.accepted():
                    self.context.log.write(events.StepDone, step=step.number)

    def _do_step(self, step: ScriptStep) -> None:
        """Do a step, unless its pose is skipped."""
        self._steps.reach(step)
        if self._steps.is_skipped(step):
            if step.number not in self.context.log.history.done_steps:
                self.context.log.write(events.StepDone, step=step.number, skipped=True)
            return
        self._steps.return_to(step)
        if isinstance(step, RecordStep):
            self._steps.record(step)
        else:
            self._steps.take(step)
        if isinstance(step, ChooseStep):
            self._show_decision(step)
        if self._steps.in_check is not step:
            self._finish_step(step)

    def _finish_step(self, step: ScriptStep) -> None:
        """Journal that a step is done, once."""
        if step.number not in self.context.log.history.done_steps:
            self.context.log.write(events.StepDone, step=step.number)

    def _show_decision(self, step: ChooseStep) -> None:
        """Show what an ``until`` decided; its chosen pose can be skipped by command from now on."""
        decided = self.context.log.history.decisions[-1]
        self._progress.say(decision_text(decided))
        self._count_poses()
        if step.pose is not None and "chosen" in decided:
            self._names[step.pose.index] = step.pose.name

    def _count_poses(self) -> None:
        """Show how many poses the run has now."""
        self._progress.poses = self._plan.count_poses(self.context.log.history).text

    # ------------------------------------------------------------------ interlocks

    def _with_interlocks(self, step: ScriptStep | None, work: Callable[[], None]) -> None:
        """Do work with devices. If an interlock holds before or during it, wait, then repeat the work."""
        again, losses = False, 0
        while True:
            try:
                if again and step is not None:
                    self.context.interlocks.require_clear()
                    self._steps.prepare_again(step)
                work()
            except Interrupted:
                self._hold_for(self.context.interlocks.take_interruption(), step)
            except LOST_DEVICE_ERRORS as error:
                trip = self.context.interlocks.device_lost(loss_text(error))
                losses += 1
                if trip is None or losses > MOST_LOSSES:
                    raise
                self._hold_for(trip, step)
                if step is not None:
                    self._with_interlocks(None, partial(self._prepare_bench, []))
            else:
                return
            again = True

    def _hold_for(self, trip: Trip, step: ScriptStep | None) -> None:
        if self._machine.state == "recording" and isinstance(step, RecordStep):
            self._steps.keep_lost_recording(step, trip.text)
        self._progress.say(f"Held by {trip.text}. The run continues by itself when this is over.")
        self._machine.fire("hold", step, trip, rule=trip.interlock.name, why=trip.why)

    # ------------------------------------------------------------------ changes of state, and the supervisor

    def entering(self, data: Entering) -> None:
        """Journal a change of state before it is made; then update heartbeat, interlocks and progress."""
        self._note_end_of_wire_log()
        self.context.log.write(events.Entering, **data)
        state = data["state"]
        self._heartbeat.entering(state)
        self.context.interlocks.entering(state)
        self._progress.show(state, pose=data.get("pose"), detail=data.get("pose_name", ""))
        if state == "holding":
            self._hold_notifier.entering(data, self.context.log.journal.head)

    def _note_end_of_wire_log(self) -> None:
        """Journal once, as a deviation, that the wire log could not be written any more; the run goes on."""
        fault = self._wire_log.fault if self._wire_log else None
        if fault is not None:
            self._wire_log = None
            what = f"The log of the bytes to and from the devices, {WIRE_LOG}, ended early: {fault.why}."
            self._progress.say(f"WARNING: {what} The run continues.")
            self.context.log.write(events.Deviation, what=what, wire_log_ended_s=fault.since_s)

    def left_off(self, data: LeftOff) -> None:
        """Journal that the work of a state has ended; nothing interrupts the time between two states."""
        self.context.log.write(events.LeftOff, **data)
        self.context.interlocks.entering("")

    def _stop_without_supervisor(self) -> None:
        """End the run safely if the supervisor of this process has ended: nobody would notice its hang."""
        if self._heartbeat.supervisor_is_gone():
            self.context.clock.request_stop("its supervisor has ended")
            self.context.log.write(events.SupervisorLost)
            self._notify(
                "failure",
                "stops safely: its supervisor has ended, and no further run follows. To go on: call the batch again",
                self.context.log.journal.head,
            )
