"""A computer that is too busy for a run: journaled, told in the status, and not more than once a minute."""

from bench.records.events import Event
from bench.records.history import History, apply_entry
from bench.records.journal import Entry
from bench.run.heartbeat import REPEAT_S, WINDOW_S, BusyWatch
from bench.run.status import line_text


class LateClock:
    """A clock of a computer that loses a share of the time."""

    def __init__(self, share):
        self.now_s = 0.0
        self._share = share

    def monotonic(self):
        return self.now_s

    def lateness(self):
        return {"lost_s": self._share * self.now_s, "load": 19.5}


class Log:
    """Keeps what is written."""

    def __init__(self):
        self.lines = []

    def write(self, event, **data):
        self.lines.append((event, data))


def lines_of(share, seconds):
    clock, log = LateClock(share), Log()
    watch = BusyWatch(log, clock)
    while clock.now_s < seconds:
        clock.now_s += 0.5
        watch.look()
    return log.lines


def test_a_computer_that_is_late_for_half_of_the_time_is_too_busy():
    lines = lines_of(0.5, REPEAT_S + WINDOW_S - 1.0)
    assert [event for event, _ in lines] == [Event.COMPUTER_BUSY]
    data = lines[0][1]
    assert (data["late_s"], data["window_s"]) == (5.0, 10.0)
    text = line_text(Entry(1, "2026-03-01T12:02:06.000000Z", 1.0, Event.COMPUTER_BUSY, data, "", ""))
    assert text.startswith("12:02:06 UTC  this computer is too busy: it was 5.0 s late in 10 s (load 19.5)")


def test_it_is_said_again_after_a_minute():
    assert len(lines_of(0.5, 2 * REPEAT_S)) == 2


def test_a_computer_that_is_a_little_late_is_not_too_busy():
    assert lines_of(0.2, 300.0) == []


def test_the_history_keeps_what_was_said_last():
    history = History()
    lateness = {"lost_s": 5.0, "counts": [1]}
    line = {"late_s": 5.0, "window_s": 10.0, "lateness": lateness}
    apply_entry(history, Entry(1, "2026-01-01T00:00:00Z", 1.0, Event.COMPUTER_BUSY, line, "", ""))
    assert history.busy == "5.0 s late in 10 s"
    assert history.lateness == lateness
