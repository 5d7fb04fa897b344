"""The scatter of neighbouring stars: unaffected by smooth maps, and a measure of the noise."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.stars.noise import stencil_residuals, variance_factor


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
    found = variance_factor(nodes, 50.0 * nodes + np.sqrt(factor) * noise, nominal, typical=3.0)
    assert found == pytest.approx(factor, rel=0.12)


def test_a_few_gross_stars_do_not_enlarge_the_factor():
    rng = np.random.default_rng(2)
    nodes = grid(25, 25)
    points = 50.0 * nodes + rng.standard_normal((len(nodes), 2))
    points[[100, 300, 500]] += 80.0
    assert variance_factor(nodes, points, np.tile(UNIT, (625, 1, 1)), typical=1.0) == pytest.approx(
        1.0, rel=0.2
    )


def test_without_surrounded_stars_the_typical_factor_is_used():
    nodes = grid(10, 2)
    assert variance_factor(nodes, 50.0 * nodes, np.tile(UNIT, (20, 1, 1)), typical=6.0) == 6.0
