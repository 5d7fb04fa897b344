"""A process that holds a stage is killed: nothing moves that it had not ordered, and no lock is left behind.

That an axis found moving is stopped at opening, `test_stage_families` shows for each family.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass

import pytest

from drivers.errors import PortBusy
from simulators.assembly import make_stage
from simulators.config import AxisConfig
from simulators.faults.fault_injection import AxisController
from simulators.ports.pseudo_terminal import PseudoTerminal
from simulators.ports.serial_device import SerialDevice
from tests.hil.holder import opened


@dataclass
class Rig:
    """A simulated stage of one axis on a terminal."""

    address: str
    pan: AxisController

    def pan_deg(self) -> float:
        return self.pan.axis.pointing.angle_deg(time.monotonic())

    def stands(self) -> bool:
        time.sleep(0.3)  # it settles
        before = self.pan_deg()
        time.sleep(1.0)
        return abs(self.pan_deg() - before) < 1e-6


@pytest.fixture
def rig(tmp_path) -> Iterator[Rig]:
    axes = {"pan": AxisConfig("100101", 15.0, 2.4, 6400)}
    stage = make_stage("zaber", axes, time.monotonic, lambda *_: None)
    (dialect,) = stage.dialects.values()
    with SerialDevice(PseudoTerminal(tmp_path / "port"), dialect) as device:
        yield Rig(device.address, stage.controllers["pan"])


@pytest.fixture
def holder(rig: Rig) -> Iterator[subprocess.Popen[str]]:
    """Another process that holds the stage, homes it, and moves it."""
    command = [sys.executable, "-m", "tests.hil.holder", rig.address]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    yield process
    process.kill()
    process.communicate()


def test_killed_while_open_it_leaves_a_free_port_and_nothing_moves(rig, holder) -> None:
    stood = rig.pan_deg()
    assert holder.stdout.readline() == "open\n"
    with pytest.raises(PortBusy):
        opened(rig.address)
    holder.kill()
    holder.wait()
    with closing(opened(rig.address)) as stage:
        assert rig.stands()  # even if it had just begun to home
        assert not stage.is_homed()
    assert abs(rig.pan_deg() - stood) < 3.0


def test_killed_in_mid_move_the_stage_is_stopped_by_being_opened(rig, holder) -> None:
    assert [holder.stdout.readline() for _ in range(2)] == ["open\n", "homed\n"]
    while rig.pan_deg() > -1.0:
        time.sleep(0.02)
    holder.kill()
    holder.wait()
    with closing(opened(rig.address)):
        assert rig.stands()
        assert rig.pan_deg() > -13.0
