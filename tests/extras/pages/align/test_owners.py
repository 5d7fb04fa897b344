"""Who holds the controls of the align page, and the list of what happened."""

import pytest

from bench.extras.pages.align.owners import BEAT_LIMIT_S, Owners
from bench.extras.pages.align.session import Happened


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


# ---------------------------------------------------------------- what happened


@pytest.fixture
def listed():
    now_s, changes = [100.0], []
    return Happened(lambda: changes.append(True), lambda: now_s[0]), now_s, changes
