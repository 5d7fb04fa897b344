"""Noise of star centres, and vignetting."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib import StarTarget, View
from calib.stars.centring import stencil_residuals, variance_factor
from calib.stars.rim import VIGNETTED_SIGMA_PX, downweight_vignetted, vignetted_stars


def grid(columns, rows):
    c, r = np.meshgrid(np.arange(columns), np.arange(rows))
    return np.column_stack([c.ravel(), r.ravel()])


UNIT = np.eye(2)


@given(st.lists(st.floats(-1, 1), min_size=20, max_size=20))
@settings(max_examples=50)
def test_maps_of_third_degree_leave_no_residual(coefficients):
    nodes = grid(6, 5)
    x, y = nodes.T / 5.0
    terms = np.stack([x**i * y**j for i in range(4) for j in range(4 - i)], axis=1)
    points = terms @ np.reshape(coefficients, (10, 2))
    residuals, _ = stencil_residuals(nodes, points, np.tile(UNIT, (len(nodes), 1, 1)))
    assert len(residuals) == 4 * 3
    assert np.abs(residuals).max() < 1e-12


@pytest.mark.parametrize("factor", [0.3, 1.0, 7.0])
def test_the_factor_of_noise_is_recovered(factor):
    rng = np.random.default_rng(1)
    nodes = grid(25, 25)
    nominal = rng.uniform(0.5, 2.0, len(nodes))[:, None, None] * np.array([[2.0, 0.5], [0.5, 1.0]])
    noise = np.einsum("nij,nj->ni", np.linalg.cholesky(nominal), rng.standard_normal((len(nodes), 2)))
    fitted = variance_factor(nodes, 50.0 * nodes + np.sqrt(factor) * noise, nominal, typical=3.0)
    assert fitted == pytest.approx(factor, rel=0.12)


def test_a_few_gross_stars_do_not_enlarge_the_factor():
    rng = np.random.default_rng(2)
    nodes = grid(25, 25)
    points = 50.0 * nodes + rng.standard_normal((len(nodes), 2))
    points[[100, 300, 500]] += 80.0
    covariances = np.tile(UNIT, (625, 1, 1))
    assert variance_factor(nodes, points, covariances, typical=1.0) == pytest.approx(1.0, rel=0.2)


def test_without_surrounded_stars_the_typical_factor_is_used():
    nodes = grid(10, 2)
    assert variance_factor(nodes, 50.0 * nodes, np.tile(UNIT, (20, 1, 1)), typical=6.0) == 6.0


# ---------------------------------------------------------------- vignetting

TARGET = StarTarget()

PITCH_PX = 50.0

SIZE = (1280, 720)


def view(radius_mm, *, turn_deg=20.0, without=()):
    """Return a view of a beam of that radius about the tag, with the camera turned about its axis."""
    positions = TARGET.positions_mm(TARGET.ids)
    from_tag_mm = positions - TARGET.tag_centre_mm
    turn = np.radians(turn_deg)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    points = from_tag_mm @ rotation.T * (PITCH_PX / TARGET.pitch_mm) + [640.0, 360.0]
    framed = ((points > 25) & (points < np.array(SIZE) - 26)).all(axis=1)
    kept = framed & (np.hypot(*from_tag_mm.T) < radius_mm) & ~np.isin(TARGET.ids, without)
    return View("v", SIZE, TARGET.ids[kept], points[kept], positions[kept], 0.02)


def distance_mm(seen):
    return np.hypot(*(seen.target_mm - TARGET.tag_centre_mm).T)


@pytest.mark.parametrize("turn_deg", [0.0, 20.0, 45.0, 170.0])
def test_the_outermost_ring_of_a_beam_inside_the_frame_is_the_rim_and_no_other_star(turn_deg):
    seen = view(20.0, turn_deg=turn_deg)
    rim = vignetted_stars(seen, TARGET)
    distances_mm = distance_mm(seen)
    assert rim[distances_mm > 20.0 - TARGET.pitch_mm].all()
    assert not rim[distances_mm < 20.0 - 1.5 * TARGET.pitch_mm].any()


def test_where_the_frame_or_the_tag_ends_the_stars_there_is_no_rim():
    assert not vignetted_stars(view(1000.0), TARGET).any()


def test_the_neighbours_of_a_star_that_was_missed_count_as_rim():
    missed = int(TARGET.id_at(29, 35))
    whole, holed = view(1000.0), view(1000.0, without=[missed])
    rim = vignetted_stars(holed, TARGET)
    assert rim.sum() == 8
    assert np.abs(TARGET.node_of(holed.ids[rim]) - [29, 35]).max() == 1
    assert len(whole) == len(holed) + 1


def test_only_vignetted_stars_get_less_weight():
    seen = view(20.0)
    rim = vignetted_stars(seen, TARGET)
    weighted = downweight_vignetted(seen, TARGET)
    np.testing.assert_allclose(
        weighted.covariances_px2[rim],
        np.broadcast_to((0.0004 + VIGNETTED_SIGMA_PX**2) * np.eye(2), (rim.sum(), 2, 2)),
    )
    np.testing.assert_array_equal(weighted.covariances_px2[~rim], seen.covariances_px2[~rim])
    np.testing.assert_array_equal(weighted.points_px, seen.points_px)
