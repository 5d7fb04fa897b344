"""Where the stars of a pose are expected, by the gimbal and the poses of the run that showed the tag.

Reads a run's history alone. What was expected of a recording stands in the journal with what it showed, so that looking
at it again gives the same stars.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from bench.records.events import CaptureStored
from bench.records.history import Attempt, History
from bench.views.measure import ExpectedGrid
from calib.stars.pointing import LabelledView, predict_grid
from calib.target import StarTarget


def grid_from_earlier_poses(history: History, stored: CaptureStored, target: StarTarget) -> ExpectedGrid:
    """Expect the stars of a recording by the accepted ones of which the tag named the stars.

    Parameters
    ----------
    history
        The run so far.
    stored
        What the journal tells of the recording: where the gimbal stood.
    target
        The printed target.
    """
    here = best_angles_deg(stored["measured_deg"])

    def expect(image_size: tuple[int, int]) -> NDArray[np.float64]:
        seen = [
            LabelledView(np.array(measured["grid"]), best_angles_deg(attempt.stored["measured_deg"]))
            for attempt in history.accepted().values()
            if (measured := attempt.measured).get("named_by") in ("tag", "part of the tag")
        ]
        return predict_grid(seen, here, image_size, target.pitch_mm).grid

    return expect


def grid_from_journal(attempt: Attempt) -> ExpectedGrid | None:
    """Expect of a recording what was expected when it was accepted; None where the tag named its stars."""
    grid = attempt.measured.get("expected_grid")
    return None if grid is None else lambda _image_size: np.array(grid)


def best_angles_deg(measured_deg: Mapping[str, float]) -> dict[str, float]:
    """Where a stage stood, by axis: what its encoders read, where it has some (``pan_encoder``)."""
    axes = ("pan", "tilt", "roll")
    return {a: measured_deg.get(f"{a}_encoder", measured_deg[a]) for a in axes if a in measured_deg}
