"""Fine errors of a collimator, which no field of the model holds: all stars near a place share them."""

from dataclasses import replace

import numpy as np

from calib import CalibrationOptions, calibrate
from tests.unit.calib.conftest import Bench


def test_errors_that_neighbours_and_poses_share_do_not_count_as_often_as_they_are_seen():
    """Counted so, they moved cy by .84 U; a ray-traced mirror with such errors moved cx by 9 U."""
    bench = Bench()
    views = bench.views(np.random.default_rng(3), 0.01, poses=((-5, 2), (5, 2), (0, -3), (3, 0)))
    waves = [0.2 * np.sin(2.0 * np.pi * view.target_mm / 22.0 + 3.0) for view in views]
    waved = [replace(view, points_px=view.points_px + wave) for view, wave in zip(views, waves, strict=True)]
    result = calibrate(waved, CalibrationOptions())
    for name, share in (("cx", 0.1), ("cy", 0.6)):
        assert abs(result.values[name] - bench.truth[name]) < share * result.U[name]
