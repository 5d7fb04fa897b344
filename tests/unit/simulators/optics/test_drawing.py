"""Shares of pixels that a shape covers."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from inner_loops import from_python
from scipy.special import ndtr
from slow_cases import slow

from calib.target import StarTarget
from simulators.optics.drawing import add_edge as inner_add_edge
from simulators.optics.drawing import empty_picture, join_cells, spread_kernel
from simulators.optics.outlines import black_polygons

add_edge = from_python(inner_add_edge)

PLACE = st.tuples(st.floats(-3.0, 12.0), st.floats(-3.0, 9.0))


def areas(ring, columns=9, rows=6):
    """Share of each cell that a ring covers."""
    steps = empty_picture(columns, rows, 1, 0)
    for (x0, y0), (x1, y1) in zip(ring, [*ring[1:], ring[0]], strict=True):
        add_edge(steps, x0, y0, x1, y1, 1.0)
    return np.cumsum(steps.astype(float), axis=1)[:, :-1]


def clipped_area(ring, left, top):
    """Signed area of a ring inside a cell, by an independent method: Sutherland-Hodgman clipping."""
    for axis, bound, side in ((0, left, 1), (0, left + 1, -1), (1, top, 1), (1, top + 1, -1)):
        kept = []
        for a, b in zip(ring, [*ring[1:], *ring[:1]], strict=True):
            inside_a, inside_b = side * (a[axis] - bound) >= 0, side * (b[axis] - bound) >= 0
            if inside_a:
                kept.append(a)
            if inside_a != inside_b:
                s = (bound - a[axis]) / (b[axis] - a[axis])
                kept.append(tuple(p + s * (q - p) for p, q in zip(a, b, strict=True)))
        ring = kept
    return sum(a[0] * b[1] - a[1] * b[0] for a, b in zip(ring, [*ring[1:], *ring[:1]], strict=True)) / 2


@given(ring=st.tuples(PLACE, PLACE, PLACE))
def test_every_cell_gets_its_share_of_a_triangle(ring):
    expected = [[clipped_area(list(ring), x, y) for x in range(9)] for y in range(6)]
    np.testing.assert_allclose(areas(ring), np.array(expected), atol=2e-5)


def test_edges_on_the_borders_of_cells_lose_nothing():
    expected = np.zeros((6, 9))
    expected[1:4, 2:5] = 1.0
    np.testing.assert_array_equal(areas([(2, 1), (5, 1), (5, 4), (2, 4)]), expected)


@pytest.mark.parametrize("cells", [2, 5])
@pytest.mark.parametrize("sigma_px", [0.0, 0.5, 0.7, 3.0])
def test_the_point_spread_is_as_wide_as_said(sigma_px, cells):
    kernel = spread_kernel(sigma_px, cells)
    at = (np.arange(kernel.size) - (kernel.size - 1) / 2) / cells
    assert kernel.sum() == pytest.approx(1.0)
    # With the cells' own width, and that of the pixel.
    assert kernel @ at**2 + 1 / (12 * cells**2) == pytest.approx(sigma_px**2 + 1 / 12, rel=0.02)


@pytest.mark.parametrize(("cells", "bound"), [(2, 0.009), (4, 0.0025)])
def test_an_edge_through_the_point_spread_is_an_error_function_wherever_it_stands(cells, bound):
    kernel = spread_kernel(0.7, cells)
    margin, worst = math.ceil((kernel.size / cells - 1) / 2), 0.0
    light = np.ones((3 + 2 * margin, 20 + 2 * margin + 1), np.float32)
    for place in np.linspace(9.0, 10.0, 21):  # in pixels, from the left edge of the first
        steps = empty_picture(20, 2, cells, margin)
        ring = [((place + margin) * cells, -1.0), (1e3, -1.0), (1e3, 1e3), ((place + margin) * cells, 1e3)]
        for (x0, y0), (x1, y1) in zip(ring, [*ring[1:], ring[0]], strict=True):
            add_edge(steps, x0, y0, x1, y1, 1.0)
        row = join_cells(steps, light, (0.0, 1.0), kernel, cells, margin)[0]
        fine = np.arange(0.005, 1.0, 0.01)
        expected = ndtr((np.arange(20)[:, None] + fine - place) / 0.7).mean(axis=1)
        worst = max(worst, np.abs(row - expected).max())
    assert worst < bound


@pytest.mark.parametrize(
    "target",
    [StarTarget(), slow(StarTarget(17, 24, 5.0, 12, tag_square=(6, 9))), slow(StarTarget(segments=4))],
)
def test_the_outline_is_black_where_the_print_is(target):
    polygons = black_polygons(target)
    rng = np.random.default_rng(3)
    low, high = np.array(target.tag_centre_mm) - 20.0, np.array(target.tag_centre_mm) + 20.0
    points = rng.uniform(low, high, (20_000, 2))
    edges = np.roll(polygons, -1, axis=1) - polygons
    near = np.abs(polygons.mean(axis=1) - target.tag_centre_mm).max(axis=1) < 25.0
    covered = np.zeros(len(points), int)
    for corners, along in zip(polygons[near], edges[near], strict=True):
        from_corner = points[:, None] - corners
        covered += (along[:, 0] * from_corner[..., 1] - along[:, 1] * from_corner[..., 0] >= 0.0).all(axis=1)
    np.testing.assert_array_equal(covered, 1 - target.reflectance(*points.T))
