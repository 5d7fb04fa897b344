"""Heartbeats: written while the work makes progress, not while it stalls, and by one process only."""

import os
import subprocess
import sys
import threading
import time

import pytest

from bench.base.clock import BenchClock
from bench.base.linux_process import start_ticks, thread_waits_for_disk
from bench.base.work_moment import NOT_SHARED, read_work_moment
from bench.run import heartbeat
from bench.run.heartbeat import (
    CONTROL,
    HEARTBEAT,
    SLOW_STATES,
    SUPERVISOR,
    Heartbeat,
    HeartbeatWriter,
    open_process,
    read_heartbeat,
)
from bench.run.machine import STATES


class StandingClock(BenchClock):
    """A clock that nobody has asked for so long."""

    quiet = 0.0

    def inactive_s(self):
        return self.quiet


@pytest.fixture
def pulse(tmp_path):
    (tmp_path / CONTROL).mkdir()
    pulse = HeartbeatWriter(tmp_path, StandingClock())
    pulse._since_s -= 10_000.0  # the state was entered long ago
    return pulse


def moments(pulse, folder):
    """Beat once; whether a sign was given."""
    before = read_heartbeat(folder)
    time.sleep(0.001)
    pulse.beat()
    return read_heartbeat(folder) != before


def test_heartbeats_are_written_while_the_work_waits_or_checks(pulse, tmp_path):
    assert moments(pulse, tmp_path)
    assert moments(pulse, tmp_path)


@pytest.mark.parametrize("state", ["slewing", "recording", "homing", "aborting", "parking"])
def test_no_heartbeat_is_written_for_a_driver_that_never_returns(pulse, tmp_path, state):
    pulse._state, pulse._clock.quiet = state, 0.6
    assert not moments(pulse, tmp_path)


@pytest.mark.parametrize("state", ["checking", "choosing", "solving", "reporting", "preflight", "holding"])
def test_work_in_a_slow_state_may_take_long_but_not_for_ever(pulse, tmp_path, state):
    pulse._state, pulse._clock.quiet = state, 500.0
    assert moments(pulse, tmp_path)
    pulse._clock.quiet = 601.0
    assert not moments(pulse, tmp_path)


def test_the_stall_limit_begins_anew_with_each_state(pulse, tmp_path):
    pulse._clock.quiet = 60.0  # a long calculation lies behind
    pulse.entering("parking")
    assert moments(pulse, tmp_path)


@pytest.mark.parametrize(("letter", "given"), [("D", True), ("S", False), ("R", False)])
def test_waiting_for_the_disk_is_not_a_stall(pulse, tmp_path, monkeypatch, letter, given):
    pulse._state, pulse._clock.quiet = "recording", 30.0
    stat = tmp_path / "12" / "task" / "12" / "stat"
    stat.parent.mkdir(parents=True)
    stat.write_text(f"12 (python (x)) {letter} 1 1 1")
    monkeypatch.setattr(
        heartbeat, "thread_waits_for_disk", lambda *_: thread_waits_for_disk(12, 12, tmp_path)
    )
    assert moments(pulse, tmp_path) is given


@pytest.mark.parametrize(("waited_s", "given"), [(0.0, False), (1.0, False), (2.6, True)])
def test_work_that_only_waits_for_a_processor_has_not_stalled(pulse, tmp_path, monkeypatch, waited_s, given):
    times, moment = [(1.0, 5.0)], [1000.0]
    monkeypatch.setattr(heartbeat, "processor_times_s", lambda *_: times[-1])
    monkeypatch.setattr(heartbeat.time, "monotonic", lambda: moment[-1])
    pulse._state, pulse._since_s = "recording", 0.0
    assert moments(pulse, tmp_path)
    moment.append(1003.0)
    pulse._clock.quiet = 3.0
    times.append((1.1, 5.0 + waited_s))
    assert moments(pulse, tmp_path) is given
    moment.append(1063.0)
    pulse._clock.quiet = 63.0
    times.append((1.1, 65.0))
    assert not moments(pulse, tmp_path)  # not for ever


def test_a_progress_that_seems_to_go_back_is_no_error(pulse, tmp_path, monkeypatch):
    moment = [1000.0]
    monkeypatch.setattr(heartbeat, "processor_times_s", lambda *_: (1.0, 5.0))
    monkeypatch.setattr(heartbeat.time, "monotonic", lambda: moment[-1])
    pulse._state, pulse._since_s = "recording", 0.0
    for now_s, quiet_s in ((1000.0, 0.0), (1000.1, 0.0), (1000.2, 0.0), (1000.3, 0.25), (1000.4, 0.4)):
        moment.append(now_s)
        pulse._clock.quiet = quiet_s
        assert moments(pulse, tmp_path)


def test_waits_before_the_last_progress_do_not_count(pulse, tmp_path, monkeypatch):
    times, moment = [(1.0, 5.0)], [1000.0]
    monkeypatch.setattr(heartbeat, "processor_times_s", lambda *_: times[-1])
    monkeypatch.setattr(heartbeat.time, "monotonic", lambda: moment[-1])
    pulse._state, pulse._since_s = "recording", 0.0
    for second in range(5):
        moment.append(1000.0 + second)
        times.append((1.0, 5.0 + second))
        assert moments(pulse, tmp_path)
    moment.append(1005.0)
    pulse._clock.quiet = 1.0
    assert not moments(pulse, tmp_path)


def test_a_clock_is_inactive_only_while_nothing_waits_or_checks():
    clock = BenchClock()
    time.sleep(0.05)
    assert clock.inactive_s() >= 0.05
    clock.check()
    assert clock.inactive_s() < 0.05


def test_a_shielded_wait_reads_the_time_and_counts_as_activity():
    clock = BenchClock()
    clock._asked_s -= 100.0
    watcher = threading.Thread(target=clock.monotonic)  # not the work's own asking
    watcher.start()
    watcher.join()
    assert clock.inactive_s() >= 100.0
    clock.monotonic()
    assert clock.inactive_s() < 100.0


@pytest.mark.parametrize("text", [b"", b"1 2", b"1 2 3", b"1 2 x 4", b"1 2 3 4 5 6", b"\xff\xfe"])
def test_a_truncated_heartbeat_is_none(tmp_path, text):
    (tmp_path / CONTROL).mkdir()
    (tmp_path / CONTROL / HEARTBEAT).write_bytes(text)
    assert read_heartbeat(tmp_path) is None


def test_the_heartbeat_of_an_earlier_version_is_read(tmp_path):
    (tmp_path / CONTROL).mkdir()
    (tmp_path / CONTROL / HEARTBEAT).write_bytes(b"1 2 3 4")
    assert read_heartbeat(tmp_path) == Heartbeat(1, 2, 3, 4, NOT_SHARED)


def test_each_use_of_the_clock_can_be_read_by_another_process(tmp_path):
    (tmp_path / CONTROL).mkdir()
    clock = BenchClock()
    pulse = HeartbeatWriter(tmp_path, clock)
    pulse.entering("recording")
    pulse.beat()
    sign = read_heartbeat(tmp_path)
    read = (
        f"import sys; from bench.base.work_moment import *; print(read_work_moment({sign.pid}, {sign.work}))"
    )
    told = subprocess.run([sys.executable, "-c", read], capture_output=True, text=True, check=True).stdout
    assert float(told) == read_work_moment(sign.pid, sign.work)
    for use in (clock.monotonic, clock.check, lambda: clock.sleep(0.0)):
        before = read_work_moment(sign.pid, sign.work)
        use()
        assert read_work_moment(sign.pid, sign.work) > before
    pulse.entering("checking")
    assert read_work_moment(sign.pid, sign.work) is None


def test_a_number_that_stands_for_another_file_by_now_is_not_read():
    readable, writable = os.pipe()
    os.write(writable, bytes(16))
    assert read_work_moment(os.getpid(), readable) is None
    assert len(os.read(readable, 99)) == 16
    os.close(readable)
    os.close(writable)
    assert read_work_moment(os.getpid(), readable) is None


def test_a_system_without_files_in_memory_shares_nothing(tmp_path, monkeypatch):
    monkeypatch.delattr(os, "memfd_create")
    (tmp_path / CONTROL).mkdir()
    pulse = HeartbeatWriter(tmp_path, BenchClock())
    pulse.entering("recording")
    pulse.beat()
    assert read_heartbeat(tmp_path).work == NOT_SHARED
    assert read_work_moment(os.getpid(), NOT_SHARED) is None


def test_states_that_compute_for_long_are_slow_states():
    """A new state must be put on one side: work with devices uses its clock, or it computes."""
    with_devices = {
        "homing",
        "lighting",
        "slewing",
        "settling",
        "recording",
        "backing_off",
        "waiting",
        "parking",
    }
    ends = {"aborting", "aborted", "failed"}
    assert set(STATES) - SLOW_STATES == with_devices | ends


def test_only_the_process_that_wrote_the_heartbeat_is_opened():
    started = start_ticks(os.getpid())
    own = open_process(Heartbeat(os.getpid(), started, 0))
    assert own is not None
    os.close(own)
    assert (
        open_process(Heartbeat(os.getpid(), started + 1, 0)) is None
    )  # another one, later, of the same number
    with subprocess.Popen([sys.executable, "-c", ""]) as process:
        process.wait()
    assert open_process(Heartbeat(process.pid, 1, 0)) is None


def test_a_lost_supervisor_is_reported_once(monkeypatch, tmp_path):
    monkeypatch.setenv(SUPERVISOR, str(os.getppid()))
    pulse = HeartbeatWriter(tmp_path, BenchClock())
    assert not pulse.supervisor_is_gone()
    monkeypatch.setattr(os, "getppid", lambda: 1)
    assert [pulse.supervisor_is_gone(), pulse.supervisor_is_gone()] == [True, False]


@pytest.mark.parametrize("told", ["", "1x", "999999999"])
def test_a_process_without_a_supervisor_loses_none(monkeypatch, tmp_path, told):
    monkeypatch.setenv(SUPERVISOR, told)
    pulse = HeartbeatWriter(tmp_path, BenchClock())
    monkeypatch.setattr(os, "getppid", lambda: 1)
    assert not pulse.supervisor_is_gone()
