"""A process that holds a stage is killed: nothing moves that it had not ordered, and no lock is left behind."""

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
from tests.hil.holder import OPENED

#: Kind of the simulated stage, and counts per degree of its axis, for each family.
KINDS = {
    "zaber": ("zaber", 6400),
    "ximc": ("ximc", 25600),
    "grbl": ("grbl", 640),
    "esp": ("esp301", 6400),
    "flir": ("flir_ptu", 800),
    "thorlabs": ("thorlabs_apt", 136_533),
    "dynamixel": ("dynamixel", 100),
}
FAMILIES = tuple(KINDS)

each_in_turn = pytest.mark.parametrize(
    "rig",
    [FAMILIES[0], *(pytest.param(name, marks=pytest.mark.slow) for name in FAMILIES[1:])],
    indirect=True,
)


@dataclass
class Rig:
    """A simulated stage of one axis on a terminal."""

    family: str
    address: str
    pan: AxisController


@pytest.fixture
def rig(request, tmp_path) -> Iterator[Rig]:
    kind, scale = KINDS[request.param]
    stage = make_stage(kind, {"pan": AxisConfig("100101", 15.0, 2.4, scale)}, time.monotonic, lambda *_: None)
    (dialect,) = stage.dialects.values()
    with SerialDevice(PseudoTerminal(tmp_path / "port"), dialect) as device:
        yield Rig(request.param, device.address, stage.controllers["pan"])


@pytest.fixture
def holder(rig: Rig) -> Iterator[subprocess.Popen[str]]:
    """Another process that holds the stage, homes it, and moves it."""
    command = [sys.executable, "-m", "tests.hil.holder", rig.family, rig.address]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    yield process
    process.kill()
    process.communicate()


def pan_deg(rig: Rig) -> float:
    return rig.pan.axis.pointing.angle_deg(time.monotonic())


def stands(rig: Rig, for_s: float = 1.0) -> bool:
    time.sleep(0.3)  # it settles
    before = pan_deg(rig)
    time.sleep(for_s)
    return abs(pan_deg(rig) - before) < 1e-6


@each_in_turn
def test_killed_while_open_it_leaves_a_free_port_and_nothing_moves(rig, holder) -> None:
    stood = pan_deg(rig)
    assert holder.stdout.readline() == "open\n"
    with pytest.raises(PortBusy):
        OPENED[rig.family](rig.address)
    holder.kill()
    holder.wait()
    with closing(OPENED[rig.family](rig.address)) as stage:
        assert stands(rig)  # even if it had just begun to home
        assert (
            rig.family == "dynamixel" or not stage.is_homed()
        )  # a servo knows its angle; its torque stays on
    assert abs(pan_deg(rig) - stood) < 3.0


@each_in_turn
def test_killed_in_mid_move_the_stage_is_stopped_by_being_opened(rig, holder) -> None:
    assert [holder.stdout.readline() for _ in range(2)] == ["open\n", "homed\n"]
    while pan_deg(rig) > -1.0 if rig.family != "grbl" else pan_deg(rig) > 13.0:
        time.sleep(0.02)
    holder.kill()
    holder.wait()
    with closing(OPENED[rig.family](rig.address)):
        assert stands(rig)
        assert pan_deg(rig) > -13.0
