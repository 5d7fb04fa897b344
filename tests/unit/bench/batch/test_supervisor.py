"""What a supervisor makes of a worker that cannot be started, is killed, is silent, or gets no processor."""

import signal
from datetime import UTC, datetime

import pytest

from bench.base.clock import BenchClock, VirtualClock
from bench.base.linux_process import processor_times_s, thread_is_ready, waits_for_disk
from bench.batch.endless_computing import EndlessComputing
from bench.batch.starvation import Starvation
from bench.batch.supervisor import OUT_OF_MEMORY, QUIET_S, SILENCE_S, Silence, _watch, supervise
from bench.run.heartbeat import Heartbeat


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
    if signal.getsignal(getattr(signal, f"SIG{name}")) == signal.SIG_IGN:
        pytest.skip(f"SIG{name} is ignored here, as under nohup, and so by every process that is started")
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

    silence = _watch(Silent(), tmp_path, clock)
    assert how_long_s < silence.silent_s < how_long_s + 1
    assert not silence.is_starved


class Kernel:
    """What the kernel tells of the threads of a silent worker, as time goes on."""

    def __init__(self, clock, computed, waited, state="R"):
        self.clock, self.computed, self.waited, self.state = clock, computed, waited, state

    def times_s(self, _pid, _thread, _proc=None):
        now_s = self.clock.monotonic()
        return self.computed * now_s, self.waited * now_s

    def is_ready(self, _pid, _thread, _proc=None):
        return self.state == "R"


@pytest.mark.parametrize(
    ("computed", "waited", "state", "noticed_s"),
    [
        (0.0, 0.0, "S", 3.7),  # sleeps: a driver that never returns, a deadlock
        (0.0, 0.0, "T", 3.7),  # stopped
        (1.0, 0.0, "R", 3.7),  # computes without end on an idle computer
        (0.1, 0.1, "S", 4.0),  # a busy computer, and it sleeps most of the time
        (0.02, 0.98, "R", 30.9),  # ready, and others have the processors
        (0.0, 0.0, "R", 30.3),  # the same, in one wait that the kernel has not counted yet
    ],
)
def test_a_worker_that_waits_for_a_processor_only_does_not_hang(
    tmp_path, monkeypatch, computed, waited, state, noticed_s
):
    clock = VirtualClock(datetime(2026, 3, 1, tzinfo=UTC))
    kernel = Kernel(clock, computed, waited, state)
    monkeypatch.setattr(
        "bench.batch.supervisor.Starvation", lambda: Starvation(kernel.times_s, kernel.is_ready)
    )
    monkeypatch.setattr("bench.batch.supervisor.waits_for_disk", lambda _pid: False)
    signs = [Heartbeat(1, 1, 0, 1)]
    monkeypatch.setattr("bench.batch.supervisor.read_heartbeat", lambda _folder: signs[-1])

    class Silent:
        def gone(self):
            signs.append(Heartbeat(7, 1, 1, 8))
            return False

    silence = _watch(Silent(), tmp_path, clock)
    assert silence.silent_s == pytest.approx(noticed_s, abs=0.3)
    end = silence.end()
    assert end.how == "hung"
    assert end.outside is silence.is_starved is (noticed_s > 30)
    assert ("too busy" in end.why) is end.outside
    assert ("gave no sign of life" in end.why) is not end.outside


@pytest.mark.parametrize(
    ("computed", "moves", "noticed_s"),
    [
        (1.0, True, 3.6),  # computes without end on an idle computer
        (0.13, True, 3.6),  # the same beside 15 processes on two cores
        (0.04, True, 10.4),  # the same beside 44
        (0.003, True, 30.4),  # it gets no processor
        (1.0, False, 30.4),  # it uses its clock: only the signs of life do not come
    ],
)
def test_a_driver_that_computes_without_end_is_known_by_its_processor_time(
    tmp_path, monkeypatch, computed, moves, noticed_s
):
    clock = VirtualClock(datetime(2026, 3, 1, tzinfo=UTC))
    kernel = Kernel(clock, computed, 1.0)
    monkeypatch.setattr(
        "bench.batch.supervisor.Starvation", lambda: Starvation(kernel.times_s, kernel.is_ready)
    )
    monkeypatch.setattr(
        "bench.batch.supervisor.EndlessComputing",
        lambda: EndlessComputing(kernel.times_s, lambda *_: 1.0 if moves else clock.monotonic()),
    )
    monkeypatch.setattr("bench.batch.supervisor.waits_for_disk", lambda _pid: False)
    signs = [Heartbeat(1, 1, 0, 1)]
    monkeypatch.setattr("bench.batch.supervisor.read_heartbeat", lambda _folder: signs[-1])

    class Silent:
        def gone(self):
            signs.append(Heartbeat(7, 1, 1, 8, 9))
            return False

    _watch(Silent(), tmp_path, clock)
    assert clock.monotonic() == pytest.approx(noticed_s, abs=0.5)


def test_the_end_of_a_driver_that_computes_without_end_says_so():
    end = Silence(3.6, computed_s=0.5).end()
    assert (end.how, end.why, end.outside) == ("hung", "computed without progress for 3.6 s", False)


def test_a_pause_of_the_whole_computer_is_no_endless_computing():
    times = iter([(1.0, 0.0), (9.0, 0.0), (9.001, 0.0)])
    computing = EndlessComputing(lambda *_: next(times), lambda *_: 1.0)
    for now_s in (0.0, 8.0, 8.2):
        computing.look(7, 9, now_s)
        assert not computing.is_endless(3.5)


@pytest.mark.parametrize("told", [(None, (1.0, 0.0)), (1.0, None)])
def test_computing_is_not_judged_where_nothing_can_be_read(told):
    computing = EndlessComputing(lambda *_: told[1], lambda *_: told[0])
    for look in range(100):
        computing.look(7, 9, 0.2 * look)
    assert not computing.is_endless(3.5)


def test_a_thread_that_waits_for_the_disk_begins_the_count_anew(tmp_path, monkeypatch):
    clock = VirtualClock(datetime(2026, 3, 1, tzinfo=UTC))
    signs = [Heartbeat(1, 1, 0, 1)]
    monkeypatch.setattr("bench.batch.supervisor.read_heartbeat", lambda _folder: signs[-1])
    monkeypatch.setattr("bench.batch.supervisor.waits_for_disk", lambda _pid: clock.monotonic() % 3.0 < 0.2)
    monkeypatch.setattr(
        "bench.batch.supervisor.EndlessComputing",
        lambda: EndlessComputing(lambda *_: (clock.monotonic(), 0.0), lambda *_: 1.0),
    )

    class Alive:
        def gone(self):
            signs.append(Heartbeat(7, 1, int(1e9 * clock.monotonic()), 8, 9))
            return clock.monotonic() > 60.0

    assert _watch(Alive(), tmp_path, clock) == Silence()


def test_a_wait_is_counted_once(tmp_path):
    told = iter([(1.0, 0.0), (1.0, 0.0), (1.0, 0.0), (1.1, 3.0), (1.2, 3.5)])
    starvation = Starvation(lambda *_: next(told), lambda *_: True)
    assert [starvation.look(7, (7,), float(second)) for second in range(5)] == [0.0, 1.0, 2.0, 3.0, 3.5]
    assert Starvation(lambda *_: None).look(7, (7,), 1.0) == 0.0


def test_the_kernel_tells_what_a_thread_computed_and_waited(tmp_path):
    task = tmp_path / "7" / "task" / "8"
    task.mkdir(parents=True)
    assert processor_times_s(7, 8, tmp_path) is None
    assert not thread_is_ready(7, 8, tmp_path)
    (task / "schedstat").write_text("1500000000 250000000 12\n")
    (task / "stat").write_text("8 (a ) name) R 1 7 7")
    assert processor_times_s(7, 8, tmp_path) == (1.5, 0.25)
    assert thread_is_ready(7, 8, tmp_path)
    (task / "schedstat").write_text("not counted")
    assert processor_times_s(7, 8, tmp_path) is None


def test_without_the_kernels_count_the_limit_grows_with_the_supervisors_own_lateness(tmp_path, monkeypatch):
    class Late(VirtualClock):
        def lateness(self):
            return {"lost_s": self.monotonic()}

    monkeypatch.setattr("bench.batch.supervisor.waits_for_disk", lambda _pid: False)
    for counted, noticed_s in ((None, 4.5), ((1.0, 1.0), 3.7)):
        signs = [Heartbeat(1, 1, 0, 1), Heartbeat(7, 1, 1, 8)]
        monkeypatch.setattr(
            "bench.batch.supervisor.read_heartbeat",
            lambda _folder, signs=signs: signs.pop(0) if signs[1:] else signs[0],
        )
        monkeypatch.setattr(
            "bench.batch.supervisor.Starvation",
            lambda told=counted: Starvation(lambda *_: told, lambda *_: False),
        )

        class Silent:
            def gone(self):
                return False

        silence = _watch(Silent(), tmp_path, Late(datetime(2026, 3, 1, tzinfo=UTC)))
        assert silence.silent_s == pytest.approx(noticed_s, abs=0.25)
