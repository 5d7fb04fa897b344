"""The plan of a run: its poses, moves, duration and disk space, and all faults of its files.

A plan compares a sequence with a station. It uses no device and writes nothing. Durations and sizes come from
`bench.plan.estimate`; the journal of a run has the real ones.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any

from bench.base.errors import ScriptError
from bench.plan.estimate import Estimate
from bench.plan.passports import PassportChoice, choose_passport
from bench.plan.script_check import angle_faults, check_script
from bench.plan.url_secrets import find_url_secrets
from bench.stations.placeholders import find_placeholders
from bench.stations.station import Station, load_station
from calib.model.passport import Passport
from sequences.errors import DocumentFaults
from sequences.flatten import unfold
from sequences.reader import Located, find_document, read_document
from sequences.schema import Sequence
from sequences.script import (
    ChooseStep,
    LightStep,
    MoveStep,
    Pose,
    RecordStep,
    SettleStep,
    SolveStep,
    Step,
    Until,
)
from sequences.settings import OptionSettings
from sequences.solve_schema import CalibrationModel
from sequences.tree import Fault

SHIPPED_SEQUENCES = Path(__file__).parents[2] / "sequences"
SEQUENCE_DEVICE_STEPS = (LightStep, MoveStep, SettleStep, RecordStep, ChooseStep)
DEFAULT_MODEL: CalibrationModel = "auto"
"""Model of a solve step that names none: no other model is honest on every collimator."""


@dataclass(frozen=True)
class PlannedStep:
    """A step with its expected duration."""

    step: Step
    # duration_s, done_after_s: Expected duration of the step, and expected time from the start of the run to
    # the end of the step, s.
    duration_s: float
    done_after_s: float


@dataclass(frozen=True)
class Plan:
    """The plan of a run."""

    sequence: Located[Sequence]
    station: Located[Station]
    steps: tuple[PlannedStep, ...]
    faults: tuple[Fault, ...]  # Why the plan cannot be run; empty if it can
    remarks: tuple[Fault, ...]  # What the operator should know before the run
    # Expected duration of the whole run with homing and parking, s; with an ``until``, the longest one.
    duration_s: float
    # size_bytes, most_bytes: Expected disk space, with all poses that an ``until`` allows; and the largest
    # one, with all attempts at the highest event rate that the gates accept.
    size_bytes: int
    most_bytes: int
    # The collimator's passport, and the solve steps that use it.
    passport: PassportChoice = field(default_factory=PassportChoice)

    def passport_for(self, step: SolveStep) -> Passport | None:
        """Return the collimator's passport that a solve step uses.

        Returns: None if the step uses none.
        """
        in_use = self.passport.in_use
        return in_use.passport if in_use is not None and step.number in self.passport.steps else None

    def model_for(self, step: SolveStep) -> CalibrationModel:
        """Return the model of a solve step: its own, or `DEFAULT_MODEL`."""
        return step.model or DEFAULT_MODEL

    @property
    def script(self) -> tuple[Step, ...]:
        """The steps without their durations."""
        return tuple(planned.step for planned in self.steps)

    @property
    def poses(self) -> tuple[Pose, ...]:
        """The poses to record whose angles the sequence gives, in the order of recording."""
        recorded = (step.pose for step in self.script if isinstance(step, RecordStep))
        return tuple(pose for pose in recorded if not pose.chosen_in_run)

    @property
    def untils(self) -> tuple[Until, ...]:
        """The steps that choose poses while they measure."""
        return tuple({s.until.first: s.until for s in self.script if isinstance(s, ChooseStep)}.values())

    @property
    def most_poses(self) -> int:
        """Largest number of accepted recordings."""
        return len(self.poses) + sum(until.at_most - until.starts for until in self.untils)

    def to_dict(self) -> dict[str, Any]:
        """Return the plan as JSON carries it.

        Returns: With the schema ``starbench/plan/1``.
        """
        return {
            "schema": "starbench/plan/1",
            "sequence": self.sequence.value.name,
            "station": self.station.value.name,
            "simulated": self.station.value.is_simulated,
            "runnable": not self.faults,
            "faults": [_fault_dict(fault) for fault in self.faults],
            "remarks": [_fault_dict(remark) for remark in self.remarks],
            "passport": self.passport.in_use.to_dict() if self.passport.in_use else None,
            "duration_s": round(self.duration_s, 3),
            "size_bytes": self.size_bytes,
            "most_bytes": self.most_bytes,
            "poses": [
                {"index": pose.index, "name": pose.name, "angles_deg": dict(pose.angles_deg)}
                for pose in self.poses
            ],
            "most_poses": self.most_poses,
            "untils": [
                {
                    "first": until.first,
                    "last": until.last,
                    "goals": dict(until.goals),
                    "at_most": until.at_most,
                    "minutes": until.minutes,
                    "starts": until.starts,
                    "poses": [until.poses.start, until.poses.stop - 1],
                }
                for until in self.untils
            ],
            "steps": [self._step_dict(planned) for planned in self.steps],
        }

    def _step_dict(self, planned: PlannedStep) -> dict[str, Any]:
        step = planned.step
        described: dict[str, Any] = {
            "number": step.number,
            "what": type(step).__name__.removesuffix("Step").lower(),
            "line": self.sequence.position(step.path).line,
            "duration_s": round(planned.duration_s, 3),
            "done_after_s": round(planned.done_after_s, 3),
        }
        if isinstance(step, MoveStep | RecordStep):
            described["pose"] = step.pose.index
        return described


def load_documents(
    sequence: str, station: str, settings: Mapping[str, str] | None = None
) -> tuple[Located[Sequence], Located[Station]]:
    """Read a sequence file and a station file.

    settings: Values that replace those of the files: YAML texts by path, such as
      ``sequence.defaults.record.window_ms`` or ``station.camera.biases.bias_diff_on``.
    Raises ScriptError: When one of the files is not valid, with the faults of both.
    """
    of_sequence, of_station = _by_document(settings or {})
    faults: list[Fault] = []
    read_sequence = read_station = None
    try:
        read_station = load_station(station, of_station)
    except DocumentFaults as error:
        faults += error.faults
    try:
        read_sequence = read_document(find_document(sequence, SHIPPED_SEQUENCES), Sequence, of_sequence)
        faults += unfold(read_sequence)[1] if faults else []
    except DocumentFaults as error:
        against_station = angle_faults(error.tree, read_station.value) if error.tree and read_station else []
        faults = [*error.faults, *against_station, *faults]
    if read_sequence is None or read_station is None:
        raise ScriptError([str(fault) for fault in faults])
    return read_sequence, read_station


def _by_document(settings: Mapping[str, str]) -> tuple[Mapping[str, str], Mapping[str, str]]:
    """Separate the settings of the sequence from those of the station."""
    found: dict[str, dict[str, str]] = {"sequence": {}, "station": {}}
    for path, text in settings.items():
        document, _, rest = path.partition(".")
        if document not in found or not rest:
            given_by = settings.option if isinstance(settings, OptionSettings) else "setting"
            raise ScriptError(
                [f"{given_by} {path}={text}: the path must begin with 'sequence.' or 'station.'."]
            )
        found[document][rest] = text
    of_sequence, of_station = found["sequence"], found["station"]
    if isinstance(settings, OptionSettings):
        return settings.part(of_sequence), settings.part(of_station)
    return of_sequence, of_station


def make_plan(
    sequence: Located[Sequence],
    station: Located[Station],
    *,
    passport_copy: Path | None = None,
    today: date | None = None,
) -> Plan:
    """Plan a run. Faults of the files do not raise an error; the plan lists them.

    sequence, station: The files, from `load_documents`.
    passport_copy: Where the folder of a run that has begun keeps the passport; None for a new run.
    today: Day of the run, for the validity of the passport; None for the current day, UTC.
    """
    script, faults = unfold(sequence)
    if station.value.board is not None:
        script = tuple(_planar(step) for step in script)
    today = today or datetime.now(UTC).date()
    solving = [step.solve if isinstance(step, ChooseStep) else step for step in script]
    passport = choose_passport(sequence, station, tuple(solving), copy=passport_copy, today=today)
    findings = check_script(sequence, script, station.value, passport.steps_for_one_pose)
    missing = find_placeholders(station.tree)
    is_new = passport_copy is None  # a run that has begun holds its files already
    secrets = [*find_url_secrets(sequence), *find_url_secrets(station)] if is_new else []
    estimate = Estimate(station.value)
    last = next((step for step in reversed(script) if isinstance(step, SEQUENCE_DEVICE_STEPS)), None)
    elapsed_s = estimate.preparation_s() if last is not None else 0.0
    steps: list[PlannedStep] = []
    for step in script:
        duration_s = estimate.add(step)
        elapsed_s += duration_s
        steps.append(PlannedStep(step, duration_s, elapsed_s))
        if step is last:
            elapsed_s += estimate.parking_s()
    return Plan(
        sequence=sequence,
        station=station,
        steps=tuple(steps),
        faults=tuple(sorted({*faults, *findings.faults, *passport.faults, *missing, *secrets})),
        remarks=tuple(sorted({*findings.remarks, *passport.remarks})),
        duration_s=elapsed_s,
        size_bytes=estimate.size_bytes,
        most_bytes=estimate.most_bytes,
        passport=passport,
    )


def _planar(step: Step) -> Step:
    """Return a step of a run with a board: a solve step that names no model uses the planar one."""
    if isinstance(step, SolveStep) and step.model is None:
        return dataclasses.replace(step, model="planar")
    return step


def _fault_dict(fault: Fault) -> dict[str, Any]:
    """Return a fault without the folder of its file, which belongs to this computer only."""
    return dataclasses.asdict(fault) | {"file": Path(fault.file).name}
