"""The list of what happened: order, steps in a row, and its length."""

import pytest

from bench.align.session import KEPT, SHOWN, Happened


@pytest.fixture
def listed():
    now_s, told = [100.0], []
    return Happened(lambda: told.append(True), lambda: now_s[0]), now_s, told


def test_steps_in_a_row_are_one_entry(listed):
    happened, now_s, told = listed
    for text, topic in (
        ("a 1.", "a"),
        ("a 2.", "a"),
        ("b.", "b"),
        ("a 3.", "a"),
        ("said.", ""),
        ("said.", ""),
    ):
        happened.say(text, topic)
    assert [one["text"] for one in happened.as_data()] == ["a 2.", "b.", "a 3.", "said."]
    assert [one["number"] for one in happened.as_data()] == [2, 3, 4, 6]  # nothing is said twice in a row
    assert len(told) == 6
    happened.say("a 4.", "a")
    now_s[0] += 30.0
    happened.say("a 5.", "a")
    assert [one["text"] for one in happened.as_data()][-2:] == ["a 4.", "a 5."]


def test_only_the_newest_are_shown(listed):
    happened = listed[0]
    for number in range(KEPT + 10):
        happened.say(f"{number}.")
    assert [one["text"] for one in happened.as_data()] == [
        f"{n}." for n in range(KEPT + 10 - SHOWN, KEPT + 10)
    ]
