"""Fine errors of a collimator, which no field of the model holds: all stars near a place share them."""

from dataclasses import replace

import numpy as np
import pytest

from calib import CalibrationOptions, calibrate
from tests.unit.calib.conftest import Bench

_POSES = ((-5, 2), (5, 2), (0, -3), (3, 0))


@pytest.mark.parametrize(("wave_px", "named"), [(0.1, True), (0.0, False)])
def test_a_result_says_where_neighbouring_stars_share_errors_that_no_field_holds(wave_px, named):
    views = Bench().views(np.random.default_rng(3), 0.01, poses=_POSES)
    waved = [
        replace(view, points_px=view.points_px + wave_px * np.sin(2.0 * np.pi * view.target_mm / 22.0))
        for view in views
    ]
    result = calibrate(waved, CalibrationOptions())
    assert any("times as far" in note for note in result.notes) is named
