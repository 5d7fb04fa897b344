"""Simulated devices whose process is stopped (SIGSTOP), and runs that end by every signal: asked from outside."""

import os
import signal
import time
from contextlib import closing, contextmanager

import pytest
from quick_runs import CONFIG, THREE_NAMED, write_queue, write_sequence, write_station_of
from running import (
    PATIENCE_S,
    children,
    end_when,
    entering,
    journal,
    light_outputs,
    python,
    starbench,
    start,
    wait_for,
)

from bench.base.clock import BenchClock
from bench.simulated import SimulatedBench
from bench.stations.station import load_station
from drivers.file_lock import FOLDER_VARIABLE

AT_POSE = {"recording": 1, "slewing": 2}


@pytest.fixture
def bench(tmp_path, monkeypatch):
    """A simulated bench of its own process, that outlives runs on it; a station of its real ports; a sequence."""
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "locks"))  # other tests have devices of the same names
    with SimulatedBench(CONFIG, 7) as world:
        station = write_station_of(tmp_path / "station.yaml", world)
        yield world, station, write_sequence(tmp_path / "sequence.yaml", THREE_NAMED)


def see_that_it_is_safe(station):
    """Ask the devices themselves: the light is off, the stage stands."""
    words, clock = load_station(str(station)).value, BenchClock()
    with closing(words.light.open_device(str, clock=clock, wire_log=None)) as light:
        assert not light.is_on()
    with closing(words.stage.open_device(str, clock=clock, wire_log=None)) as stage:
        first = stage.position_deg()
        time.sleep(0.3)
        assert stage.position_deg() == first


@contextmanager
def stopped(world):
    os.kill(world.process.pid, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(world.process.pid, signal.SIGCONT)


@pytest.mark.slow
def test_devices_that_stop_answering_end_the_run_in_time_and_it_is_resumed(tmp_path, bench):
    world, station, sequence = bench
    folder, home = tmp_path / "run", tmp_path / "home"
    process = start("run", sequence, "-s", station, "-o", folder, home=home)
    wait_for(process, folder, entering("slewing", 2))
    with stopped(world):
        began = time.monotonic()
        errors = process.communicate(timeout=60)[1]
        assert time.monotonic() - began < 40
    assert process.returncode == 1
    assert "The run failed" in errors
    assert "CHECK THE BENCH" in errors  # nobody could be made sure of
    starbench("resume", folder, home=home)
    see_that_it_is_safe(station)


@pytest.mark.slow
def test_devices_that_pause_are_waited_for_where_the_station_says_so(tmp_path, bench):
    world, station, sequence = bench
    station.write_text(station.read_text() + "\ninterlocks: {device_lost: {retry_s: 1, max_hold_s: 120}}\n")
    folder, home = tmp_path / "run", tmp_path / "home"
    process = start("run", sequence, "-s", station, "-o", folder, home=home)
    wait_for(process, folder, entering("slewing", 2))
    with stopped(world):
        wait_for(process, folder, entering("holding"))
        time.sleep(5)
    errors = process.communicate(timeout=PATIENCE_S)[1]
    assert process.returncode == 0, errors
    released = [line for line in journal(folder) if line["event"] == "interlock_released"]
    assert {line["rule"] for line in released} == {"device_lost"}
    see_that_it_is_safe(station)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "state"),
    [
        (signal.SIGINT, "recording"),
        (signal.SIGTERM, "slewing"),
        (signal.SIGHUP, "homing"),
        (signal.SIGTERM, "lighting"),
    ],
)
def test_a_run_that_is_told_to_stop_leaves_devices_safe(tmp_path, bench, number, state):
    _, station, sequence = bench
    process = start("run", sequence, "-s", station, "-o", tmp_path / "run", home=tmp_path / "home")
    end_when(process, tmp_path / "run", entering(state, AT_POSE.get(state)), number)
    assert process.returncode == 3
    see_that_it_is_safe(station)


def begin_batch(tmp_path, sequence, station, state, *, attempts):
    """Begin a batch of one run; return its process, its folder and its worker, when the run has reached a state."""
    job = f"name: cam, sequence: {sequence}, station: {station}, attempts: {attempts}"
    queue, folder = write_queue(tmp_path / "queue.yaml", job), tmp_path / "night"
    process = start("batch", queue, "-o", folder, home=tmp_path / "home")
    wait_for(process, folder / "runs" / "cam-001", entering(state, AT_POSE.get(state)))
    (worker,) = children(process.pid)
    return process, folder, worker


@pytest.mark.slow
@pytest.mark.parametrize("state", ["recording", "slewing", "homing"])
def test_a_worker_killed_by_force_leaves_devices_that_its_supervisor_makes_safe(tmp_path, bench, state):
    _, station, sequence = bench
    process, folder, worker = begin_batch(tmp_path, sequence, station, state, attempts=1)
    os.kill(worker, signal.SIGKILL)
    wait_for(process, folder, lambda line: line["event"] == "item_ended")
    ended = next(line for line in journal(folder) if line["event"] == "item_ended")
    assert (ended["how"], ended["unsafe"]) == ("died", [])
    states = [(device["device"], device["state"]) for device in ended["devices"]]
    assert states == [("stage", "confirmed safe"), ("light", "confirmed safe"), ("camera", "not confirmed")]
    process.communicate(timeout=PATIENCE_S)
    see_that_it_is_safe(station)


@pytest.mark.slow
@pytest.mark.parametrize("state", ["recording", "slewing"])
def test_worker_and_supervisor_killed_together_leave_a_bench_that_the_next_call_makes_safe(
    tmp_path, bench, state
):
    _, station, sequence = bench
    process, folder, worker = begin_batch(tmp_path, sequence, station, state, attempts=3)
    run = folder / "runs" / "cam-001"
    os.kill(process.pid, signal.SIGKILL)  # first, so that it cannot see its worker die
    os.kill(worker, signal.SIGKILL)
    process.communicate()
    seen = len(journal(run))
    starbench("batch", tmp_path / "queue.yaml", "-o", folder, home=tmp_path / "home")
    events = [line["event"] for line in journal(run)[seen:]]
    assert "run_resumed" in events
    assert events.index("devices") < events.index("capture_stored")  # preflight has put the light out by then
    assert light_outputs(run, after_s=journal(run)[seen]["mono_s"])[0] is False
    see_that_it_is_safe(station)


RAISING = """
import sys
from bench.run.states import StateWork
def broken(self, *_, **facts):
    raise RuntimeError("a mistake of ours")
setattr(StateWork, sys.argv[1], broken)
from bench.commands.cli import main
sys.exit(main(sys.argv[2:]))
"""


@pytest.mark.slow
@pytest.mark.parametrize("callback", ["slewing", "recording", "checking", "waiting", "parking", "solving"])
def test_an_exception_in_any_callback_leaves_devices_safe(tmp_path, bench, callback):
    _, station, sequence = bench
    words = ("run", sequence, "-s", station, "-o", tmp_path / "run")
    python("-c", RAISING, callback, *words, status=1, STARBENCH_HOME=tmp_path / "home")
    assert "a mistake of ours" in journal(tmp_path / "run")[-1]["why"]
    see_that_it_is_safe(station)
