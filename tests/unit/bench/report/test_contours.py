"""Outlines of the part of a map that reaches a level: areas, edges, holes, and another program's answer."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.report.maps import outlines

X, Y = np.arange(0.0, 161.0, 4.0), np.arange(0.0, 91.0, 3.0)


def area(points):
    x, y = points.T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def total(found):
    return abs(sum(area(one.points) for one in found))


def test_a_plane_is_cut_where_it_reaches_the_level():
    slope = np.tile(X, (len(Y), 1))
    (half,) = outlines(X, Y, slope, 50.5)
    assert total([half]) == pytest.approx((160 - 50.5) * 90)
    (line,) = half.lines()
    np.testing.assert_allclose(line[:, 0], 50.5)
    assert sorted(line[[0, -1], 1].tolist()) == [0.0, 90.0]


def test_a_disc_within_the_map_is_one_closed_line_and_outside_of_it_a_hole():
    distance = np.hypot(X[None] - 80, Y[:, None] - 45)
    (disc,) = outlines(X, Y, -distance, -30.0)
    assert total([disc]) == pytest.approx(np.pi * 900, rel=0.01)
    (line,) = disc.lines()
    np.testing.assert_array_equal(line[0], line[-1])
    outside = outlines(X, Y, distance, 30.0)
    assert len(outside) == 2
    assert total(outside) == pytest.approx(160 * 90 - np.pi * 900, rel=0.01)


def test_a_map_that_reaches_the_level_everywhere_is_whole_and_without_contours():
    (whole,) = outlines(X, Y, np.ones((len(Y), len(X))), 1.0)
    assert total([whole]) == pytest.approx(160 * 90)
    assert whole.lines() == []
    assert outlines(X, Y, np.zeros((len(Y), len(X))), 1.0) == []


def test_where_the_map_is_not_known_nothing_is_inside():
    values = np.ones((len(Y), len(X)))
    values[10:20, 10:20] = np.nan
    found = outlines(X, Y, values, 0.5)
    assert total(found) == pytest.approx(160 * 90 - (X[20] - X[9]) * (Y[20] - Y[9]), rel=0.01)
    assert [one.lines() for one in found] == [[], []]
    assert all(np.isfinite(one.points).all() for one in found)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.floats(-1.0, 1.0))
def test_another_program_finds_the_same_area(seed, level):
    contourpy = pytest.importorskip("contourpy")
    values = np.random.default_rng(seed).normal(size=(len(Y), len(X)))
    theirs = contourpy.contour_generator(X, Y, values, fill_type="OuterOffset", corner_mask=True)
    points, offsets = theirs.filled(level, 1e9)
    rings = [p[a:b] for p, o in zip(points, offsets, strict=True) for a, b in pairwise(o.tolist())]
    assert total(outlines(X, Y, values, level)) == pytest.approx(
        abs(sum(map(area, rings))), rel=1e-9, abs=1e-9
    )
