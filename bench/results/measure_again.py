"""Measure an accepted recording of a run again, from its file alone."""

from __future__ import annotations

from pathlib import Path

from bench.base.errors import BenchError
from bench.plan.job import Job
from bench.records.history import Attempt
from bench.views.expected_grid import grid_from_journal
from bench.views.measure import Measurement


def measure_again(job: Job, folder: Path, attempt: Attempt) -> Measurement:
    """Find the stars of an accepted recording again, with the grid that was expected when it was recorded.

    Returns: The measurement; its view is not None.
    Raises BenchError: If no stars are found in the recording any more.
    """
    step = job.record_step(attempt.pose_index)
    path = folder / str(attempt.stored["capture"])
    found = job.camera_kind.measure(
        path, step, job.frequency_hz(step), job.target, grid_from_journal(attempt)
    )
    if found.view is None:
        raise BenchError(
            f"{attempt.stored['capture']} was accepted, but now no stars are found in it: {found.fault}",
            where=str(folder),
            remedy="Another version of the program recorded it. Use that version, or `starbench calibrate`.",
        )
    return found
