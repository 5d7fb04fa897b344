"""One device reached by two ports: the second process is refused by the serial number, whoever of the two was first."""

import time
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import pytest
from station_texts import PLAIN, station_of

from bench.base.clock import BenchClock
from bench.stations.device_locks import serial_devices
from bench.stations.devices import Devices
from drivers.errors import PortBusy
from drivers.file_lock import FOLDER_VARIABLE, DeviceHold, event_camera_name
from simulators.ports.pseudo_terminal import PseudoTerminal
from simulators.ports.serial_device import SerialDevice, TcpPort
from tests.hil.direct_stages import of_one_port


@pytest.fixture(autouse=True)
def locks(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "locks"))


@pytest.fixture
def ports(tmp_path: Path) -> Iterator[list[str]]:
    """The same controllers by two ports: a terminal, and the network."""
    chain, _ = of_one_port("zaber", time.monotonic)
    with ExitStack() as stack:
        yield [
            stack.enter_context(SerialDevice(port, chain)).address
            for port in (PseudoTerminal(tmp_path / "gimbal"), TcpPort("gimbal"))
        ]


def station(port: str):
    return station_of(PLAIN.replace("sim:gimbal", port))


def opened(port: str) -> Devices:
    return Devices(station(port), seed=1, clock=BenchClock(), wire_log=None)


def test_a_station_s_devices_are_named_by_family_and_number(ports) -> None:
    assert serial_devices(station(ports[0])) == ("Zaber 100101", "Zaber 100102")
    assert serial_devices(station("sim:gimbal")) == ()


def test_the_same_stage_by_another_port_is_refused_until_the_first_is_closed(ports) -> None:
    with closing(opened(ports[0])), pytest.raises(PortBusy, match=r"Zaber 100101: .* another port"):
        opened(ports[1])
    opened(ports[1]).close()


def test_a_serial_number_in_capitals_or_in_small_letters_is_one_device() -> None:
    """Drivers of one camera print its hexadecimal digits in two ways."""
    hold = DeviceHold(event_camera_name("00CA51"))
    with pytest.raises(PortBusy):
        DeviceHold(event_camera_name("00ca51"))
    hold.release()


def test_a_stage_of_which_one_axis_is_in_use_holds_none(ports) -> None:
    hold = DeviceHold("Zaber 100102")
    with pytest.raises(PortBusy, match="Zaber 100102"):
        opened(ports[0])
    DeviceHold("Zaber 100101").release()
    hold.release()
    opened(ports[0]).close()
