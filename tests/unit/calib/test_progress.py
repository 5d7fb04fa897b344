"""How far a calibration is, for a person who waits."""

import numpy as np

from calib import CalibrationOptions, Passport
from calib.engine import calibrate
from calib.progress import shown_by

STATED = CalibrationOptions(passport=Passport.of_radius(255.0, 0.1, length="seen"))


def test_each_calibration_within_the_block_tells_how_far_it_is_until_almost_all_is_done(bench):
    whole, reached = bench.views(np.random.default_rng(21), 0.05), []
    views = [view.part(np.arange(len(view)) % 4 == 0) for view in whole]
    with shown_by(lambda done, expected: reached.append((done, expected))):
        calibrate(views)
        once = reached.copy()
        calibrate(views[:2], STATED)
    told = len(reached)
    calibrate(views[:2], STATED)
    assert len(reached) == told, "nothing is told outside of the block"
    assert once[0][0] == reached[len(once)][0] == 0.0, "each calibration begins anew"
    assert all(done < expected for done, expected in once)
    assert [done for done, _ in once] == sorted(done for done, _ in once)
    assert once[-1][0] >= 0.3 * once[-1][1]
