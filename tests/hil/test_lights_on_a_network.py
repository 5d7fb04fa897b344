"""Lights whose line closes when it is idle: opened again to go on and to switch off; what cannot be is said."""

import threading
import time
from contextlib import closing

import pytest
from waiting import wait_until

from drivers.clock import SystemClock
from drivers.errors import DriverError, LightFault, PortLost, ReplyTimeout
from drivers.light import LightSettings
from drivers.light.gardasoft import GardasoftLight
from drivers.light.scpi import ScpiLight
from drivers.light.text import TextLight
from simulators.assembly import make_light
from simulators.config import LightConfig
from simulators.ports.serial_device import SerialDevice, TcpPort
from tests.hil.direct_lights import MICROCONTROLLER

FLICKER = LightSettings("square", 50.0, 40.0, 0.0, 3.0, sync_output=True)
OPEN = {
    "gardasoft": lambda address: GardasoftLight.open(address, clock=SystemClock()),
    "rigol": lambda address: ScpiLight.open(address, dialect="numbered", clock=SystemClock()),
    "microcontroller": lambda address: TextLight.open(
        address, MICROCONTROLLER, serial="SG0042", clock=SystemClock()
    ),
}


class Network:
    """A simulated light behind a TCP port whose clock a test turns."""

    def __init__(self, kind: str, idle_s: float) -> None:
        self.ahead_s, self.states = 0.0, []
        self.driver = make_light(LightConfig(kind), time.monotonic, self.states.append)
        self.port = TcpPort("light", idle_s=idle_s, clock=lambda: time.monotonic() + self.ahead_s)
        self.device = SerialDevice(self.port, self.driver, paced=False).start()
        self.light = OPEN[kind](self.device.address)

    def shine(self) -> None:
        self.light.apply(FLICKER)
        self.light.on()

    def see_it_go_dark(self) -> None:
        """Switch the light off, and ask the device, not the driver, whether it is."""
        self.light.off()
        assert not self.states[-1].output

    def pass_time(self, seconds: float) -> None:
        self.ahead_s += seconds
        wait_until(lambda: self.port.client is None)

    def close(self) -> None:
        self.light.close()
        self.device.close()


@pytest.fixture(params=OPEN)
def network(request):
    network = Network(request.param, idle_s=10.0)
    yield network
    network.close()


def test_a_light_whose_idle_line_was_closed_goes_on_and_is_switched_off(network) -> None:
    network.shine()
    network.pass_time(11.0)
    assert network.light.faults() == []
    assert network.states[-1].output
    network.pass_time(11.0)
    assert network.light.read().frequency_hz == pytest.approx(50.0)
    network.pass_time(11.0)
    network.see_it_go_dark()
    network.pass_time(11.0)
    network.shine()
    assert network.states[-1].output


def test_a_light_that_restarted_before_it_is_switched_on_stays_dark(network) -> None:
    network.light.apply(FLICKER)
    network.pass_time(11.0)
    network.driver.exchange("SG0042")
    with pytest.raises(LightFault):
        network.light.on()
    assert not network.states[-1].output


def test_what_cannot_be_switched_off_is_said_and_the_port_is_named(network) -> None:
    network.shine()
    network.device.unplug()
    with pytest.raises(PortLost, match="cannot be opened again") as lost:
        network.light.off()
    assert lost.value.where == network.device.address
    network.device.replug()
    network.see_it_go_dark()


def test_a_device_that_needs_a_moment_before_it_accepts_another_connection_is_switched_off(network) -> None:
    network.shine()
    network.device.unplug()
    threading.Timer(0.3, network.device.replug).start()
    network.see_it_go_dark()


def test_another_device_at_the_same_address_is_not_set(network) -> None:
    network.shine()
    network.pass_time(11.0)
    if isinstance(network.light, GardasoftLight):  # it tells no serial number
        receive = network.driver.receive
        network.driver.receive = lambda data: receive(data).replace(b"RT460", b"RT820")
    else:
        network.driver.exchange("XX9999")
    before = len(network.states)
    with pytest.raises(DriverError, match="answered it before"):
        network.light.apply(LightSettings(frequency_hz=75.0, high_v=3.0))
    assert len(network.states) == before


@pytest.mark.slow
def test_a_line_that_a_network_has_forgotten_is_opened_again_to_switch_off() -> None:
    """A gateway drops a connection without a word: nothing comes back, and nothing says why."""
    with closing(Network("gardasoft", idle_s=0.0)) as network:
        network.shine()
        forgotten, receive = network.port.client, network.driver.receive
        network.driver.receive = lambda data: b"" if network.port.client is forgotten else receive(data)
        with pytest.raises(ReplyTimeout):
            network.light.read()
        network.see_it_go_dark()
