"""`starbench simulate`: ports for other programs, faults ordered while it runs, gone when told to end."""

import json
import signal
import subprocess
from pathlib import Path

import pytest
from running import STARBENCH, environment


@pytest.fixture
def simulated(tmp_path):
    process = subprocess.Popen(
        [*STARBENCH, "simulate", "--seed", "3"],
        env=environment(tmp_path),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    yield process
    process.kill()
    process.communicate()


def test_it_prints_its_ports_obeys_orders_and_leaves_nothing_behind(simulated):
    ports = dict(simulated.stdout.readline().split() for _ in range(4))
    assert set(ports) == {"gimbal", "light", "camera", "frame-camera"}
    assert Path(ports["gimbal"]).is_char_device()
    for order, ok in (("pan stall share=0.3", True), ("pan fly", False)):
        simulated.stdin.write(order + "\n")
        simulated.stdin.flush()
        assert json.loads(simulated.stdout.readline())["ok"] is ok
    simulated.send_signal(signal.SIGINT)
    assert simulated.wait(timeout=30) == 0
    assert not Path(ports["gimbal"]).exists()
