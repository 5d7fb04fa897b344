"""Who holds the controls of the align page, and the list of what happened."""

import pytest

from bench.base.errors import ControlRefused
from bench.extras.pages.align.owners import BEAT_LIMIT_S, Owners
from bench.extras.pages.align.session import KEPT, SHOWN, Happened


class Clock:
    now_s = 100.0

    def __call__(self):
        return self.now_s


@pytest.fixture
def owners():
    clock = Clock()
    made = Owners(lambda: None, clock)
    made.clock = clock
    return made


def test_controls_of_a_closed_page_are_free(owners):
    owners.enter("one", "")
    owners.enter("two", "")
    assert owners.leave("one")
    assert owners.as_data()["holder"] == ""
    owners.require("two")
    assert owners.holder == "two"


def test_a_page_with_two_streams_is_open_until_both_close(owners):
    owners.enter("one", "")
    owners.enter("one", "")  # a reload opens the new stream before the old one is seen to be closed
    assert not owners.leave("one")
    owners.require("one")
    assert owners.leave("one")


def test_a_page_is_lost_when_its_heartbeat_is_old(owners):
    owners.enter("one", "")
    owners.clock.now_s += BEAT_LIMIT_S
    assert not owners.is_lost("one")
    owners.clock.now_s += 0.01
    assert owners.is_lost("one")
    owners.beat("one")
    assert not owners.is_lost("one")
    assert owners.is_lost("never seen")


def test_pages_closed_long_ago_are_forgotten_and_their_number_is_bounded(owners):
    for number in range(300):
        owners.enter(f"page-{number}", "")
        owners.leave(f"page-{number}")
        owners.clock.now_s += 10
    assert owners.as_data()["pages"] == {}
    owners.clock.now_s += 1000
    for number in range(200):
        owners.enter(f"more-{number}", "")
    with pytest.raises(ControlRefused, match="Too many pages"):
        owners.enter("one-more", "")


# ---------------------------------------------------------------- what happened


@pytest.fixture
def listed():
    now_s, changes = [100.0], []
    return Happened(lambda: changes.append(True), lambda: now_s[0]), now_s, changes


def test_steps_in_a_row_are_one_entry(listed):
    happened, now_s, changes = listed
    for text, topic in (
        ("a 1.", "a"),
        ("a 2.", "a"),
        ("b.", "b"),
        ("a 3.", "a"),
        ("said.", ""),
        ("said.", ""),
    ):
        happened.say(text, topic)
    assert [entry["text"] for entry in happened.as_data()] == ["a 2.", "b.", "a 3.", "said."]
    assert [entry["number"] for entry in happened.as_data()] == [2, 3, 4, 6]  # nothing is said twice in a row
    assert len(changes) == 6
    happened.say("a 4.", "a")
    now_s[0] += 30.0
    happened.say("a 5.", "a")
    assert [entry["text"] for entry in happened.as_data()][-2:] == ["a 4.", "a 5."]


def test_only_the_newest_are_shown(listed):
    happened = listed[0]
    for number in range(KEPT + 10):
        happened.say(f"{number}.")
    assert [entry["text"] for entry in happened.as_data()] == [
        f"{n}." for n in range(KEPT + 10 - SHOWN, KEPT + 10)
    ]
