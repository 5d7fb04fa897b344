"""How far a calibration is, for a person who waits."""

from __future__ import annotations

from calib.engine import calibrate
from calib.progress import shown_by


def test_a_calibration_tells_how_far_it_is_until_almost_all_is_done(bench):
    reached = []
    with shown_by(lambda done, expected: reached.append((done, expected))):
        calibrate(bench.views())
        calibrate(bench.views())
    assert reached[0] == reached[len(reached) // 2] == (0.0, reached[0][1]), "each calibration begins anew"
    once = reached[: len(reached) // 2]
    assert all(done < expected for done, expected in once)
    assert [done for done, _ in once] == sorted(done for done, _ in once)
    assert once[-1][0] >= 0.3 * once[-1][1]


def test_nothing_is_told_outside_the_block(bench):
    reached = []
    with shown_by(lambda done, expected: reached.append((done, expected))):
        pass
    calibrate(bench.views())
    assert reached == []
