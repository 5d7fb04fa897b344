"""How far a calibration is, for a person who waits."""

import numpy as np
import pytest

from calib import CalibrationOptions, Passport
from calib.engine import calibrate
from calib.progress import shown_by

STATED = CalibrationOptions(passport=Passport.of_radius(255.0, 0.1, length="seen"))


@pytest.fixture
def views(bench):
    """Few stars of each view."""
    whole = bench.views(np.random.default_rng(21), 0.05)
    return [view.part(np.arange(len(view)) % 4 == 0) for view in whole]


def test_a_calibration_tells_how_far_it_is_until_almost_all_is_done(views):
    reached = []
    with shown_by(lambda done, expected: reached.append((done, expected))):
        calibrate(views)
        once = reached.copy()
        calibrate(views[:2], STATED)
    assert once[0][0] == reached[len(once)][0] == 0.0, "each calibration begins anew"
    assert all(done < expected for done, expected in once)
    assert [done for done, _ in once] == sorted(done for done, _ in once)
    assert once[-1][0] >= 0.3 * once[-1][1]


def test_nothing_is_told_outside_the_block(views):
    reached = []
    with shown_by(lambda done, expected: reached.append((done, expected))):
        pass
    calibrate(views[:2], STATED)
    assert reached == []
