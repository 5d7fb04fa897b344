"""What is done in each state of a run: the hardware actions and their journal lines.

Reaches devices through their protocols only. When what is done, and what follows a failure, is the runner's
business; what is computed from recordings stands in `bench.views.measure` and `bench.results.result`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any, cast

from bench.base.clock import BenchClock
from bench.plan.job import Job, ScriptStep
from bench.records.history import Event, RunLog
from bench.records.run_folder import RunFolder
from bench.records.storage import storage_errors
from bench.results.result import ResultWriter
from bench.run.holding import Holding
from bench.run.interlocks import Interlocks, interlocks_of
from bench.run.preflight import preflight, refuse, stage_faults
from bench.stations.devices import Devices
from bench.views.expected_grid import by_earlier_poses
from bench.views.gates import failures
from bench.views.measure import Measurement
from drivers.camera import EventCamera
from drivers.errors import DriverError, WrongDevice
from sequences.script import (
    LightStep,
    MoveStep,
    RecordStep,
    SettleStep,
    SolveStep,
    WaitStep,
)

PROBE = "probe.raw"
"""A short recording in the dark, never kept."""


class StateWork:
    """The work of the states, for the step at hand (``step``)."""

    def __init__(
        self,
        job: Job,
        folder: RunFolder,
        log: RunLog,
        open_devices: Callable[[], Devices],
        clock: BenchClock,
        say: Callable[[str], None],
        results: ResultWriter | None = None,
    ) -> None:
        self.step: ScriptStep | None = None
        self.unsafe: list[str] = []
        self.results = results or ResultWriter(job, folder)
        self._job = job
        self._folder = folder
        self._log = log
        self._open_devices = open_devices
        self._clock = clock
        self._say = say
        self._devices: Devices | None = None
        self._made_safe = False
        self._rate_heeded = 0
        self.interlocks = Interlocks(
            interlocks_of(
                job.station.interlocks,
                folder.path,
                read_c=self._camera_c,
                last_mev_s=self._last_mev_s,
                dark_mev_s=self._dark_mev_s,
                reopen=self.reopen,
            ),
            clock,
        )
        self.holding = Holding(self, log, self.interlocks, clock, say)
        self._measured: dict[int, Measurement] = {}

    def table(self) -> Mapping[str, Callable[..., None]]:
        """The work of each state that has some, for the state machine."""
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
            "backing_off": self.back_off,
            "holding": self.hold,
            "parking": self.park,
            "solving": self.solve,
            "reporting": self.report,
            "aborting": self.make_safe,
        }

    @property
    def devices(self) -> Devices:
        """The open devices; the machine has no edge that leads here before preflight."""
        assert self._devices is not None
        return self._devices

    def recover(self, **_: Any) -> None:
        """Put the run folder in order after a process died in it."""
        notes = self._folder.recover(self._log.journal)
        self._log.tell(Event.RECOVERED, **notes.as_data())
        for name in notes.missing:
            self._log.tell(Event.DEVIATION, what=f"{name} was missing when the run was resumed.")
        for name in notes.changed:
            self._log.tell(
                Event.DEVIATION, what=f"{name} had changed when the run was resumed; it was set aside."
            )

    def preflight(self, **_: Any) -> None:
        """Open the devices, unless they are, and see that they are those of the station file, and fit to begin."""
        if self._devices is None:
            self._devices = self._open_devices()
        self._log.tell(Event.DEVICES, **preflight(self._devices, self._job))

    def home(self, **_: Any) -> None:
        """Find the stage's reference, unless it has one."""
        if not self.devices.stage.is_homed():
            self.devices.stage.home()
        refuse(stage_faults(self.devices))

    def set_light(self, **_: Any) -> None:
        """Switch the light as the step says."""
        assert isinstance(self.step, LightStep)
        if self.step.flicker is None:
            self.devices.light.off()
            return
        self.devices.light.apply(self._job.light_settings(self.step.flicker))
        self.devices.light.on()

    def slew(self, **_: Any) -> None:
        """Turn the camera into the step's pose."""
        assert isinstance(self.step, MoveStep)
        self.devices.stage.move_to(self.step.pose.angles_deg)

    def stand_still(self, **_: Any) -> None:
        """Let the step's time pass."""
        assert isinstance(self.step, SettleStep | WaitStep)
        self._clock.sleep(self.step.duration_s)

    def record(self, *, attempt: int, **_: Any) -> None:
        """Record at the step's pose; when this returns, the recording is whole, in its place and journaled."""
        assert isinstance(self.step, RecordStep)
        pose = self.step.pose
        before = self._position()
        light = self.devices.light.read()
        kind = self._job.camera_kind
        part = self._folder.capture_part_path(pose.index, attempt, kind.ending)
        facts = kind.record(self.devices.camera, part, self.step, self._job.frequency_hz(self.step))
        after = self._position()
        capture = self._folder.commit_capture(pose.index, attempt, kind.ending)
        self._log.tell(
            Event.CAPTURE_STORED,
            **capture.as_data(),
            pose=pose.index,
            pose_name=pose.name,
            attempt=attempt,
            commanded_deg=dict(pose.angles_deg),
            measured_deg=before,
            measured_after_deg=after,
            light=asdict(light),
            facts=dict(facts),
        )

    def check(self, *, attempt: int, **_: Any) -> None:
        """Look at the recording just stored: stars, event rate, triggers, motion; accept it or say why not."""
        assert isinstance(self.step, RecordStep)
        pose = self.step.pose
        stored = next(a for a in self._log.history.attempts_at(pose.index) if a.attempt == attempt).stored
        expect = by_earlier_poses(self._log.history, stored, self._job.target)
        found = self._job.measure(self._folder.path / stored["capture"], self.step, expect)
        frequency_hz = self._job.frequency_hz(self.step)
        judged, against = self._job.camera_kind.judge(stored["facts"], self.step, frequency_hz, found)
        judged += self._job.motion_gates(stored["measured_deg"], stored["measured_after_deg"])
        reasons = [found.fault] if found.fault else []
        reasons += failures(judged) + against
        if not reasons:
            self._measured[pose.index] = found
        self._log.tell(
            Event.ATTEMPT_CHECKED,
            pose=pose.index,
            attempt=attempt,
            accepted=not reasons,
            reasons=reasons,
            stars=found.stars,
            gates=[gate.as_data() for gate in judged],
            measured=dict(found.facts),
        )

    def back_off(self, *, wait_s: float, **_: Any) -> None:
        """Let time pass after a recording that does not count, so that its cause may pass too."""
        self._clock.sleep(wait_s)

    def hold(self, *, by: str = "", rule: str = "", **_: Any) -> None:
        """Hold for an operator (``by``), by an interlock (``rule``), or for the answer to the step's question."""
        self.holding.hold(self.step, by=by, rule=rule)

    def park(self, **_: Any) -> None:
        """Light off, stage back to zero: nothing more is needed of them."""
        self.devices.light.off()
        self.devices.stage.move_to(dict.fromkeys(self.devices.stage.axes, 0.0))

    def solve(self, **_: Any) -> None:
        """Calibrate from the accepted recordings."""
        assert isinstance(self.step, SolveStep)
        solved = self.results.solve(self.step, self._log.history, self._measured, self._clock.check)
        self._log.tell(Event.SOLVED, **solved)

    def report(self, **_: Any) -> None:
        """Write results, pictures, exports and the report."""
        truth = self._devices.truth() if self._devices is not None else self._job.read_truth()
        self.results.write(self._log, truth)

    def make_safe(self, **_: Any) -> None:
        """Stop the stage, switch the light off, stop the camera: each, whatever the others do; once. Never raises.

        What did not confirm stands in ``unsafe`` afterwards.
        """
        if self._devices is None or self._made_safe:
            return
        self._made_safe = True
        self.unsafe = self._devices.make_safe()
        for fault in self.unsafe:
            self._say(f"CHECK THE BENCH: {fault}")

    def close(self) -> None:
        """Let the devices go; nothing moves."""
        if self._devices is not None:
            self._devices.close()

    # ------------------------------------------------------------------ while an interlock holds

    def switch_off_light(self) -> None:
        """Switch the light off, where devices are open."""
        if self._devices is not None:
            self._devices.light.off()

    def come_to_rest(self) -> None:
        """Stop the stage, switch the light off, stop the camera; what cannot be is told, and not raised."""
        if self._devices is not None:
            for fault in self._devices.make_safe():
                self._say(f"CHECK THE BENCH: {fault}")
                self._log.tell(Event.DEVIATION, what=f"Held, and {fault}")

    def reopen(self) -> str:
        """Open all devices anew, each the one it was; say why that failed. Nothing moves.

        Raises
        ------
        WrongDevice
            When another device stands in the place of one.
        """
        if self._devices is not None:
            self._devices.close()
            self._devices = None
        try:
            self._devices = self._open_devices()
        except WrongDevice:
            raise
        except DriverError as error:
            return str(error)
        self.come_to_rest()
        return ""

    def _camera_c(self) -> float | None:
        if self._devices is None or self._job.camera_kind.name != "event":
            return None
        return cast("EventCamera", self._devices.camera).temperature_c()

    def _last_mev_s(self) -> float:
        """Event rate of the last recording; 0 where that has been heeded already."""
        attempts = self._log.history.attempts
        if len(attempts) <= self._rate_heeded:
            return 0.0
        return self._rate_mev_s(attempts[-1].stored["facts"])

    def _dark_mev_s(self, duration_s: float) -> float:
        """Event rate of a short recording in the dark, which is not kept; 0 of a camera that sends no events."""
        self._rate_heeded = len(self._log.history.attempts)
        if self._job.camera_kind.name != "event":
            return 0.0
        part = self._folder.part_path(PROBE)
        try:
            facts = cast("EventCamera", self.devices.camera).record(part, duration_s)
        finally:
            with storage_errors(part):
                part.unlink(missing_ok=True)
        return self._rate_mev_s(asdict(facts))

    @staticmethod
    def _rate_mev_s(facts: Mapping[str, Any]) -> float:
        duration_s = facts.get("duration_s") or 0.0
        return facts.get("events", 0) / duration_s / 1e6 if duration_s else 0.0

    def _position(self) -> dict[str, float]:
        stage = self.devices.stage
        return {**stage.position_deg(), **{f"{axis}_encoder": a for axis, a in stage.encoder_deg().items()}}
