"""The work of each state of a run: the actions of the devices and their journal lines.

Devices are used through their protocols only. The runner decides which state comes next and what follows a failure;
`bench.views.measure` and `bench.results.result` do the calculations.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any

from bench.base.clock import BenchClock
from bench.plan.job import Job
from bench.plan.script_steps import ScriptStep
from bench.records.events import Event
from bench.records.recovery import recover
from bench.records.run_folder import RunFolder
from bench.records.run_log import RunLog
from bench.records.written import written_files
from bench.results.interim import Decisions
from bench.results.result import ResultWriter
from bench.run.holding import Holding
from bench.run.interlocks import Trip
from bench.run.last_view import leave_view
from bench.run.preflight import preflight, require_no_faults, stage_faults
from bench.run.run_devices import RunDevices
from bench.views.expected_grid import grid_from_earlier_poses
from bench.views.gates import failed_gate_texts
from bench.views.measure import Measurement
from bench.views.placements import with_advice
from sequences.script import (
    ChooseStep,
    LightStep,
    MoveStep,
    PromptStep,
    RecordStep,
    SettleStep,
    SolveStep,
    WaitStep,
)


class StateWork:
    """The work of the states. Each method receives the step for which its state is entered.

    holding: The work of the state ``holding``.
    decisions: Decides for the ``until`` steps.
    """

    def __init__(
        self,
        job: Job,
        folder: RunFolder,
        log: RunLog,
        devices: RunDevices,
        holding: Holding,
        results: ResultWriter,
        decisions: Decisions,
        clock: BenchClock,
    ) -> None:
        self._job = job
        self._folder = folder
        self._log = log
        self._devices = devices
        self._holding = holding
        self._results = results
        self._decisions = decisions
        self._clock = clock
        self._measured: dict[int, Measurement] = {}

    def table(self) -> Mapping[str, Callable[..., None]]:
        """Return the work of each state that has any, for the state machine.

        Returns: Method to call, by the state's name.
        """
        return {
            "recovering": self.recover,
            "preflight": self.preflight,
            "homing": self.home,
            "lighting": self.set_light,
            "slewing": self.slew,
            "settling": self.stand_still,
            "waiting": self.stand_still,
            "recording": self.record,
            "checking": self.check,
            "choosing": self.choose,
            "backing_off": self.back_off,
            "holding": self.hold,
            "parking": self.park,
            "solving": self.solve,
            "reporting": self.report,
            "aborting": self.make_safe,
        }

    def recover(self, *_: Any, **__: Any) -> None:
        """Put the run folder in order after a process died while working on it."""
        notes = recover(self._folder, self._log.journal)
        self._log.write(Event.RECOVERED, **notes.as_data())
        for name in notes.missing:
            self._log.write(Event.DEVIATION, what=f"{name} was missing when the run was resumed.")
        for name in notes.changed:
            self._log.write(
                Event.DEVIATION,
                what=f"{name} was changed before the run was resumed; it was moved to quarantine.",
            )

    def preflight(self, *_: Any, **__: Any) -> None:
        """Open the devices if they are not open; check their identity and faults."""
        self._log.write(Event.DEVICES, **preflight(self._devices.open(), self._job))

    def home(self, *_: Any, **__: Any) -> None:
        """Home the stage, unless it is homed."""
        devices = self._devices.opened
        if not devices.stage.is_homed():
            devices.stage.home()
        require_no_faults(stage_faults(devices))

    def set_light(self, step: LightStep, **_: Any) -> None:
        """Set the light as the step says."""
        light = self._devices.opened.light
        if step.flicker is None:
            light.off()
            return
        light.apply(self._job.light_settings(step.flicker))
        light.on()

    def slew(self, step: MoveStep, **_: Any) -> None:
        """Move the stage to the step's pose."""
        self._devices.opened.stage.move_to(step.pose.angles_deg)

    def stand_still(self, step: SettleStep | WaitStep, **_: Any) -> None:
        """Wait for the duration of the step."""
        self._clock.sleep(step.duration_s)

    def record(self, step: RecordStep, *, attempt: int, **_: Any) -> None:
        """Record at the step's pose. On return, the recording is complete, in its place and journaled.

        attempt: Number of the attempt, from 1.
        """
        pose, kind, devices = step.pose, self._job.camera_kind, self._devices.opened
        before = self._devices.position_deg()
        light = devices.light.read()
        part = self._folder.capture_part_path(pose.index, attempt, kind.ending)
        facts = kind.record(devices.camera, part, step, self._job.frequency_hz(step))
        after = self._devices.position_deg()
        capture = self._folder.commit_capture(pose.index, attempt, kind.ending, self._clock.monotonic)
        self._log.write(
            Event.CAPTURE_STORED,
            capture=capture.name,
            size=capture.size,
            sha256=capture.sha256,
            pose=pose.index,
            pose_name=pose.name,
            attempt=attempt,
            commanded_deg=dict(pose.angles_deg),
            measured_deg=before,
            measured_after_deg=after,
            light=asdict(light),
            facts=asdict(facts),
        )

    def check(self, step: RecordStep, *, attempt: int, **_: Any) -> None:
        """Measure the recording just stored; accept it or journal why not.

        attempt: Number of the attempt, from 1.
        """
        pose, job, history = step.pose, self._job, self._log.history
        stored = next(a for a in history.attempts_at(pose.index) if a.attempt == attempt).stored
        frequency_hz = job.frequency_hz(step)
        expected = grid_from_earlier_poses(history, stored, job.target)
        path = self._folder.path / stored["capture"]
        found = job.camera_kind.measure(path, step, frequency_hz, job.target, expected)
        leave_view(self._folder.path, pose.index, attempt, found, job.target)
        gates, other_reasons = job.camera_kind.judge(stored["facts"], step, frequency_hz, found)
        gates += job.motion_gates(stored["measured_deg"], stored["measured_after_deg"])
        reasons = [found.fault] if found.fault else []
        reasons += failed_gate_texts(gates) + other_reasons
        if not reasons:
            self._measured[pose.index] = found
        self._log.write(
            Event.ATTEMPT_CHECKED,
            pose=pose.index,
            attempt=attempt,
            accepted=not reasons,
            reasons=reasons,
            stars=found.stars,
            gates=[gate.as_data() for gate in gates],
            measured=found.facts,
        )

    def choose(self, step: ChooseStep, **_: Any) -> None:
        """Choose the next pose of an ``until``, or end it; a decision that the journal holds is kept."""
        history = self._log.history
        if any(decided["step"] == step.number for decided in history.decisions):
            return
        decided = self._decisions.decide(step, history, self._measured, self._clock.check)
        self._log.write(Event.UNTIL_DECIDED, **decided)

    def back_off(self, _step: RecordStep, *, wait_s: float, **_: Any) -> None:
        """Wait after a rejected recording, so that its cause may pass.

        wait_s: Duration, s.
        """
        self._clock.sleep(wait_s)

    def hold(self, step: ScriptStep | None, trip: Trip | None = None, *, by: str = "", **_: Any) -> None:
        """Hold for an operator, for an interlock, or for the answer to the step's question.

        step: Step that comes next, or the prompt step; None before the first step.
        trip: Interlock that holds the run, if any.
        by: Operator who holds the run; empty if there is none.
        """
        question = step if isinstance(step, PromptStep) else None
        if question is not None and self._job.board is not None:
            question = with_advice(question, self._log.history, self._job.board)
        self._holding.hold(question, trip, by=by)
        simulation = self._devices.opened.simulation if question and question.placement else None
        if question and simulation:  # on a simulated bench nobody else can place the board
            simulation.hands.place_board(question.placement)

    def park(self, *_: Any, **__: Any) -> None:
        """Switch the light off and move the stage to zero, because no later step needs them."""
        devices = self._devices.opened
        devices.light.off()
        devices.stage.move_to(dict.fromkeys(devices.stage.axes, 0.0))

    def solve(self, step: SolveStep, **_: Any) -> None:
        """Calibrate from the accepted recordings."""
        solved = self._results.solve(step, self._log.history, self._measured, self._clock.check)
        self._log.write(Event.SOLVED, **solved)

    def report(self, *_: Any, **__: Any) -> None:
        """Write results, images, exports and the report; then journal their hashes."""
        truth = self._devices.truth() if self._devices.is_open else self._job.read_truth()
        self._results.write(self._log, truth)
        outcome = self._results.outcome
        if outcome is not None and outcome.journal_head:  # a rehearsal writes results alone
            written = written_files(self._folder.path)
            self._log.write(Event.WRITTEN, head=outcome.journal_head, **written)

    def make_safe(self, *_: Any, **__: Any) -> None:
        """Stop the stage, switch the light off, stop the camera. Never raises."""
        self._devices.make_safe()
