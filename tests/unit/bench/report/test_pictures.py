"""The report's pictures and plots show stars and residuals where and as they are."""

import re

import numpy as np
import pytest
from report_sample import SMALL

from bench.measure.view_picture import ViewPicture
from bench.report.plots import residual_vectors


def test_each_pose_is_pictured_with_its_stars_where_they_are(data, html):
    pictures = re.findall(r'<svg class="pose".*?</svg></svg>', html, re.DOTALL)
    assert len(pictures) == 3
    for view, picture in zip(data.views, pictures, strict=True):
        rings = np.array(re.findall(r"M(-?[\d.]+) (-?[\d.]+)a7 7", picture), float) + np.array([7, 0])
        np.testing.assert_allclose(rings, view.detected, atol=0.006)
        crosses = np.array(re.findall(r"M(-?[\d.]+) (-?[\d.]+)h8", picture), float) + np.array([4, 0])
        np.testing.assert_allclose(crosses, view.reprojected, atol=0.006)


def test_pixel_centres_lie_at_integers_in_the_pictures(html):
    places = re.findall(r'<image x="([^"]*)" y="([^"]*)" width="320" height="180"', html)
    assert {(float(x), float(y)) for x, y in places} == {(-0.5, -0.5)}


def test_the_star_with_the_largest_residual_is_looked_at_closely(data, html):
    pictures = re.findall(r'<svg class="pose".*?</svg></svg>', html, re.DOTALL)
    for view, picture in zip(data.views, pictures, strict=True):
        corners = re.findall(r'<svg class="close-up"[^>]* viewBox="([-\d.]+) ([-\d.]+) 36 36"', picture)
        middle, worst = np.array(corners, float) + 18
        lengths = np.linalg.norm(view.detected - view.reprojected, axis=1)
        np.testing.assert_allclose(worst, view.detected[lengths.argmax()], atol=0.006)
        distances = np.linalg.norm(view.detected - (159.5, 89.5), axis=1)
        np.testing.assert_allclose(middle, view.detected[distances.argmin()], atol=0.006)


def test_residuals_are_drawn_from_the_star_in_their_direction():
    residual = np.array([[0.1, 0.0], [0.0, 0.05]])
    detected = np.array([[100.0, 100.0], [200.0, 50.0]])
    view = ViewPicture("a", np.zeros((180, 320), np.uint8), detected, detected - residual, np.arange(2))
    svg = residual_vectors([view], SMALL)
    assert "magnified 100 times" in svg
    paths = re.findall(r'<path d="([^"]*)" [^>]*stroke="#0072b2"', svg)
    dots, lines = [path for path in paths if path.count("M") == 2]
    assert len(re.findall(r"M[\d.]+ [\d.]+h0", dots)) == 2
    strokes = [tuple(map(float, s)) for s in re.findall(r"M([\d.]+) ([\d.]+)L([\d.]+) ([\d.]+)", lines)]
    (right,) = [s for s in strokes if s[2] > s[0] + 1 and abs(s[3] - s[1]) < 0.1]
    (down,) = [s for s in strokes if s[3] > s[1] + 1 and abs(s[2] - s[0]) < 0.1]
    assert right[2] - right[0] == pytest.approx(2 * (down[3] - down[1]), rel=0.02)


@pytest.mark.parametrize(("last_px", "grey"), [(0.1, 0), (0.5, 1)])
def test_stars_that_have_lost_their_weight_are_grey(last_px, grey):
    residual = np.tile([0.1, 0.0], (9, 1))
    residual[8] = 0.0, last_px
    detected = np.column_stack([np.linspace(20.0, 300.0, 9), np.full(9, 90.0)])
    view = ViewPicture("a", np.zeros((180, 320), np.uint8), detected, detected - residual, np.arange(9))
    svg = residual_vectors([view], SMALL)
    drawn = re.findall(r'<path d="((?:M[^"hL]*h0)+)"[^>]*class="[^"]*muted', svg)
    assert sum(path.count("h0") for path in drawn) == grey
    assert ("beyond 3.5 sigma" in svg) == bool(grey)
