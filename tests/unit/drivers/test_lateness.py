"""Lateness of a busy computer: measured, told, and no reason to give a wrong remedy."""

from itertools import count
from types import SimpleNamespace

import pytest
from turned_clock import TurnedClock

from drivers import lateness
from drivers.clock import SystemClock
from drivers.errors import ReplyTimeout
from drivers.lateness import PERIOD_S, Deadline, Lateness, follow_clock, follow_no_clock
from drivers.link import TRIES, TRIES_WHEN_LATE, repeat
from tests.unit.drivers.conftest import CountedLink


def test_a_delay_is_counted_while_it_lasts_and_once_afterwards():
    now = TurnedClock()
    measured = Lateness(now.monotonic)
    now.now_s = 2.02
    assert measured.lost_s() == pytest.approx(2.0)
    measured.woken()
    assert measured.lost_s() == pytest.approx(2.0)
    now.now_s += 0.021  # one millisecond late: as on an idle computer
    measured.woken()
    summary = measured.summary()
    assert (summary["lost_s"], summary["longest_s"]) == (2.0, 2.0)


def test_a_deadline_does_not_count_what_this_process_could_not_use():
    now = TurnedClock()
    measured = Lateness(now.monotonic)
    deadline = Deadline(1.0, now_s=now.monotonic, lateness=measured)
    now.now_s = 5.0
    assert deadline.left_s() == pytest.approx(1.0 - 0.02)
    assert deadline.starved_s() == pytest.approx(4.98)
    measured.woken()
    for _ in range(50):
        now.now_s += 0.02
        measured.woken()
    assert deadline.left_s() < 0


def test_a_deadline_follows_the_process_that_simulates_the_device_but_not_for_ever():
    now, lived = TurnedClock(), TurnedClock()
    measured = Lateness(now.monotonic)
    follow_clock("there", lived.monotonic)
    try:
        deadline = Deadline(1.0, "there", now_s=now.monotonic, lateness=measured)
        for _ in range(500):  # 10 s, of which the other process could use 0.1 s
            now.now_s += 0.02
            measured.woken()
        lived.now_s = 0.1
        assert deadline.left_s() > 0.8
        assert deadline.starved_s() > 9.0
        for _ in range(2000):  # it is stopped
            now.now_s += 0.02
            measured.woken()
        assert deadline.left_s() < 0
    finally:
        follow_no_clock("there")


def test_a_slow_device_on_an_idle_computer_is_not_blamed_on_the_computer():
    now = TurnedClock()
    measured = Lateness(now.monotonic)
    deadline = Deadline(1.0, now_s=now.monotonic, lateness=measured)
    for _ in range(100):
        now.now_s += 0.021
        measured.woken()
    assert deadline.left_s() < 0
    assert deadline.starved_s() == 0.0


@pytest.fixture
def ask_a_silent_port(scripted):
    def ask():
        link = CountedLink(scripted([(b"?\n", b"")]), SystemClock())
        with pytest.raises(ReplyTimeout) as caught:
            link.exchange(b"?\n", lambda reader: reader.read_line(), deadline_s=0.01)
        return caught.value

    return ask


def test_a_time_out_on_a_busy_computer_says_so(monkeypatch, ask_a_silent_port):
    late = SimpleNamespace(lost_s=count(40.0, 40.0).__next__)
    monkeypatch.setattr(lateness, "own_lateness", lambda: late)
    monkeypatch.setattr(lateness, "MOST_STRETCH_S", 0.1)
    error = ask_a_silent_port()
    assert "too busy" in error.what
    assert "baud rate" not in str(error)
    assert error.late_s > 0


def test_a_time_out_on_an_idle_computer_names_the_line(monkeypatch, ask_a_silent_port):
    monkeypatch.setattr(lateness, "own_lateness", lambda: Lateness(TurnedClock().monotonic))
    error = ask_a_silent_port()
    assert "baud rate" in error.remedy
    assert error.late_s == 0.0


@pytest.mark.parametrize(
    ("tries", "late_s", "asked"), [(TRIES, 0.0, TRIES), (TRIES, 2.0, TRIES + TRIES_WHEN_LATE), (1, 2.0, 1)]
)
def test_what_is_repeated_is_repeated_more_often_when_late_but_a_motion_never(tries, late_s, asked):
    calls = []

    def ask():
        calls.append(1)
        raise ReplyTimeout("no reply.", late_s=late_s)

    with pytest.raises(ReplyTimeout):
        repeat(ask, tries=tries)
    assert len(calls) == asked


def test_a_makers_software_that_holds_the_interpreter_is_no_busy_computer():
    """Opening a camera of 2.6 s was told as "this computer is too busy"."""
    times = iter([0.0, 0.1, 2.7, 2.75, 3.0])
    measured = Lateness(lambda: next(times))
    with measured.interpreter_held():
        measured.woken()  # 0.1 s
        assert measured.lost_s() == 0.0
    measured.woken()  # 2.75 s, due 2.72
    assert measured.longest_s == pytest.approx(0.03)
    assert measured.lost_s() == pytest.approx(0.03 + 0.23)


def test_a_sleep_is_told_before_the_thread_that_measures_it_has_run():
    clock = TurnedClock()
    lateness = Lateness(clock.monotonic)
    clock.now_s = 14.0 + PERIOD_S
    assert lateness.summary()["longest_s"] == pytest.approx(14.0)
