"""The frame of a plot: everything within the picture, the same unit on both axes where wanted, words escaped."""

import re
import subprocess
import sys

import numpy as np
import pytest

from bench.report.plot_frame import Key, Words, axes_in
from bench.report.plots import deviations_from_truth, regions, residual_vectors
from bench.report.svg_plot import Picture, Scale
from bench.report.view_picture import ViewPicture
from tests.unit.bench.report.structure import Structure


def framed(x=None, y=None, words=None, size=(280.0, 190.0), **more):
    picture = Picture(*size, "p", "a plot")
    axes = axes_in(picture, x or Scale(0, 10), y or Scale(0, 1), words or Words(("t",), "x", "y"), **more)
    return axes, picture


def views(count, names=None):
    points = np.random.default_rng(1).uniform(0, 100, (30, 2))
    return [
        ViewPicture((names or {}).get(n, f"pose {n}"), None, points, points - 0.1, np.arange(30))
        for n in range(count)
    ]


@pytest.mark.parametrize(
    "words", [Words(), Words(("a", "b"), "x", "y"), Words(keys=[Key("pose " * 5, "#123456")] * 6)]
)
@pytest.mark.parametrize("equal", ["", "shrink", "extend"])
def test_axes_and_their_words_lie_within_the_picture(words, equal):
    axes, picture = framed(Scale(-1e5, 1e5), Scale(2.0, -3.0), words, equal=equal)
    assert axes.left >= 0
    assert axes.top >= 0
    assert axes.left + axes.width <= picture.width
    assert axes.top + axes.height <= picture.height
    places = re.findall(r'<text x="([-\d.]+)" y="([-\d.]+)"', picture.svg())
    assert all(0 <= float(x) <= picture.width and 0 <= float(y) <= picture.height for x, y in places)


@pytest.mark.parametrize("equal", ["shrink", "extend"])
def test_both_axes_have_the_same_unit_if_that_is_wanted(equal):
    axes, _ = framed(Scale(-0.5, 1279.5), Scale(719.5, -0.5), equal=equal)
    (a, b), (c, d) = axes.at([(0, 0), (100, 100)])
    assert c - a == pytest.approx(d - b, abs=0.02)
    assert c > a
    assert d > b


def test_points_lie_where_the_scales_put_them():
    axes, picture = framed()
    np.testing.assert_allclose(axes.at([(0, 0)])[0], [axes.left, axes.top + axes.height], atol=0.005)
    np.testing.assert_allclose(axes.at([(10, 1)])[0], [axes.left + axes.width, axes.top], atol=0.005)
    axes.dots(np.empty((0, 2)), "#123456", 1.0)
    axes.dots([(10, 1)], "#123456", 1.0)
    assert picture.svg().count("#123456") == 1


def test_words_cannot_become_markup():
    evil = "</svg><script>\"'&"
    axes, picture = framed(words=Words((evil,), evil, evil, [Key(evil, "#000000")]))
    axes.text((1, 1), evil)
    picture.label = picture.about = evil
    found = Structure(picture.svg())
    assert (found.wrong, found.open) == ([], [])
    assert "script" not in found.tags


def test_a_picture_says_in_words_what_it_shows():
    picture = Picture(10, 10, "p", "short", "The mean is 3 px.")
    assert 'aria-label="short"' in picture.svg()
    assert "<desc>The mean is 3 px.</desc>" in picture.svg()


def test_a_high_sensor_keeps_its_shape():
    svg = regions(views(2), (480, 640))
    width, height = map(float, re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', svg).groups())
    assert height > 0.9 * width
    clip = re.search(r'<rect x="[\d.]+" y="[\d.]+" width="([\d.]+)" height="([\d.]+)"/></clipPath>', svg)
    assert float(clip[2]) / float(clip[1]) == pytest.approx(640 / 480, rel=0.01)


def test_long_names_of_poses_take_more_rows_and_many_poses_have_no_legend():
    wide = residual_vectors(views(6, dict.fromkeys(range(6), "a name of twenty-nine letters")), (100, 60))
    rows = {y for y, text in re.findall(r'y="([\d.]+)"[^>]*>([^<]*)<', wide) if text.startswith("a name")}
    assert len(rows) > 1
    assert ">pose 0<" not in residual_vectors(views(7), (100, 60))


def test_a_report_and_its_charts_load_no_library_that_draws():
    code = (
        "import sys; import bench.report.plots, bench.report.course, bench.report.batch_page,"
        " bench.report.control_chart, bench.compare.page, bench.report.trend_plots;"
        " print('matplotlib' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_deviations_lie_on_bands_of_one_and_two_standard_uncertainties():
    drawn = deviations_from_truth(["fx", "fy"], [0.5, -1.0])
    wide, narrow = (
        [tuple(map(float, corner.split())) for corner in re.split("[LMZ]", path) if corner]
        for path in re.findall(r'<path d="([^"]*Z)"', drawn)
    )
    for band in (wide, narrow):
        assert len(set(band)) == 4
        assert len({x for x, _ in band}) == len({y for _, y in band}) == 2
    widths = [max(x for x, _ in band) - min(x for x, _ in band) for band in (wide, narrow)]
    assert widths[0] == pytest.approx(2 * widths[1], abs=0.03)
