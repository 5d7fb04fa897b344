"""Fine errors of a collimator, which no field of the model holds: all stars near a place share them."""

from dataclasses import replace

import numpy as np
import pytest

from calib import CalibrationOptions
from calib.joint.adjust import adjust
from tests.unit.calib.conftest import Bench

_POSES = ((-5, 2), (5, 2), (0, -3), (3, 0))


@pytest.mark.parametrize(("wave_px", "least", "most"), [(0.1, 0.0, 0.7), (0.0, 0.99, 1.0)])
def test_stars_that_share_fine_errors_count_for_what_is_new_of_each(wave_px, least, most):
    """Their waves are as long as three spacings of stars. Noise that neighbours do not share counts whole."""
    views = Bench().views(np.random.default_rng(3), 0.01, poses=_POSES)
    waved = [
        replace(view, points_px=view.points_px + wave_px * np.sin(2.0 * np.pi * view.target_mm / 22.0))
        for view in views
    ]
    shares = adjust(waved, CalibrationOptions()).marginal.equations.shares
    assert (shares >= least).all()
    assert (shares <= most).all()
