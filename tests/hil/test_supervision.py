"""A worker that dies or hangs is noticed within five seconds, its devices are made safe, and its run is taken up again."""

import json
import os
import re
import signal
import subprocess
import sys
import time

import pytest
from quick_runs import THREE_NAMED, write_queue, write_sequence, write_station
from running import PATIENCE_S, children, entering, has_ended, journal, results, start, wait_for
from servers import MailServer, serving
from station_texts import PLAIN
from waiting import wait_until

from bench.base.clock import Aborted, BenchClock
from bench.batch.supervisor import OUT_OF_MEMORY, POLL_S, SILENCE_S, adopt, supervise
from bench.run.crash_log import read_crash
from bench.run.processes import out_of_memory_kills
from bench.simulated import SimulatedBench
from bench.stations.orphans import make_orphans_safe
from bench.stations.station import load_station
from drivers.light import LightSettings


class Looks(BenchClock):
    """A clock that keeps when a supervisor looked for a sign of life."""

    def __init__(self):
        super().__init__()
        self.at_s = []

    def monotonic(self):
        self.at_s.append(super().monotonic())
        return self.at_s[-1]

    def saw_it_at_once(self, end):
        """Whether a worker was ended at the first look at which it had been silent for too long."""
        *_, before_s, last_s = self.at_s
        return end.noticed_s > SILENCE_S and before_s - (last_s - end.noticed_s) <= SILENCE_S


@pytest.fixture
def night(tmp_path):
    """A queue of one run, whose station tells a mail server; the folder of its batch."""
    with serving(MailServer()) as server:
        station = write_station(tmp_path / "station.yaml", server.section)
        sequence = write_sequence(tmp_path / "sequence.yaml", THREE_NAMED)
        job = f"name: cam, sequence: {sequence}, station: {station}, seed: 7, attempts: 3"
        yield write_queue(tmp_path / "queue.yaml", job), tmp_path / "night", server


@pytest.mark.slow
def test_a_worker_that_is_killed_and_one_that_hangs_are_noticed_told_and_the_run_is_finished(tmp_path, night):
    queue, folder, server = night
    process = start("batch", queue, "-o", folder, "--json", home=tmp_path / "home")
    run, seen = folder / "runs" / "cam-001", 0
    try:
        for number in (signal.SIGKILL, signal.SIGSTOP):
            wait_for(process, run, entering("recording", 2), seen)
            seen = len(journal(run))
            (worker,) = children(process.pid)
            os.kill(worker, number)
        out, err = process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
    assert process.returncode == 0, err
    (item,) = json.loads(out)["items"]
    assert (item["how"], item["attempts"]) == ("finished", 3)
    ends = [line for line in journal(folder) if line["event"] == "item_ended"]
    assert [end["how"] for end in ends] == ["died", "hung", "finished"]
    assert "SIGKILL" in ends[0]["why"]
    assert ends[1]["noticed_s"] > SILENCE_S
    assert results(run)["run"]["resumed"] == 2
    crashes = [line.get("crash") for line in journal(run) if line["event"] == "run_resumed"]
    assert crashes == [None, "Fatal Python error: Aborted"]
    messages = [subject.strip() for subject in server.subjects]  # a long one begins on a line of its own
    assert messages[0].endswith("died: by SIGKILL")
    assert re.search(rf"cam-001 .* hung: .* {ends[1]['noticed_s']:.1f} s", messages[1])
    assert sorted(messages[2:]) == [
        "Starbench: batch Night (SIMULATED) finished",
        "Starbench: run cam-001 (SIMULATED) finished",
    ]
    assert "No device" in server.letters[0].get_content()  # they ended with the process


@pytest.mark.slow
def test_a_worker_ends_safely_with_the_group_of_its_supervisor_and_its_run_is_resumed(tmp_path, night):
    queue, folder, server = night
    process = start("batch", queue, "-o", folder, home=tmp_path / "home")
    run = folder / "runs" / "cam-001"
    wait_for(process, run, entering("recording", 1))
    (worker,) = children(process.pid)
    process.kill()
    process.communicate()
    wait_until(lambda: has_ended(worker), PATIENCE_S)
    end = journal(run)[-1]
    assert (end["event"], end["how"], end["why"]) == ("run_ended", "aborted", "its supervisor has ended")
    assert {device["state"] for device in end["devices"]} == {"confirmed safe"}
    again = start("batch", queue, "-o", folder, "--json", home=tmp_path / "home")
    out, err = again.communicate(timeout=PATIENCE_S)
    assert again.returncode == 0, err
    assert "resume: cam-001" in err
    (item,) = json.loads(out)["items"]
    assert (item["how"], item["attempts"]) == ("finished", 2)
    assert results(run)["run"]["resumed"] == 1
    assert sum(line["event"] == "supervisor_lost" for line in journal(run)) == 1
    assert [s for s in server.subjects if "its supervisor has ended" in s]


WORKER = """
import os, sys
from datetime import UTC, datetime
from pathlib import Path
from bench.base.clock import BenchClock
from bench.run.control import CommandInbox
from bench.run.heartbeat import HeartbeatWriter
from bench.record.events import Event
from bench.record.run_log import RunLog
from bench.record.journal import Journal
from bench.record.run_folder import RunFolder
clock = BenchClock()
with RunFolder.create(Path(sys.argv[1])) as folder:
    with Journal.create(folder.journal_path, clock) as journal:
        heartbeat = HeartbeatWriter(folder.path, clock)
        with CommandInbox(folder.path, RunLog(journal), {}, clock, (heartbeat.beat,)):
            heartbeat.entering("recording")
            clock.sleep(1.5)
            journal.append(Event.DEVIATION, what="hangs now")
            exec(sys.argv[2])
"""
BLOCKS = "os.read(os.pipe()[0], 1)"
"""A driver that never returns, while all threads go on."""


@pytest.mark.slow
@pytest.mark.parametrize(
    "hang",
    [BLOCKS, "while True: pass", "import re; re.match('(a+)+$', 'a' * 60 + 'b')"],
    ids=["blocks", "computes", "keeps the interpreter's lock"],
)
def test_a_driver_that_never_returns_is_noticed_within_ten_seconds(tmp_path, hang):
    folder, clock = tmp_path / "run", Looks()
    end = supervise([sys.executable, "-c", WORKER, str(folder), hang], folder, tmp_path / "log", clock, print)
    assert end.how == "hung", (tmp_path / "log").read_text()
    assert SILENCE_S + POLL_S < 10.0
    assert clock.saw_it_at_once(end)
    assert journal(folder)[-1]["what"] == "hangs now"


def test_a_driver_that_never_returns_is_noticed_though_its_supervisor_was_killed(tmp_path):
    folder, clock = tmp_path / "run", Looks()
    with subprocess.Popen([sys.executable, "-c", WORKER, str(folder), BLOCKS]) as worker:
        wait_for(worker, folder, lambda line: line["event"] == "deviation")
        end = adopt(folder, clock, print)
        assert end is not None
        assert clock.saw_it_at_once(end)
        assert [device.state for device in end.devices] == ["never opened"] * 3
        assert worker.wait(PATIENCE_S) == -signal.SIGABRT
    assert adopt(folder, BenchClock(), print) is None


def test_a_stop_asked_of_the_next_supervisor_reaches_the_worker_it_found(tmp_path):
    folder, clock = tmp_path / "run", BenchClock()
    with subprocess.Popen([sys.executable, "-c", WORKER, str(folder), BLOCKS]) as worker:
        while not (folder / "control" / ".heartbeat").exists():
            time.sleep(0.01)
            assert worker.poll() is None
        clock.request_stop("SIGTERM received")
        with pytest.raises(Aborted):
            adopt(folder, clock, print)
        assert worker.wait(PATIENCE_S) == -signal.SIGTERM


def test_what_the_system_ended_for_want_of_memory_counts_as_a_crash(tmp_path, monkeypatch):
    kills = iter([3, 4])
    monkeypatch.setattr("bench.batch.supervisor.out_of_memory_kills", lambda: next(kills))
    folder = tmp_path / "run"
    folder.mkdir()
    command = [sys.executable, "-c", "import os, signal; os.kill(os.getpid(), signal.SIGKILL)"]
    end = supervise(command, folder, tmp_path / "log", BenchClock(), print)
    assert (end.how, end.why, end.outside) == ("died", OUT_OF_MEMORY, False)
    assert read_crash(folder) == OUT_OF_MEMORY
    kills = iter([4, 4])
    (folder / "crash.txt").unlink()
    assert supervise(command, folder, tmp_path / "log", BenchClock(), print).why == "by SIGKILL"
    assert read_crash(folder) is None


def test_kills_for_want_of_memory_are_counted_where_the_kernel_tells_them(tmp_path):
    (tmp_path / "vmstat").write_text("pgfault 7\noom_kill 12\nswap_ra 0\n")
    assert out_of_memory_kills(tmp_path / "vmstat") == 12
    assert out_of_memory_kills(tmp_path / "none") == 0


def test_the_light_that_a_dead_process_left_on_is_switched_off(tmp_path):
    with SimulatedBench({}, 1) as world:
        text = PLAIN
        for name in ("gimbal", "light"):
            text = text.replace(f"sim:{name}", world.endpoints[name])
        (tmp_path / "station.yaml").write_text(text)
        station, clock = load_station(str(tmp_path / "station.yaml")).value, BenchClock()
        light = station.light.open_device(str, clock=clock, wire_log=None)
        light.apply(LightSettings("square", 60.0, 50.0, 0.0, 5.0))
        light.on()
        assert light.is_on()
        light.close()
        ends = make_orphans_safe(station, clock)
        assert [end.state for end in ends] == ["confirmed safe", "confirmed safe", "not confirmed"]
        assert "off" in ends[1].said
        light = station.light.open_device(str, clock=clock, wire_log=None)
        assert not light.is_on()
        light.close()


def test_a_device_that_is_gone_does_not_keep_the_other_from_being_made_safe(tmp_path):
    with SimulatedBench({}, 1) as world:
        text = PLAIN.replace("sim:light", world.endpoints["light"])
        (tmp_path / "station.yaml").write_text(text.replace("sim:gimbal", "/dev/serial/by-id/gone"))
        station = load_station(str(tmp_path / "station.yaml")).value
        stage, light, _ = make_orphans_safe(station, BenchClock())
        assert "made safe" in stage.said
        assert "may be moving" in stage.text
        assert light.state == "confirmed safe"


def test_simulated_devices_that_ended_with_their_process_are_not_said_to_be_safe():
    assert make_orphans_safe(load_station("simulated").value, BenchClock()) == []


def test_a_worker_that_fails_says_why(tmp_path):
    command = [sys.executable, "-m", "bench", "resume", str(tmp_path / "none")]
    end = supervise(command, tmp_path / "none", tmp_path / "log", BenchClock(), lambda _: None)
    assert end.how == "failed"
    assert "no such run folder" in end.why
