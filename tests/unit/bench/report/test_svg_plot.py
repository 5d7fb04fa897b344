"""Charts of a report: their frame, their scales, and the outlines of maps."""

import re
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from bench.report.contours import outlines
from bench.report.svg_plot import Key, Picture, Words, axes_in
from bench.report.svg_scale import Scale, log_ticks, tick_labels, ticks

# ---------------------------------------------------------------- the frame


def framed(x=None, y=None, words=None, size=(280.0, 190.0), **more):
    picture = Picture(*size, "p", "a plot")
    axes = axes_in(picture, x or Scale(0, 10), y or Scale(0, 1), words or Words(("t",), "x", "y"), **more)
    return axes, picture


@pytest.mark.parametrize(
    "words", [Words(), Words(("a", "b"), "x", "y"), Words(keys=[Key("pose " * 5, "#123456")] * 6)]
)
@pytest.mark.parametrize("equal", [False, True])
def test_axes_and_their_words_lie_within_the_picture(words, equal):
    axes, picture = framed(Scale(-1e5, 1e5), Scale(2.0, -3.0), words, equal=equal)
    corners = [(axes.left, axes.top), (axes.left + axes.width, axes.top + axes.height)]
    places = re.findall(r'<text x="([-\d.]+)" y="([-\d.]+)"', picture.svg())
    for x, y in [*corners, *places]:
        assert 0 <= float(x) <= picture.width
        assert 0 <= float(y) <= picture.height


def test_points_lie_where_the_scales_put_them():
    axes, picture = framed()
    np.testing.assert_allclose(axes.at([(0, 0)])[0], [axes.left, axes.top + axes.height], atol=0.005)
    np.testing.assert_allclose(axes.at([(10, 1)])[0], [axes.left + axes.width, axes.top], atol=0.005)
    axes.dots(np.empty((0, 2)), "#123456", 1.0)
    axes.dots([(10, 1)], "#123456", 1.0)
    assert picture.svg().count("#123456") == 1


# ---------------------------------------------------------------- values along an axis

FINITE = st.floats(-1e6, 1e6)


@given(FINITE, st.floats(1e-3, 1e6), st.integers(2, 12))
@example(1e-05, 40_001.0, 2)  # one number alone: 0, next to the begin of the range
@example(1.0, 400_001.0, 2)  # the round number next to it, 500,000, lies outside
def test_ticks_are_few_round_numbers_within_the_range(low, span, most):
    places = ticks(low, low + span, most)
    assert 1 <= len(places) <= most + 1
    step = places[1] - places[0] if len(places) > 1 else span
    assert all(low - 1e-6 * step - 1e-9 <= value <= low + span + 1e-6 * step + 1e-9 for value in places)
    if len(places) > 1:
        assert float(f"{step:.0e}") == pytest.approx(step, rel=1e-6)
        assert len(set(tick_labels(places))) == len(places)


def test_a_range_that_is_upside_down_has_its_first_value_at_the_bottom():
    rows = Scale(719.5, -0.5)
    np.testing.assert_allclose(rows.share([719.5, 359.5, -0.5]), [0, 0.5, 1])
    assert [label for _, label in rows.chosen_ticks(4)] == ["0", "200", "400", "600"]


def test_a_logarithmic_axis_spreads_ratios_evenly_and_has_round_numbers():
    np.testing.assert_allclose(Scale(1, 100, "log").share([1, 10, 100]), [0, 0.5, 1])
    assert log_ticks(0.7, 30) == [1, 2, 5, 10, 20]
    assert log_ticks(1e-4, 1e4, 5)[0] == 1e-4
    assert set(np.log10(log_ticks(1e-4, 1e4, 5)) % 1) == {0}
    assert log_ticks(3.1, 3.9) == [3.2, 3.4000000000000004, 3.6, 3.8000000000000003]
    assert [label for _, label in Scale(3.1, 3.9, "log").chosen_ticks(5)] == ["3.2", "3.4", "3.6", "3.8"]


# ---------------------------------------------------------------- outlines of the part of a map that reaches a level

X, Y = np.arange(0.0, 161.0, 4.0), np.arange(0.0, 91.0, 3.0)


def area(points):
    x, y = points.T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def total(lines):
    return abs(sum(area(outline.points) for outline in lines))


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
