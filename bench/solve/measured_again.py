"""A stored recording of a run, measured again from its file alone."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from bench.measure.expected_grid import grid_from_journal
from bench.plan.job import Job
from bench.record.history import Attempt

if TYPE_CHECKING:
    from bench.measure.measure import Measurement


def measure_again(job: Job, folder: Path, attempt: Attempt) -> Measurement:
    """Measure a stored recording with the grid that was expected at its time."""
    step = job.record_steps[attempt.pose_index]
    path = folder / str(attempt.stored["capture"])
    return job.camera_kind.measure(path, step, job.frequency_hz(step), job.target, grid_from_journal(attempt))
