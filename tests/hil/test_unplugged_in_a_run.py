"""A stage's cable is pulled in mid-run, and something else is plugged in: nothing of it moves, and the run goes on with the right one."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from running import PATIENCE_S, STARBENCH, entering, environment, journal, results, starbench, start
from station_texts import PLAIN

Order = Callable[[str], None]


@pytest.fixture
def simulated(tmp_path: Path) -> Iterator[tuple[dict[str, str], Order]]:
    """A simulated bench that outlives runs, its ports, and how to give it orders."""
    process = subprocess.Popen(
        [*STARBENCH, "simulate", "--seed", "7"],
        env=environment(tmp_path / "home"),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    ports = {}
    while set(ports) < {"gimbal", "light", "camera"}:
        name, port = process.stdout.readline().split()
        ports[name] = port

    def order(text: str) -> None:
        process.stdin.write(text + "\n")
        process.stdin.flush()
        answer = process.stdout.readline()
        while not answer.startswith("{"):
            answer = process.stdout.readline()
        assert json.loads(answer)["ok"], answer

    yield ports, order
    process.kill()
    process.communicate()


@pytest.mark.slow
def test_another_stage_under_the_same_name_is_refused_and_the_right_one_finishes_the_run(tmp_path, simulated):
    ports, order = simulated
    text = PLAIN.replace("simulation: {}\n", "")
    for name, port in ports.items():
        text = text.replace(f"sim:{name}", port)
    station, folder, home = tmp_path / "station.yaml", tmp_path / "run", tmp_path / "home"
    station.write_text(text)
    process = start("run", "three_pose", "-s", station, "-o", folder, home=home)

    while process.poll() is None and not any(map(entering("slewing", 2), journal(folder))):
        time.sleep(0.01)
    order("gimbal unplug")
    process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 1
    ended = journal(folder)[-1]
    assert "the port is gone" in ended["why"], ended
    order("pan exchange serial=777")
    order("gimbal replug")
    refused = starbench("resume", folder, home=home)
    assert refused.returncode == 1
    assert "777. Nothing was moved" in refused.stderr
    order("pan exchange serial=100101")
    resumed = starbench("resume", folder, home=home)
    assert resumed.returncode == 0, resumed.stderr
    stored = [
        line["pose"] for line in journal(folder) if line["event"] == "attempt_checked" and line["accepted"]
    ]
    assert sorted(stored) == [1, 2, 3]
    assert results(folder)["run"]["resumed"] == 2
