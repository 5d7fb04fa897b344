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

from bench.errors import ScriptError
from bench.script_check import angle_faults, check_script
from bench.station import Station, ZaberAxis, load_station
from sequences.errors import DocumentFaults, Fault
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

SHIPPED_SEQUENCES = Path(__file__).parent.parent / "sequences"

RECORDING_MARGIN_S = 1e-3
"""Recorded beyond the whole periods and the one that is cut at the ends."""

# Allowances, measured on the simulated bench; small on a real one too, beside moves and settling.
LIGHT_S = 0.6
HOMING_EXTRA_S = 1.0
MOVE_EXTRA_S = 0.1
RECORD_EXTRA_S = 0.2
CHECK_S = 1.0
SOLVE_S = 1.0
REPORT_S = 3.0
RECORDING_BYTES_PER_S = 50e6
"""A lit target under a square flicker; a camera's link carries four times as much at most."""
MOST_BYTES_PER_EVENT = 4
REPORT_BYTES = 10_000_000


def whole_periods(window_ms: float, frequency_hz: float) -> int:
    """Return how many whole flicker periods a window stands for.

    An image gathered over a part of a period would show that part's polarity more; so windows are rounded.

    Examples
    --------
    >>> whole_periods(33, 60)
    2
    """
    return max(1, round(window_ms * 1e-3 * frequency_hz))


def recording_duration_s(window_ms: float, frequency_hz: float) -> float:
    """Return how long to record so that the window's whole periods lie inside, wherever the light stands.

    Examples
    --------
    >>> round(recording_duration_s(33, 60), 4)
    0.051
    """
    return (whole_periods(window_ms, frequency_hz) + 1) / frequency_hz + RECORDING_MARGIN_S


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
    size_bytes
        Expected on disk.
    """

    step: Step
    duration_s: float
    done_after_s: float
    size_bytes: int


@dataclass(frozen=True)
class Plan:
    """A run before it is run.

    Attributes
    ----------
    sequence, station
        The files, checked.
    steps
        The script with its times, homing included in the first move.
    faults
        Why it cannot be run; empty when it can.
    remarks
        What somebody should know before it is run.
    size_bytes, most_bytes
        Disk expected; and at most, with every attempt used at the highest event rate the gates let pass.
    """

    sequence: Located[Sequence]
    station: Located[Station]
    steps: tuple[PlannedStep, ...]
    faults: tuple[Fault, ...]
    remarks: tuple[Fault, ...]
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

    @property
    def duration_s(self) -> float:
        """Expected time of the whole run."""
        return self.steps[-1].done_after_s if self.steps else 0.0

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


def load(sequence: str, station: str) -> tuple[Located[Sequence], Located[Station]]:
    """Read a sequence and a station, each a path or the name of a shipped one.

    Raises
    ------
    ScriptError
        With every fault of both files, where one of them cannot be used.
    """
    faults: list[Fault] = []
    read_sequence = read_station = None
    try:
        read_station = load_station(station)
    except DocumentFaults as error:
        faults += error.faults
    try:
        read_sequence = read_document(find_document(sequence, SHIPPED_SEQUENCES), Sequence)
        faults += unfold(read_sequence)[1] if faults else []
    except DocumentFaults as error:
        against_station = angle_faults(error.tree, read_station.value) if error.tree and read_station else []
        faults = [*error.faults, *against_station, *faults]
    if read_sequence is None or read_station is None:
        raise ScriptError([str(fault) for fault in faults])
    return read_sequence, read_station


def plan(sequence: Located[Sequence], station: Located[Station]) -> Plan:
    """Plan a run: never raises for what is wrong with it, that stands in the plan's faults."""
    script, faults = unfold(sequence)
    findings = check_script(sequence, script, station.value)
    steps: list[PlannedStep] = []
    estimate = _Estimate(station.value)
    for step in script:
        duration = estimate.duration_s(step)
        after = (steps[-1].done_after_s if steps else 0.0) + duration
        steps.append(PlannedStep(step, duration, after, estimate.size_bytes(step)))
    return Plan(
        sequence=sequence,
        station=station,
        steps=tuple(steps),
        faults=tuple(sorted({*faults, *findings.faults})),
        remarks=findings.remarks,
        size_bytes=sum(planned.size_bytes for planned in steps),
        most_bytes=estimate.most_bytes,
    )


class _Estimate:
    """Time and disk of one step after another, following where the stage stands and what the light does."""

    def __init__(self, station: Station) -> None:
        self.axes = station.stage.axes
        self.frequency_hz = math.inf
        self.at_deg: Mapping[str, float] | None = None
        self.most_bytes = REPORT_BYTES

    def duration_s(self, step: Step) -> float:
        match step:
            case LightStep():
                self.frequency_hz = step.flicker.frequency_hz if step.flicker else math.inf
                duration = LIGHT_S
            case MoveStep():
                duration = self._move_s(step.pose.angles_deg)
            case RecordStep():
                duration = self._recording_s(step) + RECORD_EXTRA_S + CHECK_S
            case SettleStep() | WaitStep():
                duration = step.duration_s
            case PromptStep():
                duration = step.timeout_s
            case SolveStep():
                duration = SOLVE_S
            case ReportStep():
                duration = REPORT_S
        return duration

    def size_bytes(self, step: Step) -> int:
        if isinstance(step, ReportStep):
            return REPORT_BYTES
        if not isinstance(step, RecordStep):
            return 0
        events = step.gates.max_event_rate_mev_s * 1e6 * self._recording_s(step)
        self.most_bytes += int(events * MOST_BYTES_PER_EVENT * step.attempts)
        return int(self._recording_s(step) * RECORDING_BYTES_PER_S)

    def _recording_s(self, step: RecordStep) -> float:
        if math.isinf(self.frequency_hz):  # in the dark: a fault elsewhere
            return step.window_ms * 1e-3
        return recording_duration_s(step.window_ms, self.frequency_hz)

    def _move_s(self, target_deg: Mapping[str, float]) -> float:
        """Time of a move of all axes at once; the first includes finding the reference."""
        homing, start = 0.0, self.at_deg
        if start is None:
            start = dict.fromkeys(self.axes, 0.0)
            homing = max(_homing_s(axis) for axis in self.axes.values())
        times = [
            travel_s(
                target_deg.get(name, 0.0) - start.get(name, 0.0), axis.speed_deg_s, axis.acceleration_deg_s2
            )
            for name, axis in self.axes.items()
        ]
        self.at_deg = target_deg
        return homing + max(times) + MOVE_EXTRA_S


def _homing_s(axis: ZaberAxis) -> float:
    """Time to find the reference: over the whole range at full speed, and slowly at its end."""
    lowest, highest = axis.limits_deg
    return travel_s(highest - lowest, axis.speed_deg_s, axis.acceleration_deg_s2) + HOMING_EXTRA_S


def _fault_dict(fault: Fault) -> dict[str, Any]:
    return dataclasses.asdict(fault) | {"text": str(fault)}
