"""How far the pupil of a gimbal moves through the beam: what visible discs show of it, and what is expected if they show little."""

import numpy as np
import pytest

from calib.joint import amplitudes as amp
from calib.joint.pupils import lever_of
from calib.model.gimbal_readings import ParallaxBound
from calib.model.rim_fit import Disc, DiscMotion, Discs

R_MM = 250.0
RASTER = np.array([(x, y) for y in (-0.05, 0.0, 0.05) for x in (-0.1, 0.0, 0.1)])


def discs(turns, ways, sigma_mm):
    """Discs that move by ``ways``, shares of the radius per unit turn along X and Y, with independent noise."""
    noise = sigma_mm * np.random.default_rng(1).standard_normal((len(turns), 2))
    unit, variances = np.eye(2), np.full(2 * len(turns), sigma_mm**2)
    middles = R_MM * turns * ways + noise
    return Discs(
        [Disc(middle, 50.0, unit * sigma_mm**2, sigma_mm) for middle in middles],
        np.diag(variances),
        DiscMotion(np.zeros((2, 2)), np.eye(4)),
    )


@pytest.mark.parametrize(("way", "least", "most"), [(0.17, 0.14, 0.2), (0.05, 0.04, 0.06), (0.0, 0.0, 0.01)])
def test_discs_that_are_well_seen_decide(way, least, most):
    assert least < lever_of(discs(RASTER, (way, way), 0.1), RASTER, R_MM).middle < most


def test_discs_that_show_little_leave_what_is_expected():
    expected = lever_of(None, RASTER, R_MM).middle
    assert expected == pytest.approx(0.03)
    lever = lever_of(discs(RASTER, (0.17, 0.17), 500.0), RASTER, R_MM)
    assert lever.middle == pytest.approx(expected, rel=0.1)


def test_the_better_discs_are_seen_the_better_the_way_is_known():
    seen = [lever_of(discs(RASTER, (0.17, 0.17), sigma), RASTER, R_MM).spread for sigma in (0.1, 2.0, 500.0)]
    assert seen == sorted(seen)
    assert seen[0] < 0.45
    assert seen[-1] == pytest.approx(lever_of(None, RASTER, R_MM).spread, rel=0.05)


def test_a_pupil_far_off_the_pivot_is_seen_by_three_sigmas_of_its_discs():
    # sigma of the motion along X: 2.45 mm over 250 mm and a root of the sum of squares of 0.245
    assert lever_of(discs(RASTER, (0.17, 0.17), 2.45), RASTER, R_MM).middle > 0.1


def test_an_axis_that_stands_still_says_nothing():
    table = RASTER * (1.0, 0.0)
    seen, unseen = (lever_of(discs(table, (0.17, 0.0), sigma), table, R_MM).middle for sigma in (0.1, 500.0))
    assert unseen == pytest.approx(0.03, rel=0.1)
    assert 0.1 < seen < 0.2


@pytest.mark.parametrize(("off_mm", "way"), [(45.0, 0.18), (-45.0, 0.18), (2.0, 0.03)])
def test_a_pupil_moves_at_least_as_far_as_stated(off_mm, way):
    bound = ParallaxBound(0.06, 0.01, off_mm, 0.5)
    stated = lever_of(discs(RASTER, (0.0, 0.0), 0.1), RASTER, R_MM, bound)
    assert way < stated.middle < way + 0.005
    assert stated.spread == 0.0


def test_errors_by_turn_are_expected_in_proportion_to_how_far_the_pupil_moves():
    near, far = (amp.hyperprior(amp.Lever(way, 0.0), amp.Pupil.WALKS) for way in (amp.LEVER, 3.0 * amp.LEVER))
    times = dict(zip(near.names, np.exp(far.mean - near.mean).tolist(), strict=True))
    for name in (amp.PARALLAX, amp.CURVATURE_TURN, *amp.TURN):
        assert times.pop(name) == pytest.approx(3.0)
    for name in (amp.SCALE_TURN_2, *amp.TURN_2):
        assert times.pop(name) == pytest.approx(9.0)
    assert list(times.values()) == pytest.approx([1.0] * len(times))


def test_errors_by_turn_are_not_expected_smaller_than_those_near_the_pivot():
    levers = (amp.Lever(way, 0.0) for way in (amp.LEVER, 0.3 * amp.LEVER))
    usual, still = (amp.hyperprior(lever, amp.Pupil.WALKS) for lever in levers)
    changed = np.array(usual.names)[usual.mean != still.mean]
    assert changed.tolist() == [amp.PARALLAX]
