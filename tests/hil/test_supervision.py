"""A worker that dies or hangs is noticed within five seconds, its devices are made safe, and its run is taken up again."""

import json
import os
import signal
import sys
import time
from pathlib import Path

from running import PATIENCE_S, entering, journal, results, start

from bench.clock import BenchClock
from bench.devices import _open_light, make_orphans_safe
from bench.simulated import SimulatedBench
from bench.station import SHIPPED, load_station
from bench.supervisor import supervise
from drivers.light import LightSettings

QUEUE = """\
format: starbench/queue/1
name: Night
jobs:
  - {name: cam, sequence: three_pose, station: simulated, seed: 7, attempts: 3}
"""


def children(pid):
    return [int(p) for p in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def test_a_worker_that_is_killed_and_one_that_hangs_are_noticed_and_the_run_is_finished(tmp_path):
    queue, folder = tmp_path / "queue.yaml", tmp_path / "night"
    queue.write_text(QUEUE)
    process = start("batch", queue, "-o", folder, "--json", home=tmp_path / "home")
    run, seen = folder / "runs" / "cam-001", 0
    try:
        for number in (signal.SIGKILL, signal.SIGSTOP):
            deadline = time.monotonic() + PATIENCE_S
            while not any(map(entering("recording", 2), journal(run)[seen:])):
                assert process.poll() is None, process.communicate()[1]
                assert time.monotonic() < deadline
                time.sleep(0.01)
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
    assert 4.0 < ends[1]["noticed_s"] < 5.0
    assert results(run)["run"]["resumed"] == 2
    crashes = [line.get("crash") for line in journal(run) if line["event"] == "run_resumed"]
    assert crashes == [None, "Fatal Python error: Aborted"]


def test_the_light_that_a_dead_process_left_on_is_switched_off(tmp_path):
    with SimulatedBench({}, 1) as world:
        text = (SHIPPED / "simulated.yaml").read_text()
        for name in ("gimbal", "light"):
            text = text.replace(f"sim:{name}", world.endpoints[name])
        (tmp_path / "station.yaml").write_text(text)
        station, clock = load_station(str(tmp_path / "station.yaml")).value, BenchClock()
        light = _open_light(station, str, clock, None)
        light.apply(LightSettings("square", 60.0, 50.0, 0.0, 5.0))
        light.on()
        assert light.is_on()
        light.close()
        assert make_orphans_safe(station, clock) == []
        light = _open_light(station, str, clock, None)
        assert not light.is_on()
        light.close()


def test_a_device_that_is_gone_does_not_keep_the_other_from_being_made_safe(tmp_path):
    with SimulatedBench({}, 1) as world:
        text = (SHIPPED / "simulated.yaml").read_text().replace("sim:light", world.endpoints["light"])
        (tmp_path / "station.yaml").write_text(text.replace("sim:gimbal", "/dev/serial/by-id/gone"))
        station = load_station(str(tmp_path / "station.yaml")).value
        (fault,) = make_orphans_safe(station, BenchClock())
        assert fault.startswith("the stage of a dead process could not be made safe")


def test_a_worker_that_fails_says_why(tmp_path):
    command = [sys.executable, "-m", "bench", "resume", str(tmp_path / "none")]
    end = supervise(command, tmp_path / "none", tmp_path / "log", BenchClock(), lambda _: None)
    assert end.how == "failed"
    assert "There is no such run folder" in end.why
