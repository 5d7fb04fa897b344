"""The focus as one number over the travel of the ring, its curve, and the best so far."""

import numpy as np
import pytest

from bench.extras.pages.align.focus import edge_width_px
from bench.extras.pages.align.focus_curve import FocusCurve
from calib.stars.quick import find_stars_quickly
from simulators.optics.picture import TARGET
from tests.support.live_slices import bench, fired, seen


def width_of(image):
    return edge_width_px(image, find_stars_quickly(image, TARGET), TARGET)


def test_the_edge_width_falls_while_the_ring_is_turned_to_focus():
    shown = [seen(bench(circle_px=circle)) for circle in (20.0, 9.0, 0.0)]
    widths = [width_of(fired(share, level_percent=20.0)) for share in shown]
    assert None not in widths
    assert (np.diff(widths) < -0.1).all(), widths
    assert widths[-1] == pytest.approx(0.7, abs=0.15)
    assert widths[0] == pytest.approx(20.0 / 4.0, abs=0.8)


def test_without_stars_and_tag_there_is_no_number():
    image = np.ones((720, 1280), np.float32)
    image[300:400, 500:700] = 0.0
    assert width_of(image) is None


def curve_of(widths):
    curve = FocusCurve()
    for number, width in enumerate(widths):
        curve.add(float(number), width)
    return curve


def test_the_best_is_no_single_outlier():
    curve = curve_of([3.0, 2.5, 2.0, 0.4, 1.5, 1.2, 1.1, 1.0, 1.4, 1.9, 2.4, 2.9])
    assert curve.best_px == pytest.approx(1.1)
    assert curve_of([0.7, 0.7]).best_px is None


def test_the_best_begins_anew_and_the_curve_stays():
    curve = curve_of([0.7] * 5)
    curve.begin_best()
    assert (len(curve.points()), curve.best_px) == (5, None)


def test_edges_that_look_sharp_in_dim_light_do_not_count():
    width_px = width_of(fired(seen(bench(circle_px=13.0)), level_percent=10.0))
    assert width_px == pytest.approx(13.0 / 4.0, abs=0.6)  # the thresholded edges of stars have 2 px
