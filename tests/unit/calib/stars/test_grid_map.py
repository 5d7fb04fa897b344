"""The map from grid to image: exact for smooth maps, and not bent by wrong stars."""

import numpy as np
import pytest

from calib.errors import TooFewStars
from calib.model.homography import apply_homography, fit_homography
from calib.stars.grid_map import expanded, fit_grid_map, predict_locally

H = np.array([[40.0, 3.0, 500.0], [-2.0, 41.0, 300.0], [1e-3, -2e-3, 1.0]])


def grid(n):
    c, r = np.meshgrid(np.arange(n) - n // 2, np.arange(n) - n // 2)
    return np.column_stack([c.ravel(), r.ravel()]).astype(float)


def bend(points):
    """Apply distortion of some pixels at the corners."""
    off = (points - [500.0, 300.0]) / 1000.0
    return points + 20.0 * off * (off**2).sum(axis=1, keepdims=True)


def test_a_homography_is_recovered():
    nodes = grid(5)
    fitted = fit_homography(nodes, apply_homography(H, nodes))
    assert fitted / fitted[2, 2] == pytest.approx(H, rel=1e-4, abs=1e-6)


@pytest.mark.parametrize("nodes", [grid(5)[:3], np.column_stack([np.arange(9.0), np.arange(9.0)])])
def test_stars_that_determine_no_homography_are_refused(nodes):
    with pytest.raises(TooFewStars):
        fit_homography(nodes, apply_homography(H, nodes)[: len(nodes)] * np.nan)


def test_a_bent_view_is_fitted_to_a_thousandth_of_a_pixel():
    nodes = grid(17)
    fitted, residuals = fit_grid_map(nodes, bend(apply_homography(H, nodes)))
    assert np.abs(residuals).max() < 5e-3
    between = grid(9) + 0.5
    assert np.abs(fitted.apply(between) - bend(apply_homography(H, between))).max() < 5e-3


def test_derivatives_are_those_of_the_map():
    nodes = grid(17)
    fitted, _ = fit_grid_map(nodes, bend(apply_homography(H, nodes)))
    at, h = np.array([[2.0, -3.0]]), 1e-3
    local = expanded(fitted.apply, at)
    for s in np.array([[h, 0], [0, h], [h, -h]]):
        step = local.linear[0] @ s + local.quadratic[0] @ [s[0] ** 2, s[0] * s[1], s[1] ** 2]
        assert fitted.apply(at + s)[0] - fitted.apply(at)[0] == pytest.approx(step, abs=2e-7)


def test_wrong_stars_do_not_bend_the_map():
    nodes = grid(13)
    points = bend(apply_homography(H, nodes))
    points[[5, 60, 130]] += [8.0, -6.0]
    _, residuals = fit_grid_map(nodes, points)
    wrong = np.linalg.norm(residuals, axis=1) > 1.0
    assert np.flatnonzero(wrong).tolist() == [5, 60, 130]


def test_stars_next_to_known_ones_are_predicted_to_a_fraction_of_a_pixel():
    nodes = grid(7)
    points = bend(apply_homography(H, nodes))
    h = fit_homography(nodes, points)
    wanted = np.column_stack([np.full(7, 4.0), np.arange(-3.0, 4.0)])
    assert np.abs(predict_locally(h, nodes, points, wanted) - bend(apply_homography(H, wanted))).max() < 0.3


def test_stars_on_one_line_still_predict_their_neighbours():
    nodes = grid(7)[:7]
    points = bend(apply_homography(H, nodes))
    wanted = nodes + np.array([0.0, 1.0])
    assert np.abs(predict_locally(H, nodes, points, wanted) - bend(apply_homography(H, wanted))).max() < 1.0
