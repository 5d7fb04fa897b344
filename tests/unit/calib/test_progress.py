"""How far a calibration is, for a person who waits."""

import numpy as np
import pytest

from calib.engine import calibrate
from calib.progress import shown_by


@pytest.fixture
def views(bench):
    """Few stars of each view."""
    whole = bench.views(np.random.default_rng(21), 0.05)
    return [view.part(np.arange(len(view)) % 4 == 0) for view in whole]


def test_a_calibration_tells_how_far_it_is_until_almost_all_is_done(views):
    reached = []
    with shown_by(lambda done, expected: reached.append((done, expected))):
        calibrate(views)
        calibrate(views)
    assert reached[0] == reached[len(reached) // 2] == (0.0, reached[0][1]), "each calibration begins anew"
    once = reached[: len(reached) // 2]
    assert all(done < expected for done, expected in once)
    assert [done for done, _ in once] == sorted(done for done, _ in once)
    assert once[-1][0] >= 0.3 * once[-1][1]


def test_nothing_is_told_outside_the_block(views):
    reached = []
    with shown_by(lambda done, expected: reached.append((done, expected))):
        pass
    calibrate(views[:2])
    assert reached == []
