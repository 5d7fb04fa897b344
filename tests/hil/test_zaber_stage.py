"""The Zaber driver on a simulated gimbal, beside the maker's own client; see also test_stage_families."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from drivers.clock import SystemClock
from drivers.errors import ReplyError
from drivers.stage import AxisLimits
from drivers.stage.zaber import ZaberAxis, ZaberStage
from drivers.wire_log import WireLogFile
from simulators.axis_motion import Mechanics
from simulators.pseudo_terminal import PseudoTerminal
from simulators.serial_device import SerialDevice
from simulators.zaber import ZaberChain
from simulators.zaber_controller import ZaberController, ZaberModel

SCALE = 6400
LIMITS = {"pan": 15, "tilt": 10}


def controller(serial_number: str, limit_deg: int, start_deg: float) -> ZaberController:
    mechanics = Mechanics(SCALE, -limit_deg - 2.0, limit_deg + 2.0, start_deg=start_deg)
    model = ZaberModel(mechanics, serial_number, -limit_deg * SCALE, limit_deg * SCALE)
    return ZaberController(model, time.monotonic())


@pytest.fixture
def gimbal(tmp_path) -> Iterator[SerialDevice]:
    chain = ZaberChain([controller("100101", 15, 2.4), controller("100102", 10, -1.7)], time.monotonic)
    with SerialDevice(PseudoTerminal(tmp_path / "gimbal"), chain) as device:
        yield device


def axes() -> list[ZaberAxis]:
    return [
        ZaberAxis(
            name=name,
            device=number,
            serial=f"10010{number}",
            microsteps_per_deg=SCALE,
            limits=AxisLimits(-LIMITS[name], LIMITS[name], 40.0, 200.0),
        )
        for number, name in ((1, "pan"), (2, "tilt"))
    ]


def open_stage(gimbal: SerialDevice, **more) -> ZaberStage:
    return ZaberStage.open(gimbal.address, axes(), clock=SystemClock(), **more)


def sent(log: Path) -> list[str]:
    """Requests in a wire log, without ids and checksums."""
    lines = [json.loads(text) for text in log.read_text().splitlines()]
    return [
        re.sub(r" \d\d(?=[ :])|:..\n", "", line["bytes"], count=2) for line in lines if line["dir"] == ">"
    ]


def test_a_wrong_baud_rate_is_told_and_moves_nothing(gimbal) -> None:
    with pytest.raises(ReplyError):
        ZaberStage.open(gimbal.address, axes(), baudrate=9600, clock=SystemClock())


def test_what_we_send_is_what_the_makers_client_sends(gimbal, tmp_path) -> None:
    ascii_ = pytest.importorskip("zaber_motion.ascii", reason="the maker's client is not installed")
    from zaber_motion import Library, LogOutputMode

    Library.enable_device_db_store(str(tmp_path))
    log = WireLogFile(tmp_path / "wire.jsonl")
    with closing(open_stage(gimbal, wire_log=log)) as stage:
        stage.home()
        stage.move_to({"pan": 5.0})
        stage.stop()
    ours = sent(log.path)
    log.close()
    Library.set_log_output(LogOutputMode.FILE, str(tmp_path / "maker.log"))
    try:
        with ascii_.Connection.open_serial_port(gimbal.address) as connection:
            pan, tilt = (device.get_axis(1) for device in connection.detect_devices(identify_devices=False))
            pan.home()
            tilt.home()
            pan.move_absolute(5 * SCALE)
            pan.get_position()
            connection.stop_all()
    finally:
        Library.set_log_output(LogOutputMode.OFF)
    theirs = {
        re.sub(r" \d\d(?=[ :])|:..$", "", text, count=2)
        for text in re.findall(r"(/\d \d[^\n\"]*:[0-9A-F]{2})", (tmp_path / "maker.log").read_text())
    }
    for request in ("/1 1 home", "/2 1 home", f"/1 1 move abs {5 * SCALE}", "/1 1 get pos", "/0 0 stop"):
        assert request in ours
        assert request in theirs
