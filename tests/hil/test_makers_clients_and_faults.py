"""Faults of a move as the makers' own clients meet them: what they notice, and what they let pass, with our drivers beside."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.errors import DriverError
from simulators.ports.pseudo_terminal import PseudoTerminal
from simulators.ports.serial_device import SerialDevice
from simulators.stages.axis_motion import Mechanics, MotionFault
from simulators.stages.ximc import XimcController, XimcModel
from simulators.stages.zaber import ZaberChain, ZaberController, ZaberModel
from tests.hil.holder import OPENED

MECHANICS = {"zaber": Mechanics(6400, -17.0, 17.0), "ximc": Mechanics(25600, -17.0, 17.0)}


@pytest.fixture
def zaber(tmp_path: Path) -> Iterator[tuple[SerialDevice, ZaberController]]:
    controller = ZaberController(ZaberModel(MECHANICS["zaber"], "100101", -96000, 96000), time.monotonic())
    with SerialDevice(PseudoTerminal(tmp_path / "zaber"), ZaberChain([controller], time.monotonic)) as device:
        yield device, controller


@pytest.fixture
def ximc(tmp_path: Path) -> Iterator[tuple[SerialDevice, XimcController]]:
    controller = XimcController(XimcModel(MECHANICS["ximc"], 4242, -15.0, 15.0), time.monotonic)
    with SerialDevice(PseudoTerminal(tmp_path / "ximc"), controller) as device:
        yield device, controller


def ours(family: str, device: SerialDevice, controller, kind: str) -> None:
    """See our driver end the same move in an error."""
    stage = OPENED[family](device.address)
    stage.home()
    controller.axis.arm(MotionFault(kind))
    with pytest.raises(DriverError):
        stage.move_to({"pan": 9.0})
    stage.close()


@pytest.mark.parametrize(
    ("kind", "noticed"), [("stall", True), ("limit", True), ("twist", True), ("stop_short", False)]
)
def test_zaber_motion_notices_what_raises_a_flag(zaber, tmp_path, kind, noticed) -> None:
    ascii_ = pytest.importorskip("zaber_motion.ascii", reason="the maker's client is not installed")
    from zaber_motion import Library
    from zaber_motion.exceptions import MovementFailedException

    Library.enable_device_db_store(str(tmp_path))
    device, controller = zaber
    with ascii_.Connection.open_serial_port(device.address) as connection:
        axis = connection.get_device(1).get_axis(1)
        axis.home()
        controller.axis.arm(MotionFault(kind))
        if noticed:
            with pytest.raises(MovementFailedException):
                axis.move_absolute(57_600)
        else:
            axis.move_absolute(57_600)
        assert axis.get_position() < 57_600
    ours("zaber", device, controller, kind)


def test_zaber_motion_loses_its_connection_to_a_pulled_cable(zaber, tmp_path) -> None:
    ascii_ = pytest.importorskip("zaber_motion.ascii", reason="the maker's client is not installed")
    from zaber_motion import Library
    from zaber_motion.exceptions import MotionLibException

    Library.enable_device_db_store(str(tmp_path))
    device, _ = zaber
    with ascii_.Connection.open_serial_port(device.address) as connection:
        axis = connection.get_device(1).get_axis(1)
        axis.home()
        device.unplug()
        with pytest.raises(MotionLibException):
            axis.get_position()


@pytest.mark.parametrize("kind", ["stall", "stop_short"])
def test_libximc_returns_from_a_move_that_went_wrong(ximc, kind) -> None:
    library = pytest.importorskip("libximc.highlevel", reason="the maker's library is not installed")
    device, controller = ximc
    axis = library.Axis(f"xi-com://{device.address}")
    axis.open_device()
    axis.command_home()
    axis.command_wait_for_stop(10)
    axis.command_zero()
    controller.axis.arm(MotionFault(kind))
    axis.command_move(900, 0)
    axis.command_wait_for_stop(10)
    assert axis.get_position().Position < 900
    assert (library.StateFlags.STATE_ALARM in axis.get_status().Flags) == (kind == "stall")
    axis.command_stop()
    axis.close_device()
    ours("ximc", device, controller, kind)
