"""Irregular glass: Zernike fields of the configured rms, similar in near poses, and a rim that scatters outwards."""

import numpy as np
import pytest

from simulators.optics.collimator_errors import (
    DEGREE,
    MONOMIALS,
    POWER,
    RIM_FROM,
    RIM_OUTWARDS,
    displacement_field,
    field_coefficients,
    random_functions,
)

GRID = np.stack(np.meshgrid(np.linspace(-1, 1, 61), np.linspace(-1, 1, 61)), axis=-1).reshape(-1, 2)
DISC = GRID[np.hypot(*GRID.T) <= 1.0]
POSES = np.random.default_rng(4).uniform(-0.45, 0.45, (150, 2))


def over(points, drawn):
    """Displacements at points of the disc."""
    return np.array([displacement_field(u, v, drawn) for u, v in points])


def test_the_displacement_has_the_rms_asked_for_over_disc_and_poses():
    squares = [
        (over(DISC[::7], field_coefficients(tuple(pose), 0.02, 0.0, 1)) ** 2).sum(axis=1).mean()
        for pose in POSES
    ]
    assert np.sqrt(np.mean(squares)) == pytest.approx(0.02, rel=0.15)


def test_polynomials_of_a_degree_carry_their_share():
    shares = np.zeros(DEGREE + 1)
    radius, turn = np.hypot(*DISC.T), np.arctan2(*DISC.T[::-1])
    tilt = 2.0 * radius * np.cos(turn)
    focus = np.sqrt(3.0) * (2.0 * radius**2 - 1.0)
    for pose in POSES:
        moved = over(DISC, field_coefficients(tuple(pose), 1.0, 0.0, 1))
        shares[1] += (np.mean(moved * tilt[:, None], axis=0) ** 2).sum()
        shares[2] += (np.mean(moved * focus[:, None], axis=0) ** 2).sum()
    expected = np.array(POWER) / sum(POWER) / (np.arange(1, DEGREE + 1) + 1)
    np.testing.assert_allclose(shares[1:3] / len(POSES), expected[:2], rtol=0.35)


def test_near_poses_have_like_errors_and_distant_poses_do_not():
    drawn = np.array([random_functions(tuple(pose), 60, 1) for pose in POSES])
    beside = np.array([random_functions((x + 0.02, y), 60, 1) for x, y in POSES])
    assert np.mean(drawn * beside) / np.mean(drawn**2) > 0.7
    assert abs(np.mean(drawn[1:] * drawn[:-1])) < 0.1
    assert not np.allclose(drawn, [random_functions(tuple(pose), 60, 2) for pose in POSES], atol=0.5)


def test_only_the_rim_scatters_and_mostly_outwards():
    turns = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    circle = np.column_stack([np.cos(turns), np.sin(turns)])
    at_edge = np.array([over(circle, field_coefficients(tuple(pose), 0.0, 0.05, 1)) for pose in POSES])
    outwards = (at_edge * circle).sum(axis=2)
    assert outwards.mean() == pytest.approx(0.05 * RIM_OUTWARDS, rel=0.25)
    assert (at_edge - 0.05 * RIM_OUTWARDS * circle).std() == pytest.approx(0.05, rel=0.2)
    assert np.abs(over(0.99 * RIM_FROM * circle, field_coefficients((0.1, 0.2), 0.0, 0.05, 1))).max() == 0.0


def test_without_coefficients_nothing_moves():
    assert displacement_field(0.3, 0.9, np.zeros((0, 2))) == (0.0, 0.0)
    assert field_coefficients((0.0, 0.0), 0.01, 0.01, 1).shape == (MONOMIALS + 7, 2)
