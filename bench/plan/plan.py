"""A run before it is run: its poses, moves, time and disk, and everything wrong with its files at once.

Compares a script with a station; touches no device and writes nothing. Estimates come from the station's
speeds and from the allowances below; what a step really took stands in the journal.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.base.errors import ScriptError
from bench.plan.script_check import angle_faults, check_script
from bench.stations.placeholders import find_placeholders
from bench.stations.station import Station, load_station
from bench.stations.station_cameras import FrameCameraConfig
from bench.stations.station_stages import AxisConfig
from bench.views.recording_window import recording_duration_s
from sequences.errors import DocumentFaults
from sequences.flatten import unfold
from sequences.reader import Located, find_document, read_document
from sequences.schema import Sequence
from sequences.script import (
    LightStep,
    MoveStep,
    Pose,
    PromptStep,
    RecordStep,
    ReportStep,
    SettleStep,
    SolveStep,
    Step,
    WaitStep,
)
from sequences.tree import Fault

SHIPPED_SEQUENCES = Path(__file__).parents[2] / "sequences"
SEQUENCE_DEVICE_STEPS = (LightStep, MoveStep, SettleStep, RecordStep)

# Allowances, as measured on the simulated bench; a real one adds to them what its devices take.
PREFLIGHT_S = 1.1
HOMING_EXTRA_S = 0.5
LIGHT_ON_S = 0.7
LIGHT_OFF_S = 0.05
MOVE_EXTRA_S = 0.1
RECORD_EXTRA_S = 1.0
CHECK_S = 0.5
SOLVE_S = 0.3
REPORT_S = 0.5
RECORDING_BYTES_PER_S = 35e6
"""A lit target under a square flicker; a camera's link carries some five times as much."""
MOST_BYTES_PER_EVENT = 4
PICTURE_S = 0.04
PICTURE_SIZE = (1280, 720)
"""Of a frame camera, where the station's ``expected`` section does not say."""
POSE_BYTES = 200_000
"""A pose's share of pictures, stars and logs."""
REPORT_BYTES = 1_000_000


def travel_s(distance_deg: float, speed_deg_s: float, acceleration_deg_s2: float) -> float:
    """Return the time of a move with a trapezoid of speed: up, along, down.

    Examples
    --------
    >>> travel_s(10, speed_deg_s=10, acceleration_deg_s2=100)
    1.1
    >>> travel_s(1, speed_deg_s=10, acceleration_deg_s2=100)
    0.2
    """
    distance = abs(distance_deg)
    ramps = speed_deg_s**2 / acceleration_deg_s2
    if distance < ramps:  # too short to reach full speed
        return 2 * math.sqrt(distance / acceleration_deg_s2)
    return distance / speed_deg_s + speed_deg_s / acceleration_deg_s2


@dataclass(frozen=True)
class PlannedStep:
    """A step with what it is expected to take.

    Attributes
    ----------
    step
        The step of the script.
    duration_s, done_after_s
        Its own time, and the time from the start of the run to its end.
    """

    step: Step
    duration_s: float
    done_after_s: float


@dataclass(frozen=True)
class Plan:
    """A run before it is run.

    Attributes
    ----------
    sequence, station
        The files, checked.
    steps
        The script with its times.
    faults
        Why it cannot be run; empty when it can.
    remarks
        What somebody should know before it is run.
    duration_s
        Expected time of the whole run, homing and parking included.
    size_bytes, most_bytes
        Disk expected; and at most, with every attempt used at the highest event rate the gates let pass.
    """

    sequence: Located[Sequence]
    station: Located[Station]
    steps: tuple[PlannedStep, ...]
    faults: tuple[Fault, ...]
    remarks: tuple[Fault, ...]
    duration_s: float
    size_bytes: int
    most_bytes: int

    @property
    def script(self) -> tuple[Step, ...]:
        """The steps without their times."""
        return tuple(planned.step for planned in self.steps)

    @property
    def poses(self) -> tuple[Pose, ...]:
        """The poses to record, in their order."""
        return tuple(step.pose for step in self.script if isinstance(step, RecordStep))

    def to_dict(self) -> dict[str, Any]:
        """Give the plan as JSON carries it."""
        return {
            "schema": "starbench/plan/1",
            "sequence": self.sequence.value.name,
            "station": self.station.value.name,
            "simulated": self.station.value.is_simulated,
            "runnable": not self.faults,
            "faults": [_fault_dict(fault) for fault in self.faults],
            "remarks": [_fault_dict(remark) for remark in self.remarks],
            "duration_s": round(self.duration_s, 3),
            "size_bytes": self.size_bytes,
            "most_bytes": self.most_bytes,
            "poses": [
                {"index": pose.index, "name": pose.name, "angles_deg": dict(pose.angles_deg)}
                for pose in self.poses
            ],
            "steps": [self._step_dict(planned) for planned in self.steps],
        }

    def _step_dict(self, planned: PlannedStep) -> dict[str, Any]:
        step = planned.step
        said: dict[str, Any] = {
            "number": step.number,
            "what": type(step).__name__.removesuffix("Step").lower(),
            "line": self.sequence.position(step.path).line,
            "duration_s": round(planned.duration_s, 3),
            "done_after_s": round(planned.done_after_s, 3),
        }
        if isinstance(step, MoveStep | RecordStep):
            said["pose"] = step.pose.index
        return said


def load_documents(
    sequence: str, station: str, settings: Mapping[str, str] | None = None
) -> tuple[Located[Sequence], Located[Station]]:
    """Read a sequence and a station, each a path or the name of a shipped one.

    Parameters
    ----------
    sequence, station
        The files.
    settings
        What is set otherwise than they say, as YAML texts by path: ``sequence.defaults.record.window_ms``,
        ``station.camera.biases.bias_diff_on``.

    Raises
    ------
    ScriptError
        With every fault of both files, where one of them cannot be used.
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


def _by_document(settings: Mapping[str, str]) -> tuple[dict[str, str], dict[str, str]]:
    """Tell the settings of the sequence from those of the station."""
    found: dict[str, dict[str, str]] = {"sequence": {}, "station": {}}
    for path, text in settings.items():
        document, _, rest = path.partition(".")
        if document not in found or not rest:
            raise ScriptError([f"setting {path}: it must begin with sequence. or station."])
        found[document][rest] = text
    return found["sequence"], found["station"]


def make_plan(sequence: Located[Sequence], station: Located[Station]) -> Plan:
    """Plan a run: never raises for what is wrong with it, that stands in the plan's faults."""
    script, faults = unfold(sequence)
    findings = check_script(sequence, script, station.value)
    estimate = _Estimate(station.value)
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
        faults=tuple(sorted({*faults, *findings.faults, *find_placeholders(station.tree)})),
        remarks=findings.remarks,
        duration_s=elapsed_s,
        size_bytes=estimate.size_bytes,
        most_bytes=estimate.most_bytes,
    )


class _Estimate:
    """Time and disk of one step after another, following where the stage stands and what the light does.

    Attributes
    ----------
    size_bytes, most_bytes
        Disk expected so far; and at most, every attempt used at the highest event rate the gates let pass.
    """

    def __init__(self, station: Station) -> None:
        self.size_bytes = self.most_bytes = REPORT_BYTES
        self._axes: Mapping[str, AxisConfig] = station.axes
        camera = station.camera
        self._pictures = camera.pictures if isinstance(camera, FrameCameraConfig) else 0
        self._picture_bytes = math.prod(station.expected.image_size if station.expected else PICTURE_SIZE)
        self._at_deg: dict[str, float] = dict.fromkeys(self._axes, 0.0)
        self._frequency_hz: float | None = None

    def preparation_s(self) -> float:
        """Time before the first step: devices opened and asked, references found over the whole range."""
        ranges = {name: axis.limits_deg[1] - axis.limits_deg[0] for name, axis in self._axes.items()}
        return PREFLIGHT_S + self._travel_s(ranges) + HOMING_EXTRA_S

    def parking_s(self) -> float:
        """Time after the last step that needs devices: light off, stage to zero."""
        return LIGHT_OFF_S + self._travel_s(self._at_deg) + MOVE_EXTRA_S

    def add(self, step: Step) -> float:
        """Return the time the next step takes, s, and count its bytes."""
        match step:
            case LightStep():
                self._frequency_hz = step.flicker.frequency_hz if step.flicker else None
                duration_s = LIGHT_ON_S if step.flicker else LIGHT_OFF_S
            case MoveStep():
                duration_s = self._move(step.pose.angles_deg)
            case RecordStep():
                duration_s = self._record(step) + RECORD_EXTRA_S + CHECK_S
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
            taken = self._pictures * self._picture_bytes
            self.size_bytes += taken + POSE_BYTES
            self.most_bytes += 2 * taken * step.attempts + POSE_BYTES  # 16 bit
            return self._pictures * PICTURE_S
        if self._frequency_hz is None:  # in the dark, which the check of the script forbids
            recorded_s = step.window_ms * 1e-3
        else:
            recorded_s = recording_duration_s(step.window_ms, self._frequency_hz)
        most_events = step.gates.max_event_rate_mev_s * 1e6 * recorded_s
        self.size_bytes += int(recorded_s * RECORDING_BYTES_PER_S) + POSE_BYTES
        self.most_bytes += int(most_events * MOST_BYTES_PER_EVENT * step.attempts) + POSE_BYTES
        return recorded_s

    def _move(self, target_deg: Mapping[str, float]) -> float:
        distances = {name: angle - self._at_deg.get(name, 0.0) for name, angle in target_deg.items()}
        self._at_deg |= target_deg
        return self._travel_s(distances) + MOVE_EXTRA_S

    def _travel_s(self, distances_deg: Mapping[str, float]) -> float:
        """Time until the slowest axis has gone its way; axes the station has not are a fault elsewhere."""
        return max(
            (
                travel_s(distance, self._axes[name].speed_deg_s, self._axes[name].acceleration_deg_s2)
                for name, distance in distances_deg.items()
                if name in self._axes
            ),
            default=0.0,
        )


def _fault_dict(fault: Fault) -> dict[str, Any]:
    """Give a fault without its file's whole path, which is of this machine only."""
    return dataclasses.asdict(fault) | {"file": Path(fault.file).name}
