"""What a supervisor makes of a worker that cannot even be started."""

from datetime import UTC, datetime

import pytest

from bench.base.clock import BenchClock, VirtualClock
from bench.base.linux_process import waits_for_disk
from bench.batch.supervisor import OUT_OF_MEMORY, QUIET_S, SILENCE_S, _watch, supervise
from bench.run.heartbeat import Heartbeat


def test_a_worker_that_cannot_be_started_has_failed_and_the_night_may_go_on(tmp_path):
    run = tmp_path / "run"
    end = supervise([str(tmp_path / "none")], run, tmp_path / "log", BenchClock(), lambda _: None)
    assert (end.how, end.unsafe) == ("failed", ())
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


def test_a_lack_of_memory_is_an_error_of_the_worker(tmp_path, monkeypatch):
    kills = iter([3, 4])
    monkeypatch.setattr("bench.batch.supervisor.out_of_memory_kills", lambda: next(kills))
    (tmp_path / "run").mkdir()
    end = supervise(
        ["sh", "-c", "kill -KILL $$"], tmp_path / "run", tmp_path / "log", BenchClock(), lambda _: None
    )
    assert (end.why, end.outside) == (OUT_OF_MEMORY, False)


@pytest.mark.parametrize(("states", "waits"), [("SR", False), ("SD", True), ("", False)])
def test_a_process_with_a_thread_that_waits_for_the_disk_is_not_taken_to_hang(tmp_path, states, waits):
    for number, state in enumerate(states):
        task = tmp_path / "7" / "task" / str(7 + number)
        task.mkdir(parents=True)
        (task / "stat").write_text(f"{7 + number} (a ) name) {state} 1 7 7")
    assert waits_for_disk(7, tmp_path) is waits


@pytest.mark.parametrize(("on_disk", "how_long_s"), [(False, SILENCE_S), (True, QUIET_S)])
def test_silence_is_borne_for_longer_where_the_disk_may_be_its_cause(
    tmp_path, monkeypatch, on_disk, how_long_s
):
    clock = VirtualClock(datetime(2026, 3, 1, tzinfo=UTC))
    monkeypatch.setattr("bench.batch.supervisor.waits_for_disk", lambda _pid: on_disk)
    signs = [Heartbeat(1, 1, 0)]
    monkeypatch.setattr("bench.batch.supervisor.read_heartbeat", lambda _folder: signs[-1])

    class Silent:
        def gone(self):
            signs.append(Heartbeat(7, 1, 1))
            return False

    silent_s = _watch(Silent(), tmp_path, clock)
    assert how_long_s < silent_s < how_long_s + 1
