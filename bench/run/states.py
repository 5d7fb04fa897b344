"""The work of each state of a run: the actions of the devices and their journal lines.

Devices are used through their protocols only. While a run is held, the light is off and the stage does not move.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from functools import partial
from typing import Any, Final, Literal

from bench.base.clock import Aborted
from bench.base.errors import PreflightFailed
from bench.base.progress import Reply, ask
from bench.measure.expected_grid import grid_from_earlier_poses
from bench.measure.measure import Measurement
from bench.measure.verdict import judged
from bench.plan.job import Job, ScriptStep
from bench.record import events
from bench.record.as_data import as_data
from bench.record.journal import capture_name
from bench.record.recovery import recover, written_files
from bench.record.storage import storage_errors
from bench.run.interlocks import Trip, interlock_text
from bench.run.last_view import leave_view
from bench.run.machine import MAX_HOLD_S, State
from bench.run.run_context import RunContext
from bench.stations.devices import Devices, simulated_truth
from calib.progress import shown_by
from drivers.camera import CameraIdentity
from drivers.camera.usb_permission import LEAST_MBIT_S
from drivers.errors import LightFault, NotHomed
from drivers.light import Light, StatesSyncPolarity
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

OPTIONAL: Final[tuple[Literal["firmware_built", "link_mbit_s"], ...]] = ("firmware_built", "link_mbit_s")
"""Parts of a camera's identity that are left out where the camera does not state them."""
NOT_STATED: Final = "not stated by the device"
HOLD_POLL_S = 0.1  # A person does not notice it
_ASLEEP_S = 0.5  # No computer wakes sooner, and the two clocks are not read at once


def preflight(devices: Devices, job: Job) -> events.Devices:
    """Identify the open devices, set the camera, and collect every reason against a run in `PreflightFailed`.

    Nothing moves and the light stays off. Returns identities by ``camera``, ``stage`` (a list), ``light``;
    ``camera_settings`` as read back; ``connections`` of an event camera.
    """
    stage, light = devices.stage.identify(), devices.light.identify()
    camera = devices.camera.identify()
    devices.light.off()
    settings, camera_reasons = job.camera_kind.prepare(devices.camera)
    # An axis that is not homed warns about that; the stage's faults are then read after homing.
    reasons = stage_faults(devices) if devices.stage.is_homed() else []
    reasons += [f"light: {fault}" for fault in devices.light.faults()]
    reasons += camera_reasons
    require_no_faults(reasons, "Correct this and run again.")
    stated = as_data(camera, events.CameraDeviceData)
    for name in OPTIONAL:
        if not stated[name]:
            del stated[name]
    identities: events.Devices = {
        "camera": {**stated, "lens": job.station.camera.lens},
        "stage": [as_data(axis, events.DeviceData) for axis in stage],
        "light": as_data(light, events.DeviceData),
        "camera_settings": settings,
    }
    if job.camera_kind.name == "event":
        identities["connections"] = connections(camera, settings, devices.light)
    return identities


def connections(camera: CameraIdentity, settings: Mapping[str, Any], light: Light) -> dict[str, str]:
    """Return in words what camera and light answer about the cables between them and to the computer."""
    link = camera.link_mbit_s
    built = f", built {camera.firmware_built}" if camera.firmware_built else ""
    return {
        "camera_link": f"{link} Mbit/s ({'USB 3' if link >= LEAST_MBIT_S else 'USB 2'})"
        if link
        else NOT_STATED,
        "camera_firmware": f"{camera.firmware}{built}" if camera.firmware else NOT_STATED,
        "trigger_input": "on" if settings.get("trigger_in") else "off",
        "sync_polarity": light.sync_polarity() if isinstance(light, StatesSyncPolarity) else NOT_STATED,
        "sync_level": NOT_STATED,
    }


def stage_faults(devices: Devices) -> list[str]:
    """Read the faults and warnings of the stage, a text each."""
    return [f"stage: {fault}" for fault in devices.stage.faults()]


def require_no_faults(reasons: list[str], remedy: str = "Correct this first.") -> None:
    """Raise PreflightFailed with every reason against continuing, if there is one."""
    if reasons:
        raise PreflightFailed(f"The bench is not ready: {'; '.join(reasons)}.", remedy=remedy)


class StateWork:
    """The work of the states, each a method that receives the step of its entry."""

    def __init__(self, run: RunContext) -> None:
        self._run = run
        self._measured: dict[int, Measurement] = {}
        self._lit = False  # Whether the last light step has switched the light on
        self._begun: dict[str, Callable[[], Measurement]] = {}
        """What waits for the measurement of a recording that has begun, by the recording's file."""

    def on_enter(self) -> Mapping[State, Callable[..., None]]:
        """Return what is done in each state; it is done when the state is entered."""
        return {
            "recovering": self.recovering,
            "preflight": self.preflight,
            "homing": self.homing,
            "lighting": self.lighting,
            "slewing": self.slewing,
            "settling": self.waiting,
            "recording": self.recording,
            "checking": self.checking,
            "choosing": self.choosing,
            "backing_off": self.backing_off,
            "waiting": self.waiting,
            "holding": self.holding,
            "parking": self.parking,
            "solving": self.solving,
            "reporting": self.reporting,
            "aborting": self.aborting,
        }

    def recovering(self, *_: Any, **__: Any) -> None:
        """Put the run folder in order after a process died while working on it."""
        notes = recover(self._run.folder, self._run.log.journal)
        self._run.log.write(events.Recovered, **notes)
        for name in notes["missing"]:
            self._run.log.write(events.Deviation, what=f"{name} was missing when the run was resumed.")
        for name in notes["changed"]:
            self._run.log.write(
                events.Deviation,
                what=f"{name} was changed before the run was resumed; it was moved to quarantine.",
            )

    def preflight(self, *_: Any, **__: Any) -> None:
        """Open the devices if they are not open; check their identity and faults."""
        self._run.log.write(events.Devices, **preflight(self._run.devices.open(), self._run.job))

    def homing(self, *_: Any, **__: Any) -> None:
        """Home the stage, unless it is homed."""
        devices = self._run.devices.opened
        if not devices.stage.is_homed():
            devices.stage.home()
        require_no_faults(stage_faults(devices))

    def lighting(self, step: LightStep, **_: Any) -> None:
        """Set the light as the step says."""
        light = self._run.devices.opened.light
        self._lit = step.flicker is not None
        if step.flicker is None:
            light.off()
            return
        light.apply(self._run.job.light_settings(step.flicker))
        light.on()

    def slewing(self, step: MoveStep, **_: Any) -> None:
        """Move the stage to the step's pose."""
        self._run.devices.opened.stage.move_to(step.pose.angles_deg)

    def waiting(self, step: SettleStep | WaitStep, **_: Any) -> None:
        """Wait for the duration of the step."""
        self._run.clock.sleep(step.duration_s)

    def recording(self, step: RecordStep, *, attempt: int, **_: Any) -> None:
        """Record at the step's pose. On return, the recording is complete, in its place and journaled.

        Its measurement has begun, and goes on while the stage turns to the next pose.
        """
        pose, kind, devices = step.pose, self._run.job.camera_kind, self._run.devices.opened
        before = self._position_as_commanded(pose.angles_deg)
        light = devices.light.read()
        name = capture_name(pose.index, attempt, kind.ending)
        part, asleep_before_s = self._run.folder.part_path(name), self._run.clock.asleep_s()
        with storage_errors(part):
            facts = kind.record(devices.camera, part, step, self._run.job.frequency_hz(step))
        after = self._position_as_commanded(pose.angles_deg)
        self._require_light(devices.light)
        asleep_s = self._run.clock.asleep_s() - asleep_before_s
        capture = self._run.folder.commit(name, self._run.clock.monotonic)
        self._run.log.write(
            events.CaptureStored,
            capture=capture.name,
            size=capture.size,
            sha256=capture.sha256,
            pose=pose.index,
            pose_name=pose.name,
            attempt=attempt,
            commanded_deg=dict(pose.angles_deg),
            measured_deg=before,
            measured_after_deg=after,
            light=as_data(light, events.LightSettingsData),
            facts=as_data(facts, events.RecordedData),
            **({"asleep_s": round(asleep_s, 1)} if asleep_s > _ASLEEP_S else {}),
        )
        self._begun = {capture.name: self._begin_measuring(step, attempt)}

    def checking(self, step: RecordStep, *, attempt: int, **_: Any) -> None:
        """Wait until a stored recording is measured; accept it or journal why not."""
        pose, job = step.pose, self._run.job
        stored = self._stored(step, attempt)
        measurement = self._begun.pop(stored["capture"], None) or self._begin_measuring(step, attempt)
        measured = measurement()
        leave_view(self._run.folder.path, pose.index, attempt, measured, job.target)
        checked = judged(job.camera_kind, step, job.frequency_hz(step), stored, measured)
        if checked["accepted"]:
            self._measured[pose.index] = measured
        self._run.log.write(events.AttemptChecked, **checked)

    def _stored(self, step: RecordStep, attempt: int) -> events.CaptureStored:
        attempts = self._run.log.history.attempts_at(step.pose.index)
        return next(known.stored for known in attempts if known.attempt == attempt)

    def _begin_measuring(self, step: RecordStep, attempt: int) -> Callable[[], Measurement]:
        """Begin to measure a stored recording beside the run; return what waits for the measurement."""
        job, stored = self._run.job, self._stored(step, attempt)
        expected = grid_from_earlier_poses(self._run.log.history, stored, job.target)
        path = self._run.folder.path / stored["capture"]
        work = partial(job.camera_kind.measure, path, step, job.frequency_hz(step), job.target, expected)
        return self._run.clock.in_parallel(work)

    def choosing(self, step: ChooseStep, **_: Any) -> None:
        """Choose the next pose of an ``until``, or end it; a decision that the journal holds is kept."""
        history = self._run.log.history
        if any(decided["step"] == step.number for decided in history.decisions):
            return
        with self._stops_between_rounds():
            decided = self._run.decide(step, history, self._measured, self._run.clock.check)
        self._run.log.write(events.UntilDecided, **decided)

    def backing_off(self, _step: RecordStep, *, wait_s: float, **_: Any) -> None:
        """Wait after a rejected recording, so that its cause may pass."""
        self._run.clock.sleep(wait_s)

    def holding(self, step: ScriptStep | None, trip: Trip | None = None, *, by: str = "", **_: Any) -> None:
        """Hold for an operator, an interlock or an answer, before this step (None: before the first)."""
        question = step if isinstance(step, PromptStep) else None
        if by:
            self._until_released()
        elif trip is not None:
            self._until_clear(trip)
        else:
            assert question is not None
            self._until_answered(question)

    def parking(self, *_: Any, **__: Any) -> None:
        """Switch the light off and move the stage to zero, because no later step needs them."""
        devices = self._run.devices.opened
        devices.light.off()
        devices.stage.move_to(dict.fromkeys(devices.stage.axes, 0.0))

    def solving(self, step: SolveStep, **_: Any) -> None:
        """Calibrate from the accepted recordings."""
        with self._stops_between_rounds():
            solved = self._run.results.solve(
                step, self._run.log.history, self._measured, self._run.clock.check
            )
        self._run.log.write(events.Solved, **solved)

    def _stops_between_rounds(self) -> AbstractContextManager[None]:
        """Let a request to stop end a calibration after the present round of its search."""
        return shown_by(lambda _done, _expected: self._run.clock.check())

    def reporting(self, *_: Any, **__: Any) -> None:
        """Write results, images, exports and the report; then journal their hashes."""
        devices, job = self._run.devices, self._run.job
        truth = devices.truth() if devices.is_open else simulated_truth(job.station, job.seed)
        self._run.results.write(self._run.log, truth)
        outcome = self._run.results.outcome
        if outcome is not None and outcome.verdict is not None:  # a rehearsal writes results alone
            self._run.log.write(
                events.Written,
                head=outcome.journal_head,
                verdict=outcome.verdict,
                files=written_files(self._run.folder.path),
            )

    def aborting(self, *_: Any, **__: Any) -> None:
        """Stop the stage, switch the light off, stop the camera. Never raises."""
        self._run.devices.make_safe()

    # ------------------------------------------------------------------ recording

    def _require_light(self, light: Light) -> None:
        """Raise `LightFault` if a light that was switched on is dark: neither camera nor cable is to blame then."""
        if self._lit and not light.is_on():
            raise LightFault(
                "the light was switched on, and is dark after a recording, which is not used.",
                where="light",
                remedy="Find the cause (its supply, its overload protection, a person at it). Then resume the run.",
            )

    def _position_as_commanded(self, commanded_deg: Mapping[str, float]) -> dict[str, float]:
        """Read all angles; raise `NotHomed` if an axis does not stand where it was sent: its reference is lost.

        An axis stands on a whole step, which may be a step away from the commanded angle, besides its tolerance.
        """
        read_deg, axes = self._run.devices.position_deg(), self._run.job.station.axes
        wrong = [
            f"{name} reads {read_deg[name]:.4f} degrees, and {angle_deg:g} degrees were commanded"
            for name, angle_deg in commanded_deg.items()
            if abs(read_deg[name] - angle_deg) > axes[name].tolerance_deg + axes[name].step_deg
        ]
        if wrong:
            raise NotHomed(
                f"{'; '.join([*wrong, *stage_faults(self._run.devices.opened)])}."
                " The stage has lost its reference, and this recording is not used.",
                remedy="Find the cause (lost power, a restart, a person at the stage). Then resume the run.",
            )
        return read_deg

    # ------------------------------------------------------------------ holding

    def _until_released(self) -> None:
        """Wait until the owner releases the run, at most ``MAX_HOLD_S``."""
        self._run.devices.switch_off_light()
        history, begin_s = self._run.log.history, self._run.clock.monotonic()
        while history.holder:
            if self._run.clock.monotonic() - begin_s > MAX_HOLD_S:
                raise Aborted(f"held by {history.holder} for more than {MAX_HOLD_S / 3600:g} h")
            self._run.clock.sleep(HOLD_POLL_S)

    def _until_clear(self, trip: Trip) -> None:
        with self._run.clock.shielded():
            self._run.devices.come_to_rest()
        held_s = self._run.interlocks.wait_until_clear(trip)
        name = interlock_text(trip.interlock.name)
        self._run.log.write(events.InterlockReleased, rule=trip.interlock.name, held_s=round(held_s, 3))
        what = f"The {name} interlock held for {held_s:.0f} s: {trip.why}."
        self._run.log.write(events.Deviation, what=what)
        self._run.say(f"{what} The run continues.")

    def _until_answered(self, step: PromptStep) -> None:
        self._run.log.write(
            events.Asked, step=step.number, text=step.text, default=step.default, timeout_s=step.timeout_s
        )
        answer = ask(
            step.text,
            default=step.default,
            timeout_s=step.timeout_s,
            clock=self._run.clock,
            say=self._run.say,
            folder=self._run.folder.path,
            elsewhere=self._answer_from_elsewhere,
        )
        # An answer from elsewhere that was accepted at the last moment counts: its sender was told so.
        with self._run.log.held():
            answer = self._answer_from_elsewhere() or answer
            self._run.log.write(events.Answered, step=step.number, answer=answer.word, by=answer.by)
        if answer.word == "abort":
            raise Aborted(f"{step.text} was answered with abort ({answer.by})")

    def _answer_from_elsewhere(self) -> Reply | None:
        """Return the answer given by `starbench tell`, if there is one."""
        given = self._run.log.history.answer
        return Reply(*given) if given is not None else None
