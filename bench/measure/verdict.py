"""The verdict on a recording: whether it is accepted, and why not. `bench.run.steps` decides whether to try again."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bench.measure.camera_kinds import CameraKind
from bench.measure.gates import at_most, failed_gate_texts
from bench.record.as_data import as_data
from bench.record.events import AttemptChecked, CaptureStored
from bench.record.measured_facts import GateData
from sequences.script import RecordStep

if TYPE_CHECKING:
    from bench.measure.measure import Measurement

MAX_MOTION_DEG = 0.0005
"""Largest motion between the begin and the end of a recording, degrees: 0.03 px at f = 3345 px."""


def judged(
    kind: CameraKind, step: RecordStep, frequency_hz: float, stored: CaptureStored, measurement: Measurement
) -> AttemptChecked:
    """Return what the journal holds about the measurement of a recording: its verdict, and why."""
    before_deg, after_deg = stored["measured_deg"], stored["measured_after_deg"]
    gates, other_reasons = kind.judge(stored["facts"], step, frequency_hz, measurement)
    gates += [  # whether the stage stood still
        at_most(f"{axis} moved", abs(after_deg[axis] - before_deg[axis]), MAX_MOTION_DEG, "deg")
        for axis in before_deg
    ]
    failed = [gate for gate in gates if measurement.view is not None or gate.name != "stars"]
    reasons = [*filter(None, [measurement.fault]), *failed_gate_texts(failed), *other_reasons]
    if "asleep_s" in stored:
        reasons.insert(0, f"the computer was suspended for {stored['asleep_s']:g} s during the recording")
    return {
        "pose": stored["pose"],
        "attempt": stored["attempt"],
        "accepted": not reasons,
        "reasons": reasons,
        "stars": measurement.stars,
        "gates": [as_data(gate, GateData) for gate in gates],
        "measured": measurement.facts,
    }
