"""The plan of a run: its poses, moves, duration and disk space, and all faults of its files.

A plan compares a sequence with a station. It uses no device and writes nothing; the journal has the real durations.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any

from bench.base.errors import ScriptError
from bench.measure.camera_kinds import recording_duration_s
from bench.plan.passports import PassportChoice, choose_passport
from bench.plan.script_check import angle_faults, check_script, find_simulation_faults
from bench.plan.stated_camera import StatedCameraChoice, choose_stated_camera
from bench.plan.url_secrets import find_url_secrets
from bench.record.run_folder import CHECKED_COPY
from bench.stations.messages_section import find_webhooks
from bench.stations.placeholders import find_placeholders
from bench.stations.sections import FrameCameraSection
from bench.stations.station import Station, load_station
from calib.model.passport import Passport
from drivers.stage.motion import longest_move_s, whole_range_s
from sequences.errors import DocumentFaults
from sequences.flatten import unfold
from sequences.reader import Located, OptionSettings, find_document, read_document
from sequences.schema import Sequence
from sequences.script import (
    ChooseStep,
    LightStep,
    MoveStep,
    Pose,
    PromptStep,
    RecordStep,
    ReportStep,
    SettleStep,
    SolveStep,
    Step,
    Until,
    WaitStep,
)
from sequences.solve_schema import CalibrationModel
from sequences.tree import Fault

# Allowances, measured on the simulated bench. The devices of a real bench need more.
PREFLIGHT_S = 1.1
HOMING_EXTRA_S = 0.5
LIGHT_ON_S = 0.7
LIGHT_OFF_S = 0.05
MOVE_EXTRA_S = 0.1
RECORD_EXTRA_S = 1.0
CHECK_S = 0.5
SOLVE_S = 0.3
CHOOSE_S = 2.0
"""Calibration from the poses so far, and the choice of the next one."""
REPORT_S = 0.5
RECORDING_BYTES_PER_S = 35e6
"""Recording of a lit target with square flicker. The link of a camera carries about five times as much."""
MOST_BYTES_PER_EVENT = 4  # EVT3: a word for the row and one for the column
PICTURE_S = 0.04  # 25 pictures a second, as most frame cameras
PICTURE_SIZE = (1280, 720)
"""Size of a frame camera's picture if the station has no ``expected`` section, px."""
POSE_BYTES = 200_000
"""Images, stars and logs of one pose."""
REPORT_BYTES = 1_000_000  # The report stays below two of these; the results of a usual run are smaller
SHIPPED_SEQUENCES = Path(__file__).parents[2] / "sequences"
SEQUENCE_DEVICE_STEPS = (LightStep, MoveStep, SettleStep, RecordStep, ChooseStep)
DEFAULT_MODEL: CalibrationModel = "auto"
"""Model of a solve step that names none: no other model is honest on every collimator."""


class Estimate:
    """Estimates duration and disk space step by step; keeps the position of the stage and the state of the light.

    An ``until`` counts with all recordings that fit into its minutes, as far apart as the limits allow; rounds for
    failed poses with none.
    """

    def __init__(self, station: Station) -> None:
        self.size_bytes = self.most_bytes = REPORT_BYTES
        self._limits = {name: axis.limits for name, axis in station.axes.items()}
        camera = station.camera
        self._pictures = camera.pictures if isinstance(camera, FrameCameraSection) else 0
        self._picture_bytes = math.prod(station.expected.image_size if station.expected else PICTURE_SIZE)
        self._at_deg: dict[str, float] = dict.fromkeys(self._limits, 0.0)
        self._frequency_hz: float | None = None
        self._elapsed_s = 0.0
        self._until_begin_s: dict[int, float] = {}  # by number of the first step of an until
        self._spare = False  # whether the present round is one that only failed poses make necessary

    def preparation_s(self) -> float:
        """Return the time before the first step, s: open and identify the devices, home over the whole range."""
        return PREFLIGHT_S + whole_range_s(self._limits) + HOMING_EXTRA_S

    def parking_s(self) -> float:
        """Return the time after the last step that needs devices, s: light off, stage to 0 deg."""
        return LIGHT_OFF_S + self._travel_s(dict.fromkeys(self._limits, 0.0)) + MOVE_EXTRA_S

    def add(self, step: Step, following: tuple[Step, ...] = ()) -> float:
        """Add the next step, and return its duration, s; ``following`` are the steps after it, at least two."""
        if isinstance(step, ChooseStep):
            self._spare = self._is_spare(step)
        sizes = self.size_bytes
        duration_s = self._duration_s(step)
        if isinstance(step, RecordStep):
            duration_s += self._check_s(following)
        if self._spare and isinstance(step, ChooseStep | MoveStep | SettleStep | RecordStep):
            self.size_bytes, duration_s = sizes, 0.0
        self._elapsed_s += duration_s
        return duration_s

    def _is_spare(self, step: ChooseStep) -> bool:
        """Return whether a round of an ``until`` is beyond its recordings or its minutes; its last step never is."""
        until = step.until
        if step.pose is None:
            return False
        number = step.pose.index - until.poses.start
        begin_s = self._until_begin_s.setdefault(until.first, self._elapsed_s)
        late = until.minutes is not None and self._elapsed_s - begin_s > 60.0 * until.minutes
        return number >= until.at_most or late

    def _duration_s(self, step: Step) -> float:
        match step:
            case ChooseStep():
                duration_s = CHOOSE_S
            case MoveStep() if step.pose.chosen_in_run:
                duration_s = self._move_anywhere()
            case LightStep():
                self._frequency_hz = step.flicker.frequency_hz if step.flicker else None
                duration_s = LIGHT_ON_S if step.flicker else LIGHT_OFF_S
            case MoveStep():
                duration_s = self._move(step.pose.angles_deg)
            case RecordStep():
                duration_s = self._record(step) + RECORD_EXTRA_S
            case SettleStep() | WaitStep():
                duration_s = step.duration_s
            case PromptStep():
                duration_s = step.timeout_s
            case SolveStep():
                duration_s = SOLVE_S
            case ReportStep():
                duration_s = REPORT_S
        return duration_s

    def _record(self, step: RecordStep) -> float:
        if self._pictures:
            pixel_bytes = self._pictures * self._picture_bytes
            self.size_bytes += pixel_bytes + POSE_BYTES
            self.most_bytes += 2 * pixel_bytes * step.attempts + POSE_BYTES  # 16 bit
            return self._pictures * PICTURE_S
        if self._frequency_hz is None:  # in the dark, which `check_script` forbids
            recorded_s = step.window_ms * 1e-3
        else:
            recorded_s = recording_duration_s(step.window_ms, self._frequency_hz)
        most_events = step.gates.max_event_rate_mev_s * 1e6 * recorded_s
        self.size_bytes += int(recorded_s * RECORDING_BYTES_PER_S) + POSE_BYTES
        self.most_bytes += int(most_events * MOST_BYTES_PER_EVENT * step.attempts) + POSE_BYTES
        return recorded_s

    def _check_s(self, following: tuple[Step, ...]) -> float:
        """Return how long the run waits for a check, s: it goes on while the stage turns and the camera settles."""
        left_s = CHECK_S
        for step in following:
            if isinstance(step, MoveStep):
                left_s -= self._travel_s(step.pose.angles_deg) + MOVE_EXTRA_S
            elif isinstance(step, SettleStep):
                left_s -= step.duration_s
            else:
                break
        return max(0.0, left_s)

    def _move_anywhere(self) -> float:
        """Return the time of a move over the whole range; the farthest end is the place to park from."""
        for name, limits in self._limits.items():
            self._at_deg[name] = max(limits.lowest_deg, limits.highest_deg, key=abs)
        return whole_range_s(self._limits) + MOVE_EXTRA_S

    def _move(self, target_deg: Mapping[str, float]) -> float:
        travel_s = self._travel_s(target_deg)
        self._at_deg |= target_deg
        return travel_s + MOVE_EXTRA_S

    def _travel_s(self, to_deg: Mapping[str, float]) -> float:
        """Return the time of a move, s. An axis that the station does not have is a fault of the script."""
        known = {name: angle for name, angle in to_deg.items() if name in self._limits}
        return longest_move_s(self._limits, self._at_deg, known)


@dataclass(frozen=True)
class PlannedStep:
    """A step with its expected duration."""

    step: Step
    duration_s: float  # Expected duration of the step, s
    done_after_s: float  # Expected time from the start of the run to the end of the step, s


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
    size_bytes: int  # Expected disk space, with all poses that an ``until`` allows
    most_bytes: int  # Disk space with all attempts at the highest event rate that the gates accept
    # The collimator's passport, and the solve steps that use it.
    passport: PassportChoice = field(default_factory=PassportChoice)
    # The calibration that the steps `check` compare with the result.
    checked: StatedCameraChoice = field(default_factory=StatedCameraChoice)

    def passport_for(self, step: SolveStep) -> Passport | None:
        """Return the collimator's passport that a solve step uses; None if it uses none."""
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
        """Return the plan as JSON of schema ``starbench/plan/1`` carries it."""
        return {
            "schema": "starbench/plan/1",
            "sequence": self.sequence.value.name,
            "station": self.station.value.name,
            "simulated": self.station.value.is_simulated,
            "runnable": not self.faults,
            "faults": [_fault_dict(fault) for fault in self.faults],
            "remarks": [_fault_dict(remark) for remark in self.remarks],
            "passport": self.passport.in_use.to_dict() if self.passport.in_use else None,
            **({"checked": self.checked.in_use.to_dict()} if self.checked.in_use else {}),
            "duration_s": round(self.duration_s, 3),
            "size_bytes": self.size_bytes,
            "most_bytes": self.most_bytes,
            "poses": [
                {"index": pose.index, "name": pose.name, "angles_deg": dict(pose.angles_deg)}
                for pose in self.poses
            ],
            "most_poses": self.most_poses,
            "untils": [
                {**vars(until), "goals": dict(until.goals), "poses": [until.poses[0], until.poses[-1]]}
                for until in self.untils
            ],
            "steps": [self._step_dict(planned) for planned in self.steps],
        }

    def _step_dict(self, planned: PlannedStep) -> dict[str, Any]:
        step = planned.step
        described: dict[str, Any] = {
            "number": step.number,
            "what": step.word,
            "line": self.sequence.tree.spot(step.path).line,
            "duration_s": round(planned.duration_s, 3),
            "done_after_s": round(planned.done_after_s, 3),
        }
        if isinstance(step, MoveStep | RecordStep):
            described["pose"] = step.pose.index
        return described


def load_documents(
    sequence: str, station: str, settings: Mapping[str, str] | None = None
) -> tuple[Located[Sequence], Located[Station]]:
    """Read sequence and station; ``settings`` are YAML texts by path, ``sequence.defaults.record.window_ms``."""
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
    by_document: dict[str, dict[str, str]] = {"sequence": {}, "station": {}}
    for path, text in settings.items():
        document, _, rest = path.partition(".")
        if document not in by_document or not rest:
            given_by = settings.option if isinstance(settings, OptionSettings) else "setting"
            raise ScriptError(
                [f"{given_by} {path}={text}: the path must begin with 'sequence.' or 'station.'."]
            )
        by_document[document][rest] = text
    of_sequence, of_station = by_document["sequence"], by_document["station"]
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
    """Plan a run; faults of the files are listed, not raised. ``today`` None is the current day, UTC.

    ``passport_copy`` is where the folder of a run that has begun keeps the passport; None for a new run.
    """
    script, faults = unfold(sequence)
    today = today or datetime.now(UTC).date()
    solving = tuple(step.solve if isinstance(step, ChooseStep) else step for step in script)
    passport = choose_passport(sequence, station, solving, copy=passport_copy, today=today)
    checked_copy = passport_copy.with_name(CHECKED_COPY) if passport_copy is not None else None
    checked = choose_stated_camera(sequence, script, station.value.expected, copy=checked_copy)
    findings = check_script(sequence, script, station.value, passport.steps_for_one_pose, whole=not faults)
    faults += [*findings.faults, *passport.faults, *checked.faults, *find_placeholders(station.tree)]
    if passport_copy is None:  # a run that has begun holds its files already
        faults += [*find_url_secrets(sequence), *find_url_secrets(station), *find_simulation_faults(station)]
        faults += find_webhooks(station)
    estimate = Estimate(station.value)
    steps, duration_s = _timed(script, estimate)
    return Plan(
        sequence=sequence,
        station=station,
        steps=steps,
        faults=tuple(sorted(set(faults))),
        remarks=tuple(sorted({*findings.remarks, *passport.remarks})),
        duration_s=duration_s,
        size_bytes=estimate.size_bytes,
        most_bytes=estimate.most_bytes,
        passport=passport,
        checked=checked,
    )


def _timed(script: tuple[Step, ...], estimate: Estimate) -> tuple[tuple[PlannedStep, ...], float]:
    """Return the steps with their times, and the time of the whole run with homing and parking, s."""
    last = next((step for step in reversed(script) if isinstance(step, SEQUENCE_DEVICE_STEPS)), None)
    elapsed_s = estimate.preparation_s() if last is not None else 0.0
    steps: list[PlannedStep] = []
    for place, step in enumerate(script):
        duration_s = estimate.add(step, script[place + 1 : place + 3])
        elapsed_s += duration_s
        steps.append(PlannedStep(step, duration_s, elapsed_s))
        if step is last:
            elapsed_s += estimate.parking_s()
    return tuple(steps), elapsed_s


def _fault_dict(fault: Fault) -> dict[str, Any]:
    """Return a fault without the folder of its file, which belongs to this computer only."""
    return dataclasses.asdict(fault) | {"file": Path(fault.file).name}
