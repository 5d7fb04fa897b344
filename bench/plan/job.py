"""What is to be run: a sequence on a station, unfolded into steps, with all that both files say about it.

Knows both files and nothing of what has happened so far (`history`) or is open (`devices`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from bench.base.errors import ScriptError
from bench.plan.plan import Plan, load_documents, make_plan
from bench.simulated import SimulatedBench
from bench.stations.station import Station
from bench.views.camera_kinds import CameraKind, camera_kind
from bench.views.gates import Gate, at_most
from calib.calibration import CalibrationOptions
from calib.target import StarTarget
from drivers.light import LightSettings
from sequences.script import Flicker, LightStep, MoveStep, RecordStep, SettleStep, SolveStep, Step

MAX_MOTION_DEG = 0.0005
"""More motion than this between the begin and the end of a recording is motion: 0.03 px at f = 3345 px."""


@dataclass(frozen=True)
class ParkStep:
    """Light off, stage to zero; follows the last step that needs devices, though no script says it."""

    number: int = 0
    where: str = "after the last recording"


ScriptStep = Step | ParkStep
DEVICE_STEPS = (LightStep, MoveStep, SettleStep, RecordStep, ParkStep)


def with_parking(steps: Sequence[Step]) -> tuple[ScriptStep, ...]:
    """Insert the parking after the last step that needs devices."""
    last = max((i for i, step in enumerate(steps) if isinstance(step, DEVICE_STEPS)), default=-1)
    if last < 0:
        return tuple(steps)
    return (*steps[: last + 1], ParkStep(), *steps[last + 1 :])


@dataclass(frozen=True)
class Job:
    """One run's task.

    Attributes
    ----------
    plan
        The checked sequence and station, and what they amount to.
    steps
        The script, parking included.
    seed
        Seed of a simulated bench; also recorded for a real one.
    operator
        Who runs it, where told.
    """

    plan: Plan
    steps: tuple[ScriptStep, ...]
    seed: int
    operator: str | None

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
        """Read, check and unfold a sequence on a station, as `bench.plan.plan.load_documents` takes them.

        Raises
        ------
        ScriptError
            With everything that is wrong with either.
        """
        planned = make_plan(*load_documents(sequence, station, settings))
        if planned.faults:
            raise ScriptError([str(fault) for fault in planned.faults])
        return cls.from_plan(planned, seed=seed, operator=operator)

    @classmethod
    def from_plan(cls, plan: Plan, *, seed: int, operator: str | None) -> Job:
        """Make the task of a plan without faults."""
        return cls(plan, with_parking(plan.script), seed, operator or plan.station.value.operator)

    @property
    def station(self) -> Station:
        """What the station file says."""
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
    def lens(self) -> str | None:
        """The camera's lens, as the station file says."""
        return self.station.camera.lens

    @property
    def laboratory(self) -> str | None:
        """The laboratory, as the station file says."""
        return self.station.laboratory

    @property
    def simulated(self) -> bool:
        """Whether any device is a simulated one."""
        return self.station.is_simulated

    @property
    def camera_name(self) -> str:
        """Name of the camera in exports."""
        camera = self.station.camera
        return f"{camera.driver}_{camera.serial}" if camera.serial else camera.driver

    def light_settings(self, flicker: Flicker) -> LightSettings:
        """Turn a sequence's flicker into the station's light settings, as its camera needs them."""
        return self.station.light.settings(self.camera_kind.light_for(flicker))

    def light_before(self, step: ScriptStep | None) -> LightStep | None:
        """Find the light step that holds when a step begins; None before the first."""
        return self._lights.get(0 if step is None else id(step), self._lights[0])

    @cached_property
    def _lights(self) -> dict[int, LightStep | None]:
        """The light step before each step, by the step's identity; after the last one, by 0."""
        light: LightStep | None = None
        found: dict[int, LightStep | None] = {}
        for step in self.steps:
            found[id(step)] = light
            light = step if isinstance(step, LightStep) else light
        return {**found, 0: light}

    def frequency_hz(self, step: RecordStep) -> float:
        """Flicker frequency that holds when a recording is made; the plan has seen to it that there is one."""
        light = self.light_before(step)
        assert light is not None
        assert light.flicker is not None
        return light.flicker.frequency_hz

    def record_step(self, pose_index: int) -> RecordStep:
        """Find the step that records at a pose."""
        return self._record_steps[pose_index]

    @cached_property
    def _record_steps(self) -> dict[int, RecordStep]:
        return {s.pose.index: s for s in self.steps if isinstance(s, RecordStep)}

    def place(self, step: ScriptStep) -> int:
        """Where a step stands in the script, from 0."""
        return self._where[id(step)]

    @cached_property
    def _where(self) -> dict[int, int]:
        return {id(step): place for place, step in enumerate(self.steps)}

    def motion_gates(self, before_deg: Mapping[str, float], after_deg: Mapping[str, float]) -> list[Gate]:
        """Judge whether the stage stood still while a recording was made."""
        return [
            at_most(f"{axis} moved", abs(after_deg[axis] - before_deg[axis]), MAX_MOTION_DEG, "deg")
            for axis in before_deg
        ]

    def done_after_s(self, step: ScriptStep) -> float | None:
        """Expected time from the begin of the run to the end of a step, s; None where the plan has none."""
        return self._done_after_s.get(id(step))

    @cached_property
    def _done_after_s(self) -> dict[int, float]:
        return {id(p.step): p.done_after_s for p in self.plan.steps}

    def read_truth(self) -> dict[str, Any] | None:
        """What the simulated world is made of, for the final comparison; None on a real bench."""
        if not self.station.needs_simulated_bench:
            return None
        with SimulatedBench(self.station.simulation or {}, self.seed) as bench:
            return bench.truth()


def calibration_options(step: SolveStep) -> CalibrationOptions:
    """Give the engine's options as a solve step asks for them."""
    return CalibrationOptions(step.model, step.distortion, step.loss, step.huber_px)
