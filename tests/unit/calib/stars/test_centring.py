"""Centres by symmetry: the steps to them, and their information."""

import numpy as np
import pytest

from calib.stars.centring import centre_information, solve_steps


def equations(smallest, random):
    """Return normal equations with unknowns in different units, and their exact solution."""
    q, _ = np.linalg.qr(random.normal(size=(6, 6)))
    units = np.diag([1.0, 1.0, 100.0, 100.0, 7.0, 7.0])
    return units @ q @ np.diag([1.0, 1.0, 1.0, 1.0, 1.0, smallest]) @ q.T @ units, random.normal(size=6)


def test_each_step_solves_the_equations_of_its_star():
    random = np.random.default_rng(4)
    normal, solution = map(np.array, zip(*(equations(c, random) for c in (1.0, 1e-2, 1e-6)), strict=True))
    right = np.einsum("nkm,nm->nk", normal, solution)
    regular, step = solve_steps(normal, right)
    assert regular.all()
    np.testing.assert_allclose(np.einsum("nkm,nm->nk", normal, step), right, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(
        centre_information(normal), np.linalg.inv(np.linalg.inv(normal)[:, :2, :2]), rtol=1e-4
    )


@pytest.mark.parametrize("flat", [np.zeros((6, 6)), np.ones((6, 6)), np.full((6, 6), np.nan)])
def test_a_flat_image_determines_no_step_and_leaves_other_stars_theirs(flat):
    lit, solution = equations(0.1, np.random.default_rng(6))
    regular, step = solve_steps(np.array([flat, lit]), np.array([np.ones(6), lit @ solution]))
    assert list(regular) == [False, True]
    np.testing.assert_array_equal(step[0], 0.0)
    np.testing.assert_allclose(step[1], solution, rtol=1e-9)


def test_a_matrix_that_is_nearly_singular_determines_no_step():
    normal, _ = equations(1e-14, np.random.default_rng(5))
    assert not solve_steps(normal[None], np.ones((1, 6))).regular.any()
