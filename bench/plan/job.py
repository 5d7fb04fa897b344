"""The task of a run: a sequence on a station, expanded into steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TypeVar

from bench.base.bounded_json import canonical_json
from bench.base.errors import ScriptError
from bench.measure.camera_kinds import CameraKind, camera_kind
from bench.plan.plan import DEFAULT_MODEL, Plan, load_documents, make_plan
from bench.record.run_folder import CHECKED_COPY, PASSPORT_COPY, PLAN, SEQUENCE_COPY, STATION_COPY
from bench.stations.station import Station
from bench.stations.station_text import description_documents
from calib.calibration import REFERENCE_MODELS, CalibrationOptions
from calib.model.gimbal_readings import GimbalReadings
from calib.model.passport import Passport
from calib.target import StarTarget
from drivers.light import LightSettings
from sequences.schema import ResultLimitConfig
from sequences.script import ChooseStep, Flicker, LightStep, MoveStep, RecordStep, SettleStep, SolveStep, Step

PoseStep = TypeVar("PoseStep", bound=MoveStep | RecordStep)


@dataclass(frozen=True)
class ParkStep:
    """Light off and stage to zero, after the last step that needs devices. No script contains this step."""

    number: int = 0  # Number of the step; 0, because it is not in the script
    where: str = "after the last recording"


ScriptStep = Step | ParkStep
DEVICE_STEPS = (LightStep, MoveStep, SettleStep, RecordStep, ChooseStep, ParkStep)


def with_parking(steps: Sequence[Step]) -> tuple[ScriptStep, ...]:
    """Insert a park step after the last step that needs devices, if there is one."""
    last = max((i for i, step in enumerate(steps) if isinstance(step, DEVICE_STEPS)), default=-1)
    if last < 0:
        return tuple(steps)
    return (*steps[: last + 1], ParkStep(), *steps[last + 1 :])


def calibration_options(
    step: SolveStep,
    passport: Passport | None = None,
    gimbal: GimbalReadings | None = None,
) -> CalibrationOptions:
    """Return the engine's options for a solve step; one without a model is solved with ``auto``."""
    passport = passport if step.model not in REFERENCE_MODELS else None
    return CalibrationOptions(
        step.model or DEFAULT_MODEL,
        step.distortion,
        step.loss,
        step.huber_px,
        passport=passport,
        guard_band=step.guard_band,
        gimbal=gimbal,
    )


@dataclass(frozen=True)
class Job:
    """Task of one run."""

    plan: Plan
    steps: tuple[ScriptStep, ...]
    seed: int  # Random seed of a simulated bench; recorded for a real bench too
    operator: str | None  # Name of the operator, if known

    @classmethod
    def from_files(
        cls,
        sequence: str,
        station: str,
        *,
        seed: int,
        operator: str | None,
        settings: Mapping[str, str] | None = None,
    ) -> Job:
        """Read, check and expand a sequence on a station; ``settings`` replace values of the files."""
        planned = make_plan(*load_documents(sequence, station, settings))
        return cls.from_plan(planned, seed=seed, operator=operator)

    @classmethod
    def from_run_folder(cls, folder: Path, *, seed: int = 0, operator: str | None = None) -> Job:
        """Read the task of a run that has begun from the copies in its folder."""
        documents = load_documents(str(folder / SEQUENCE_COPY), str(folder / STATION_COPY))
        planned = make_plan(*documents, passport_copy=folder / PASSPORT_COPY)
        return cls.from_plan(planned, seed=seed, operator=operator)

    @classmethod
    def from_plan(cls, plan: Plan, *, seed: int, operator: str | None) -> Job:
        """Return the task of a plan, which must have no faults."""
        if plan.faults:
            raise ScriptError([str(fault) for fault in plan.faults])
        return cls(plan, with_parking(plan.script), seed, operator or plan.station.value.operator)

    @property
    def station(self) -> Station:
        """Content of the station file."""
        return self.plan.station.value

    @property
    def target(self) -> StarTarget:
        """The printed target."""
        return self.station.target.pattern()

    @property
    def camera_kind(self) -> CameraKind:
        """What the run does with the station's kind of camera."""
        return camera_kind(self.station)

    @property
    def limits(self) -> dict[str, tuple[ResultLimitConfig, ...]]:
        """Limits of the results by the document that states them, ``station`` or ``sequence``."""
        return {"station": self.station.limits, "sequence": self.plan.sequence.value.limits}

    @property
    def simulated(self) -> bool:
        """Whether any device is simulated."""
        return self.station.is_simulated

    @property
    def camera_name(self) -> str:
        """Name of the camera in exports."""
        camera = self.station.camera
        return f"{camera.driver}_{camera.serial}" if camera.serial else camera.driver

    def light_settings(self, flicker: Flicker) -> LightSettings:
        """Return the station's light settings for a flicker of the sequence, as the camera needs them."""
        return self.station.light.settings(self.camera_kind.light_for(flicker))

    def light_before(self, step: ScriptStep | None) -> LightStep | None:
        """Return the light step in effect when a step (None: the end) begins; None before the first one."""
        return self._light_before[None if step is None else step.number]

    @cached_property
    def _light_before(self) -> dict[int | None, LightStep | None]:
        """The light step before each step, by the step's number; after the last step, by None."""
        light: LightStep | None = None
        light_steps: dict[int | None, LightStep | None] = {}
        for step in self.steps:
            light_steps[step.number] = light
            light = step if isinstance(step, LightStep) else light
        return {**light_steps, None: light}

    def frequency_hz(self, step: RecordStep) -> float:
        """Return the flicker frequency of a recording, Hz; a plan without faults always has one."""
        light = self.light_before(step)
        assert light is not None
        assert light.flicker is not None
        return light.flicker.frequency_hz

    @cached_property
    def record_steps(self) -> dict[int, RecordStep]:
        """The step that records at a pose, by the number of the pose from 1."""
        return {s.pose.index: s for s in self.steps if isinstance(s, RecordStep)}

    def at_its_pose(self, step: PoseStep, chosen: Mapping[int, Mapping[str, float]]) -> PoseStep:
        """Return a step with the angles that the stage takes: 0 for axes not named, if the run chooses poses."""
        if step.pose.chosen_in_run:
            angles = chosen[step.pose.index]
        elif self._chooses_poses:
            angles = {**dict.fromkeys(self.station.axes, 0.0), **step.pose.angles_deg}
        else:
            return step
        return replace(step, pose=replace(step.pose, angles_deg=angles))

    @cached_property
    def _chooses_poses(self) -> bool:
        return any(isinstance(step, ChooseStep) for step in self.steps)


def documents_of(plan: Plan) -> dict[str, bytes]:
    """Return what a run folder keeps from its begin on, bytes by name: all to repeat the run from, and its plan."""
    documents = {SEQUENCE_COPY: plan.sequence.text, STATION_COPY: plan.station.text}
    if plan.passport.in_use is not None:
        documents[PASSPORT_COPY] = plan.passport.in_use.data
    if plan.checked.in_use is not None:
        documents[CHECKED_COPY] = plan.checked.in_use.file.data
    return documents | description_documents(plan.station.value) | {PLAN: canonical_json(plan.to_dict())}
