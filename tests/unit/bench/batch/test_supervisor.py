"""What a supervisor makes of a worker that cannot be started, is killed, is silent, or gets no processor."""

import os
import signal
from datetime import UTC, datetime

import pytest

from bench.base.clock import BenchClock, VirtualClock
from bench.batch.supervisor import QUIET_S, SILENCE_S, adopt, supervise
from bench.run.heartbeat import Heartbeat
from bench.run.processes import waits_for_disk


def test_a_worker_that_cannot_be_started_has_failed_and_the_night_may_go_on(tmp_path):
    run = tmp_path / "run"
    end = supervise([str(tmp_path / "none")], run, tmp_path / "log", BenchClock(), lambda _: None)
    assert (end.how, end.unsafe) == ("failed", [])
    assert "could not be started" in end.why
    (tmp_path / "folder").mkdir()
    assert supervise(["true"], run, tmp_path / "folder", BenchClock(), lambda _: None).how == "failed"


@pytest.mark.parametrize(
    ("name", "outside"), [("KILL", True), ("TERM", True), ("HUP", True), ("SEGV", False), ("ABRT", False)]
)
def test_a_signal_from_outside_is_told_from_an_error_of_the_worker(tmp_path, name, outside):
    command = ["sh", "-c", f"ulimit -c 0; kill -{name} $$; sleep 9"]
    end = supervise(command, tmp_path / "run", tmp_path / "log", BenchClock(), lambda _: None)
    assert (end.how, end.why, end.outside) == ("died", f"by SIG{name}", outside)


@pytest.mark.parametrize(("states", "waits"), [("SR", False), ("SD", True), ("", False)])
def test_a_process_with_a_thread_that_waits_for_the_disk_is_not_taken_to_hang(tmp_path, states, waits):
    for number, state in enumerate(states):
        task = tmp_path / "7" / "task" / str(7 + number)
        task.mkdir(parents=True)
        (task / "stat").write_text(f"{7 + number} (a ) name) {state} 1 7 7")
    assert waits_for_disk(7, tmp_path) is waits


class SilentProcess:
    """A worker of another supervisor that holds its run folder and gives no sign of life after the first."""

    def __init__(self, monkeypatch, on_disk=False, load=1.0):
        self.alive = True
        monkeypatch.setattr("bench.batch.supervisor.waits_for_disk", lambda _pid: on_disk)
        monkeypatch.setattr("bench.batch.supervisor.read_heartbeat", lambda _folder: Heartbeat(7, 1, 1))
        monkeypatch.setattr("bench.batch.supervisor.is_locked", lambda _folder: self.alive)
        monkeypatch.setattr(
            "bench.batch.supervisor.open_process", lambda _sign: os.open(os.devnull, os.O_RDONLY)
        )
        monkeypatch.setattr("bench.batch.supervisor.signal.pidfd_send_signal", self.receive)
        monkeypatch.setattr("bench.batch.supervisor.os.getloadavg", lambda: (load, 0.0, 0.0))
        monkeypatch.setattr("bench.batch.supervisor.os.cpu_count", lambda: 2)

    def receive(self, _process, number):
        self.alive &= number != signal.SIGABRT


@pytest.mark.parametrize(("on_disk", "how_long_s"), [(False, SILENCE_S), (True, QUIET_S)])
def test_silence_is_borne_for_longer_where_the_disk_may_be_its_cause(
    tmp_path, monkeypatch, on_disk, how_long_s
):
    worker = SilentProcess(monkeypatch, on_disk)
    end = adopt(tmp_path, VirtualClock(datetime(2026, 3, 1, tzinfo=UTC)), lambda _: None)
    assert (end.how, end.outside, worker.alive) == ("hung", False, False)
    assert how_long_s < end.noticed_s < how_long_s + 1
    assert end.why.endswith(f" {end.noticed_s:.1f} s")


def test_the_end_of_a_silent_worker_tells_a_very_busy_computer_as_a_possible_cause(tmp_path, monkeypatch):
    SilentProcess(monkeypatch, load=44.0)
    end = adopt(tmp_path, VirtualClock(datetime(2026, 3, 1, tzinfo=UTC)), lambda _: None)
    assert "load 44" in end.why
    assert end.outside  # so it uses up no attempt of the run
