"""Where the stars of a pose are expected, from the gimbal and the earlier poses of the run that showed the tag.

The journal stores the expected grid, so that measuring a recording again gives the same stars.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from calib.target import StarTarget

if TYPE_CHECKING:
    from bench.measure.measure import ExpectedGrid
    from bench.record.events import CaptureStored
    from bench.record.history import Attempt, History


def grid_from_earlier_poses(history: History, stored: CaptureStored, target: StarTarget) -> ExpectedGrid:
    """Predict a recording's grid, as `calib.stars.pointing`, from accepted poses with the tag, or `DegenerateViews`."""
    # Loaded here, because it needs OpenCV and numba, which a plan that reads angles does not.
    from calib.stars.pointing import LabelledView, predict_grid

    here = best_angles_deg(stored["measured_deg"])

    def predict(image_size: tuple[int, int]) -> NDArray[np.float64]:
        labelled = [
            LabelledView(np.array(measured["grid"]), best_angles_deg(attempt.stored["measured_deg"]))
            for attempt in history.accepted().values()
            if (measured := attempt.measured).get("named_by") in ("tag", "part of the tag")
        ]
        return predict_grid(labelled, here, image_size, target.pitch_mm).grid

    return predict


def grid_from_journal(attempt: Attempt) -> ExpectedGrid | None:
    """Return the grid expected when a recording was accepted; None if the tag labelled its stars."""
    grid = attempt.measured.get("expected_grid")
    return None if grid is None else lambda _image_size: np.array(grid)


def engine_angles_deg(measured_deg: Mapping[str, float]) -> dict[str, float]:
    """Return the same angles by the engine's names: ``pan_deg``."""
    return {f"{axis}_deg": angle for axis, angle in best_angles_deg(measured_deg).items()}


def best_angles_deg(measured_deg: Mapping[str, float]) -> dict[str, float]:
    """Return angle by axis, degrees: that of the encoder (``pan_encoder``) if there is one, else the stated one."""
    axes = ("pan", "tilt", "roll")
    return {a: measured_deg.get(f"{a}_encoder", measured_deg[a]) for a in axes if a in measured_deg}
