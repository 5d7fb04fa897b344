"""Pixels near the edges of stars, compared with SciPy's interpolation of the edge map, pixel by pixel."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from calib.stars.centring import SYMMETRY_REACH
from calib.stars.edge_gathering import gather_edge_pixels
from calib.stars.grid_map import LocalMap
from calib.stars.printed_star import blurred_edge_map, render_star
from calib.target import StarTarget

TARGET = StarTarget()
PITCH = 24.0
EDGES = blurred_edge_map(render_star(TARGET, PITCH), TARGET.segments, PITCH, 0.75)
random = np.random.default_rng(11)
LEVELS = random.integers(0, 40, (80, 90), dtype=np.uint8)
LINEAR = np.array([[22.0, -8.0], [9.0, 23.0]])
QUADRATIC = np.array([[0.3, -0.2, 0.1], [0.05, 0.2, -0.3]])


def place_and_tau(centre):
    """Return place and tau of each pixel, (3, H W), by the equations of `gather_edge_pixels`."""
    rows, columns = np.mgrid[0 : LEVELS.shape[0], 0 : LEVELS.shape[1]]
    away = np.array([columns.ravel() - centre[0], rows.ravel() - centre[1]], float)
    u, v = np.linalg.inv(LINEAR) @ away
    u, v = np.linalg.inv(LINEAR) @ (away - QUADRATIC @ [u * u, u * v, v * v])
    at = [EDGES.half + v * EDGES.samples_per_pitch, EDGES.half + u * EDGES.samples_per_pitch]
    return np.array([u, v, map_coordinates(EDGES.tau.astype(float), at, order=1, mode="nearest")])


@pytest.mark.parametrize("centre", [(45.3, 40.6), (5.1, 41.2), (84.0, 75.5)])
def test_pixels_are_those_of_scipy(centre):
    """The last stars reach beyond the image."""
    local_map = LocalMap(LINEAR[None], QUADRATIC[None])
    found = gather_edge_pixels(LEVELS, np.array([centre]), local_map, EDGES)
    u, v, tau = place_and_tau(centre)
    slopes = [
        (place_and_tau(np.add(centre, step))[2] - place_and_tau(np.subtract(centre, step))[2]) / 2e-4
        for step in ([1e-4, 0.0], [0.0, 1e-4])
    ]
    used = (np.abs(tau) < EDGES.limit_px) & (np.abs(u) <= SYMMETRY_REACH) & (np.abs(v) <= SYMMETRY_REACH)
    expected = np.column_stack([u, v, tau, LEVELS.ravel(), *slopes])[used]
    fields = (found.u, found.v, found.tau, found.level, found.along_x, found.along_y)
    pixels = np.column_stack(fields).astype(float)
    assert len(pixels) == len(expected) == found.first[-1]
    a, b = (one[np.lexsort(one[:, :2].round(3).T)] for one in (pixels, expected))
    np.testing.assert_allclose(a[:, :4], b[:, :4], atol=2e-4)
    # The quadratic part of the map takes no part in the slopes, and they jump from sample to sample.
    assert np.median(np.abs(a[:, 4:] - b[:, 4:])) < 0.01
    assert np.mean(np.abs(a[:, 4:] - b[:, 4:]) > 0.1) < 0.02


def test_pixels_are_sorted_by_edges():
    found = gather_edge_pixels(
        LEVELS, np.array([[45.3, 40.6]]), LocalMap(LINEAR[None], QUADRATIC[None]), EDGES
    )
    edge = np.repeat(np.arange(TARGET.segments), np.diff(found.first))
    nearest = np.round(np.arctan2(found.v, found.u) / (2.0 * np.pi) * TARGET.segments) % TARGET.segments
    assert (edge == nearest).mean() > 0.97  # the edge map is sampled


def test_without_stars_there_are_no_pixels():
    found = gather_edge_pixels(
        LEVELS, np.zeros((0, 2)), LocalMap(np.zeros((0, 2, 2)), np.zeros((0, 2, 3))), EDGES
    )
    assert len(found.tau) == 0
