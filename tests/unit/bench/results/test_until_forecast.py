"""How many poses an `until` is expected to need, before anything moves."""

import pytest

from bench.plan.plan import load_documents, make_plan
from bench.results.next_pose import expected_courses

GOAL = "sequence.steps.1.until."


def courses(sequence="until_good", station="simulated", **settings):
    paths = {GOAL + name: str(value) for name, value in settings.items()}
    return expected_courses(make_plan(*load_documents(sequence, station, paths)))


def test_on_an_ideal_bench_the_first_poses_suffice():
    (course,) = courses(station="simulated_ideal")
    assert course.poses == 3
    assert course.reached["expanded_fx_px"] < 2.5
    assert course.text == (
        "Expected: about 3 poses until U(fx) is at most 2.5 px and U at the corners at most 1.5 px."
    )


def test_on_the_simulated_bench_a_smaller_goal_takes_more_poses_but_fewer_than_allowed():
    (course,) = courses(expanded_fx_px=1.8)
    assert 4 <= course.poses <= 15
    assert course.to_dict()["poses"] == course.poses


def test_a_goal_below_a_stated_term_is_refused_with_its_name():
    (course,) = courses(expanded_fx_px=0.5)
    assert course.poses is None
    assert "the goal of 0.5 px for U(fx) cannot be reached" in course.text
    assert "scale and eccentricity of the gimbal" in course.text


def test_a_goal_that_the_poses_allowed_do_not_reach_is_said():
    (course,) = courses(station="simulated_ideal", expanded_fx_px=0.001)
    assert course.poses is None
    assert course.text.startswith("Expected: ")
    assert "25 poses do not suffice" in course.text or "cannot be reached" in course.text


@pytest.mark.parametrize("sequence", ["three_pose", "nine_pose"])
def test_a_plan_without_such_a_step_expects_none(sequence):
    assert courses(sequence) == []
