"""Point files of a calibration from files alone."""

import numpy as np
import pytest

from bench.plan.plan import load_documents, make_plan
from bench.results.forecasts import expected_bench
from calib.studies.predicted_views import predicted_view


@pytest.fixture(scope="session")
def points(tmp_path_factory):
    """Point files of three views of the bench that the simulated station expects."""
    folder = tmp_path_factory.mktemp("points")
    bench = expected_bench(make_plan(*load_documents("three_pose", "simulated_ideal")).station)
    rng = np.random.default_rng(5)
    for name, pan, tilt in (("left", -6, 2), ("right", 6, 2), ("below", 0, -3)):
        view, _ = predicted_view(bench, {"pan_deg": pan, "tilt_deg": tilt}, name)
        seen = view.points_px + rng.normal(0, 0.01, view.points_px.shape) + 0.5
        rows = np.column_stack([seen, view.target_mm, view.ids])
        np.savetxt(folder / f"{name}.csv", rows, fmt=["%.6f"] * 4 + ["%d"])
    return folder
