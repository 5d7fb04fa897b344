"""A process that holds a stage is killed: nothing moves that it had not ordered, and no lock is left behind."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing

import pytest

from drivers.errors import PortBusy
from tests.hil.holder import OPENED
from tests.hil.test_stage_families import FAMILIES, Rig, rig  # noqa: F401 - the fixture

each_in_turn = pytest.mark.parametrize(
    "rig",
    [FAMILIES[0], *(pytest.param(name, marks=pytest.mark.slow) for name in FAMILIES[1:])],
    indirect=True,
)


@pytest.fixture
def holder(rig: Rig, request) -> Iterator[subprocess.Popen[str]]:  # noqa: F811
    """Another process that holds the stage, homes it, and moves it."""
    family = request.node.callspec.params["rig"]
    command = [sys.executable, "-m", "tests.hil.holder", family, rig.devices[0].address]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    rig.family = family
    yield process
    process.kill()
    process.communicate()


def pan_deg(rig: Rig) -> float:  # noqa: F811
    return rig.axes["pan"].pointing.angle_deg(time.monotonic())


def stands(rig: Rig, for_s: float = 1.0) -> bool:  # noqa: F811
    time.sleep(0.3)  # it settles
    before = pan_deg(rig)
    time.sleep(for_s)
    return abs(pan_deg(rig) - before) < 1e-6


@each_in_turn
def test_killed_while_open_it_leaves_a_free_port_and_nothing_moves(rig, holder) -> None:  # noqa: F811
    stood = pan_deg(rig)
    assert holder.stdout.readline() == "open\n"
    with pytest.raises(PortBusy):
        OPENED[rig.family](rig.devices[0].address)
    holder.kill()
    holder.wait()
    with closing(OPENED[rig.family](rig.devices[0].address)) as stage:
        assert stands(rig)  # even if it had just begun to home
        assert (
            rig.family == "dynamixel" or not stage.is_homed()
        )  # a servo knows its angle; its torque stays on
    assert abs(pan_deg(rig) - stood) < 3.0


@each_in_turn
def test_killed_in_mid_move_the_stage_is_stopped_by_being_opened(rig, holder) -> None:  # noqa: F811
    assert [holder.stdout.readline() for _ in range(2)] == ["open\n", "homed\n"]
    while pan_deg(rig) > -1.0 if rig.family != "grbl" else pan_deg(rig) > 13.0:
        time.sleep(0.02)
    holder.kill()
    holder.wait()
    with closing(OPENED[rig.family](rig.devices[0].address)):
        assert stands(rig)
        assert pan_deg(rig) > -13.0
