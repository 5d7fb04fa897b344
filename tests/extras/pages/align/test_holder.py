"""Which page holds the controls of the align page."""

import pytest
from turned_clock import TurnedClock

from bench.base.errors import ControlRefused
from bench.extras.pages.align.holder import BEAT_LIMIT_S, Holder


@pytest.fixture
def holder():
    clock = TurnedClock(100.0)
    made = Holder(clock.monotonic)
    made.clock = clock
    return made


def test_controls_of_a_closed_page_are_free(holder):
    holder.enter("one")
    holder.enter("two")
    with pytest.raises(ControlRefused, match="Another page"):
        holder.require("two")
    assert not holder.leave("two")
    assert holder.leave("one")
    assert (holder.page, holder.is_lost) == ("", True)
    holder.require("two")
    assert (holder.page, holder.is_lost) == ("two", False)


def test_a_page_that_comes_back_keeps_its_controls(holder):
    holder.enter("one")
    holder.enter("one")  # a reload opens the new stream before the old one is seen to be closed
    assert holder.leave("one")
    holder.beat("one")
    assert (holder.page, holder.is_lost) == ("one", False)


def test_a_page_is_lost_when_its_heartbeat_is_old_and_keeps_the_controls_for_some_seconds(holder):
    assert not holder.is_lost
    holder.enter("one")
    holder.clock.now_s += BEAT_LIMIT_S
    assert not holder.is_lost
    holder.clock.now_s += 0.01
    assert (holder.page, holder.is_lost) == ("one", True)
    holder.beat("two")
    assert holder.is_lost
    holder.beat("one")
    assert not holder.is_lost
    holder.clock.now_s += 6.0
    assert holder.page == ""


def test_taking_over_says_whether_another_page_had_the_controls(holder):
    assert not holder.take("one")
    assert not holder.take("one")
    assert holder.take("two")
