"""Centres by symmetry: the quick test of the normal equations."""

import numpy as np
import pytest
from inner_loops import from_python

from calib.stars import centring

clearly_regular, find_step = from_python(centring._clearly_regular), from_python(centring._find_step)
store_information = from_python(centring._store_information)


def test_a_matrix_that_is_clearly_regular_has_a_small_condition():
    """The quick test may only spare the exact one, never contradict it."""
    random = np.random.default_rng(3)
    verdicts = []
    for exponent in np.linspace(0.0, 14.0, 60):
        q, _ = np.linalg.qr(random.normal(size=(6, 6)))
        matrix = q @ np.diag(np.logspace(0.0, -exponent, 6)) @ q.T
        scale = np.sqrt(np.diag(matrix))
        scaled = matrix / scale[:, None] / scale[None, :]
        factor = np.zeros((6, 6))
        verdicts.append(clearly_regular(scaled, factor))
        if verdicts[-1]:
            assert np.linalg.cond(scaled) < 1e10
            np.testing.assert_allclose(factor @ factor.T, scaled, atol=1e-14)
    assert verdicts[0]
    assert not verdicts[-1]
    assert not clearly_regular(np.ones((6, 6)), factor)


@pytest.mark.parametrize("smallest", [1e-2, 1e-11])
def test_the_step_solves_the_equations(smallest):
    """The second matrix is left to the exact solution."""
    random = np.random.default_rng(4)
    q, _ = np.linalg.qr(random.normal(size=(6, 6)))
    units = np.array([1.0, 1.0, 100.0, 100.0, 7.0, 7.0])
    matrix = np.diag(units) @ q @ np.diag([1.0, 1.0, 1.0, 1.0, 1.0, smallest]) @ q.T @ np.diag(units)
    solution, step = random.normal(size=6), np.empty(6)
    assert find_step(matrix, matrix @ solution, np.zeros((6, 6)), step)
    np.testing.assert_allclose(matrix @ step, matrix @ solution, rtol=1e-9, atol=1e-6)
    information = np.empty((2, 2))
    store_information(matrix, information)
    np.testing.assert_allclose(information, np.linalg.inv(np.linalg.inv(matrix)[:2, :2]), rtol=1e-4)


def test_a_flat_image_determines_no_step():
    step = np.empty(6)
    assert not find_step(np.zeros((6, 6)), np.zeros(6), np.zeros((6, 6)), step)
    assert not find_step(np.ones((6, 6)), np.zeros(6), np.zeros((6, 6)), step)
