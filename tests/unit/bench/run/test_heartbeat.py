"""Heartbeats: written while the work makes progress, not while it stalls; a computer that is too busy is told."""

import os
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

import pytest

from bench.base.clock import BenchClock
from bench.base.supervised import SUPERVISOR
from bench.record.events import ComputerBusy, Event
from bench.record.journal_line import Entry
from bench.run import heartbeat
from bench.run.heartbeat import (
    CONTROL,
    HEARTBEAT,
    REPEAT_S,
    WINDOW_S,
    BusyWatch,
    Heartbeat,
    HeartbeatWriter,
    open_process,
    read_heartbeat,
)
from bench.run.processes import start_ticks
from bench.run.status import line_text


class StandingClock(BenchClock):
    """A clock that nobody has asked for so long."""

    quiet = 0.0

    def inactive_s(self):
        return self.quiet


class Pulse(HeartbeatWriter):
    """Heartbeats of work that entered its state long ago."""

    def __init__(self, folder, monkeypatch):
        self.ahead_s, self.bench_clock = 0.0, StandingClock()
        times = SimpleNamespace(
            monotonic=lambda: time.monotonic() + self.ahead_s, monotonic_ns=time.monotonic_ns
        )
        monkeypatch.setattr(heartbeat, "time", times)
        super().__init__(folder, self.bench_clock)
        self.ahead_s = 10_000.0

    def since_long(self, state, quiet_s):
        """Entered a state long ago; nothing has asked the clock for so long."""
        self.entering(state)
        self.ahead_s += 10_000.0
        self.bench_clock.quiet = quiet_s


@pytest.fixture
def pulse(tmp_path, monkeypatch):
    (tmp_path / CONTROL).mkdir()
    return Pulse(tmp_path, monkeypatch)


def moments(pulse, folder):
    """Beat once; whether a sign was given."""
    before = read_heartbeat(folder)
    time.sleep(0.001)
    pulse.beat()
    return read_heartbeat(folder) != before


@pytest.mark.parametrize("state", ["slewing", "parking"])
def test_no_heartbeat_is_written_for_a_driver_that_never_returns(pulse, tmp_path, state):
    pulse.since_long(state, 0.6)
    assert not moments(pulse, tmp_path)


@pytest.mark.parametrize("state", ["checking", "holding"])
def test_work_in_a_slow_state_may_take_long_but_not_for_ever(pulse, tmp_path, state):
    pulse.since_long(state, 500.0)
    assert moments(pulse, tmp_path)
    pulse.bench_clock.quiet = 601.0
    assert not moments(pulse, tmp_path)


def test_the_stall_limit_begins_anew_with_each_state(pulse, tmp_path):
    pulse.bench_clock.quiet = 60.0  # a long calculation lies behind
    pulse.entering("parking")
    assert moments(pulse, tmp_path)


@pytest.mark.parametrize("on_disk", [True, False])
def test_waiting_for_the_disk_is_not_a_stall(pulse, tmp_path, monkeypatch, on_disk):
    pulse.since_long("recording", 30.0)
    monkeypatch.setattr(heartbeat, "thread_waits_for_disk", lambda *_: on_disk)
    assert moments(pulse, tmp_path) is on_disk


def test_a_wait_and_a_check_of_the_work_count_as_activity():
    clock = BenchClock()
    time.sleep(0.05)
    watcher = threading.Thread(target=clock.monotonic)  # not the work's own asking
    watcher.start()
    watcher.join()
    for asks in (clock.monotonic, clock.check):
        assert clock.inactive_s() >= 0.05
        asks()
        assert clock.inactive_s() < 0.05
        time.sleep(0.05)


@pytest.mark.parametrize("text", [b"", b"1 2", b"1 2 x", b"1 2 3 4", b"\xff\xfe"])
def test_a_truncated_heartbeat_is_none(tmp_path, text):
    (tmp_path / CONTROL).mkdir()
    (tmp_path / CONTROL / HEARTBEAT).write_bytes(text)
    assert read_heartbeat(tmp_path) is None


def test_only_the_process_that_wrote_the_heartbeat_is_opened():
    started = start_ticks(os.getpid())
    own = open_process(Heartbeat(os.getpid(), started, 0))
    assert own is not None
    os.close(own)
    another_of_that_number = Heartbeat(os.getpid(), started + 1, 0)
    assert open_process(another_of_that_number) is None
    with subprocess.Popen([sys.executable, "-c", ""]) as process:
        process.wait()
    assert open_process(Heartbeat(process.pid, 1, 0)) is None


def test_a_heartbeat_is_whole_at_any_moment_so_that_a_process_stopped_while_it_writes_is_seen_to_hang(
    tmp_path,
):
    (tmp_path / CONTROL).mkdir()
    writer = HeartbeatWriter(tmp_path, BenchClock())
    writer.beat()
    beats = threading.Thread(target=lambda: [writer.beat() for _ in range(500)])
    beats.start()
    seen = []
    while beats.is_alive():
        seen.append(read_heartbeat(tmp_path))
    assert len(set(seen)) > 1
    assert None not in seen


@pytest.mark.parametrize(
    ("supervisor", "told"),
    [(str(os.getppid()), [False, True, False]), ("999999999", [True, False, False]), ("1x", [False] * 3)],
    ids=["ends later", "had ended before", "none"],
)
def test_a_lost_supervisor_is_reported_once(monkeypatch, tmp_path, supervisor, told):
    monkeypatch.setenv(SUPERVISOR, supervisor)
    pulse = HeartbeatWriter(tmp_path, BenchClock())
    before = pulse.supervisor_is_gone()
    monkeypatch.setattr(os, "getppid", lambda: 1)
    assert [before, pulse.supervisor_is_gone(), pulse.supervisor_is_gone()] == told


# ---------------------------------------------------------------- a busy computer


def watched():
    """A watch of a computer, the computer's clock, and the lines that the watch writes."""
    clock, lines = SimpleNamespace(now_s=0.0, lateness=lambda: {"lost_s": 0.0}), []
    clock.monotonic = lambda: clock.now_s
    log = SimpleNamespace(write=lambda event, **data: lines.append((event, data)))
    return BusyWatch(log, clock), clock, lines


def lines_of(share, seconds):
    """The lines about a computer that loses a share of its time."""
    watch, clock, lines = watched()
    clock.lateness = lambda: {"lost_s": share * clock.now_s, "load": 19.5}
    while clock.now_s < seconds:
        clock.now_s += 0.5
        watch.look()
    return lines


def test_a_computer_that_is_late_for_half_of_the_time_is_too_busy():
    lines = lines_of(0.5, REPEAT_S + WINDOW_S - 1.0)
    assert [event for event, _ in lines] == [ComputerBusy]
    data = lines[0][1]
    assert (data["late_s"], data["window_s"]) == (5.0, 10.0)
    text = line_text(Entry(1, "2026-03-01T12:02:06.000000Z", 1.0, Event.COMPUTER_BUSY, data, "", ""))
    assert all(fact in text for fact in ("12:02:06 UTC", "5.0 s late in 10 s", "load 19.5"))


def test_a_busy_computer_that_sleeps_is_told_at_once():
    watch, clock, lines = watched()
    clock.now_s, clock.lateness = WINDOW_S, lambda: {"lost_s": 5.0}
    watch.look()
    clock.now_s += WINDOW_S + 14.0
    clock.lateness = lambda: {"lost_s": 24.0, "longest_s": 14.0}
    watch.look()
    assert [data["lateness"].get("longest_s") for _, data in lines] == [None, 14.0]
    clock.now_s += WINDOW_S
    clock.lateness = lambda: {"lost_s": 34.0, "longest_s": 14.0}
    watch.look()
    assert len(lines) == 2


@pytest.mark.parametrize(("share", "seconds", "told"), [(0.5, 2 * REPEAT_S, 2), (0.2, 300.0, 0)])
def test_a_busy_computer_is_told_again_after_a_minute_and_one_that_is_a_little_late_never(
    share, seconds, told
):
    assert len(lines_of(share, seconds)) == told


def test_a_computer_that_was_suspended_since_the_run_began_was_late_for_so_long(monkeypatch):
    asleep_s = [100.0]  # Since the computer was started
    monkeypatch.setattr(BenchClock, "asleep_s", lambda _clock: asleep_s[0])
    clock = BenchClock()
    assert clock.lateness()["longest_s"] < 100.0
    asleep_s[0] += 1800.0
    lateness = clock.lateness()
    assert lateness["longest_s"] == 1800.0
    assert lateness["lost_s"] >= 1800.0
