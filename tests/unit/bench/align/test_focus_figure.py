"""The focus figure over the whole travel of the ring, its course, and the tilt of the field."""

import numpy as np
import pytest

from bench.align.focus import FocusFigures, measure_focus, tilt_of
from bench.align.focus_course import FocusCourse
from calib.stars.beam import find_beam
from calib.stars.quick import find_stars_quickly
from simulators.optics.picture import TARGET
from tests.support.live_slices import bench, fired, seen


def figures_of(image):
    return measure_focus(image, find_beam(image), find_stars_quickly(image, TARGET), TARGET)


def test_the_edge_width_falls_while_the_ring_is_turned_to_focus():
    widths = [
        figures_of(fired(seen(bench(circle_px=circle)), level_percent=20.0)).edge_width_px
        for circle in (20.0, 9.0, 0.0)
    ]
    assert None not in widths
    assert (np.diff(widths) < -0.1).all(), widths
    assert widths[-1] == pytest.approx(0.7, abs=0.15)
    assert widths[0] == pytest.approx(20.0 / 4.0, abs=0.8)


def test_regions_show_a_tilted_field():
    sharp, soft = seen(bench(psf_px=0.6)), seen(bench(psf_px=1.1))
    right = np.linspace(0.0, 1.0, 1280, dtype=np.float32)[None, :] > 0.55
    figures = figures_of(fired(np.where(right, soft, sharp)))
    assert figures.regions["top right"] > figures.regions["top left"] + 0.2
    assert "on the right" in figures.tilt
    assert figures.tilt.index("right") < figures.tilt.index("left")


def test_tilt_needs_both_sides():
    assert tilt_of({"top left": 2.0, "top right": None, "bottom left": 2.0, "bottom right": None}) == ""
    assert "at the top" in tilt_of(
        {"top left": 2.0, "top right": 2.0, "bottom left": 1.0, "bottom right": 1.0}
    )


def test_without_stars_the_sharpness_remains():
    image = np.ones((720, 1280), np.float32)
    image[300:400, 500:700] = 0.0
    figures = figures_of(image)
    assert (figures.edge_width_px, figures.blur_circle_px) == (None, None)
    assert figures.sharpness > 0.0


def test_the_course_keeps_the_best_but_no_single_outlier():
    course = FocusCourse(kept_s=10.0)
    for time_s, width in enumerate([3.0, 2.5, 2.0, 0.4, 1.5, 1.2, 1.1, 1.0, 1.4, 1.9, 2.4, 2.9]):
        course.add(float(time_s), FocusFigures(edge_width_px=width, sharpness=1.0 / width))
    assert course.best_edge_width_px == pytest.approx(1.1)
    assert course.best_sharpness == pytest.approx(1.0 / 1.1)
    course.forget()
    assert course.best_edge_width_px is None
    assert course.best_sharpness is None


def course_of(widths):
    course = FocusCourse()
    for number, width in enumerate(widths):
        course.add(0.2 * number, FocusFigures(edge_width_px=width))
    return course


def test_a_ring_turned_beyond_the_best_is_turned_back():
    noise = np.random.default_rng(1).normal(0.0, 0.01, 30)
    course = course_of(0.68 + noise)
    assert course.better_before_px() is None
    for number in range(4):
        course.add(10.0 + number, FocusFigures(edge_width_px=0.80 + float(noise[number])))
    assert course.better_before_px() == pytest.approx(0.68, abs=0.02)
    course.turned()  # elsewhere in the field, edges have another width
    course.add(20.0, FocusFigures(edge_width_px=0.80))
    assert course.better_before_px() is None


def test_noise_is_no_reason_to_turn_back():
    course = course_of(0.8 + np.random.default_rng(2).normal(0.0, 0.08, 60))
    assert course.better_before_px() is None


@pytest.mark.parametrize("period_s", [0.1, 1.3, 20.0])
@pytest.mark.parametrize(
    ("widths", "expected"),
    [
        ((4, 4, 4, 4, 3.5, 3, 2.5, 2, 1.5), "better"),
        ((4,) * 5 + (1.5,) * 5, "better"),
        ((1, 1, 1, 1, 1.5, 2, 2, 3), "worse"),
        ((3, 3, 3, 2, 1, 1, 1, 2, 2, 2), "worse"),
        ((2,) * 8, ""),
        ((1.07, 1.0, 0.98, 1.04, 1.06, 0.97) * 3, ""),  # noise in dim light
    ],
)
def test_what_the_last_turn_has_done_is_said_at_any_speed_and_until_the_next_turn(widths, expected, period_s):
    course = FocusCourse()
    for number, width in enumerate((*widths, *[widths[-1]] * 40)):
        course.add(period_s * number, FocusFigures(edge_width_px=float(width)))
        if number >= len(widths) + 2:
            assert course.trend() == expected


@pytest.mark.parametrize("seed", range(40))
def test_turning_by_what_is_said_ends_at_the_best_place_within_some_turns(seed):
    rng = np.random.default_rng(seed)
    best, slope = rng.uniform(-30.0, 60.0), rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 0.4)
    course, place, turn, turns = FocusCourse(), 0.0, float(rng.choice([-10.0, 10.0])), 0
    while True:
        width = float(np.hypot(0.65, slope * (place - best)))
        for number in range(5):
            noisy = width * (1.0 + 0.02 * float(rng.normal()))
            course.add(float(10 * turns + number), FocusFigures(edge_width_px=noisy))
        if width <= 1.0:
            break
        ratio = course.turn_on()
        turn *= 1.0 if ratio is None else ratio * float(rng.uniform(0.85, 1.15))  # by hand, so not exactly
        place, turns = place + turn, turns + 1
        assert turns < 10
    assert turns <= 7


def rested(course, *figures, start_s=0.0):
    """The course after the ring has stood at each place for five pictures, one each second."""
    for place, (width, detail) in enumerate(figures):
        for number in range(5):
            now = FocusFigures(edge_width_px=width, coarse_detail=detail)
            course.add(start_s + 5 * place + number, now)
    return course


@pytest.mark.parametrize(
    ("places", "least", "most"),
    [
        ([(None, 0.05), (1.1, None), (1.4, None)], -0.75, -0.35),  # better, then worse: the best is between
        ([(3.0, None), (1.1, None), (1.4, None)], -0.85, -0.35),
        ([(1.1, None), (1.4, None)], -3.0, -2.0),  # only worse: the best may be far behind
        ([(3.0, None), (2.0, None)], 1.3, 2.6),
        ([(None, 0.03), (None, 0.05)], 1.5, 1.5),
        ([(None, 0.05), (None, 0.03)], -2.0, -2.0),
        ([(2.0, None), (None, 0.03)], -3.0, -1.0),  # the stars are lost
    ],
)
def test_how_far_to_turn_weighs_both_sides_of_each_place(places, least, most):
    assert least <= rested(FocusCourse(), *places).turn_on() <= most


@pytest.mark.parametrize("places", [[(None, 0.03), (None, 0.05)], [(3.0, None), (2.0, None)]])
def test_at_the_stop_of_the_ring_the_way_is_back(places):
    course = rested(FocusCourse(), *places)
    assert course.turn_on() > 0.0
    course.at_stop()
    assert course.turn_on() < 0.0
    assert course.judged(FocusFigures()).at_stop
    rested(course, places[-1], places[0], start_s=20.0)  # turned away from the stop
    assert not course.judged(FocusFigures()).at_stop


@pytest.mark.parametrize("period_s", [0.3, 6.0])
def test_a_stop_that_is_reported_before_the_turn_to_it_is_seen_holds_for_it(period_s):
    course = rested(FocusCourse(), (None, 0.03), (2.6, None))
    course.at_stop()
    for number, width in enumerate([2.0, 1.4, 1.4, 1.4]):  # the turn, as a slow or a fast computer sees it
        course.add(10.0 + period_s * number, FocusFigures(edge_width_px=width))
    assert course.judged(FocusFigures()).at_stop
    assert -0.5 < course.turn_on() < -0.15  # on both sides of the best place


def test_a_stop_before_any_turn_was_seen_is_known():
    course = rested(FocusCourse(), (None, 0.03))
    course.at_stop()
    assert (course.judged(FocusFigures()).at_stop, course.turn_on()) == (True, None)


def test_the_time_without_a_seen_turn_and_the_turning_itself_are_told():
    course = FocusCourse()
    for number in range(10):
        course.add(float(number), FocusFigures(edge_width_px=2.0))
    assert course.judged(FocusFigures()).unchanged_s == pytest.approx(8.0)
    course.add(10.0, FocusFigures(edge_width_px=1.6))
    assert course.judged(FocusFigures()).turning
    for number in range(3):
        course.add(11.0 + number, FocusFigures(edge_width_px=1.2))
    shown = course.judged(FocusFigures())
    assert (shown.turning, shown.trend) == (False, "better")
    assert shown.unchanged_s < 2.0


def test_a_turn_of_the_camera_or_a_change_of_the_light_begins_anew():
    course = course_of([4.0] * 5 + [3.0] * 5)
    assert (course.trend(), course.turn_on()) == ("better", pytest.approx(2.9, abs=0.3))
    course.turned()
    assert (course.trend(), course.turn_on()) == ("", None)


def test_the_trend_by_coarse_detail_alone():
    course = FocusCourse()
    for number in range(16):
        course.add(0.4 * number, FocusFigures(coarse_detail=0.1 + 0.02 * min(max(0, number - 4), 8)))
    assert course.trend() == "better"
    assert course.turn_on() == 1.5  # the best place is far: farther each time
    assert FocusCourse().trend() == ""


def test_edges_that_look_sharp_in_dim_light_do_not_count():
    figures = figures_of(fired(seen(bench(circle_px=13.0)), level_percent=10.0))
    assert figures.regions["centre"] < 2.2  # thresholded edges of stars
    assert figures.edge_width_px == pytest.approx(13.0 / 4.0, abs=0.6)
