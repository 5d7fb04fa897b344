"""The SCPI driver on a simulated generator, what is its own; see also test_light_families."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import closing

import pytest

from drivers.clock import SystemClock
from drivers.errors import ReplyError, SettingRefused, WrongDevice
from drivers.light import LightSettings
from drivers.light.scpi import ScpiLight
from simulators.lights.generators import GeneratorModel, ScpiGenerator
from simulators.ports.pseudo_terminal import PseudoTerminal
from simulators.ports.serial_device import SerialDevice

FLICKER = LightSettings("square", 60.0, 40.0, 0.0, 3.3, sync_output=True)


@pytest.fixture
def generator(tmp_path) -> Iterator[Callable[..., SerialDevice]]:
    devices = []

    def make(**model) -> SerialDevice:
        dialect = ScpiGenerator(GeneratorModel(**model), time.monotonic)
        device = SerialDevice(PseudoTerminal(tmp_path / f"light{len(devices)}"), dialect)
        device.start()
        devices.append(device)
        return device

    yield make
    for device in devices:
        device.close()


@pytest.fixture
def device(generator) -> SerialDevice:
    return generator()


@pytest.fixture
def light(device) -> Iterator[ScpiLight]:
    with closing(ScpiLight.open(device.address, serial="SG0042", clock=SystemClock())) as light:
        yield light


def test_a_sine_is_set_and_read_back(light) -> None:
    sine = LightSettings("sine", 59.94, low_v=1.0, high_v=2.0, sync_output=False)
    assert light.apply(sine) == sine


def test_a_generator_without_error_queue_is_served(generator) -> None:
    device = generator(error_queue=False)
    with closing(ScpiLight.open(device.address, clock=SystemClock())) as light:
        assert light.apply(FLICKER) == FLICKER
        with pytest.raises(SettingRefused, match="frequency"):
            light.apply(LightSettings("square", 1e12))


def test_another_generator_is_refused(device) -> None:
    with pytest.raises(WrongDevice, match="SG0042"):
        ScpiLight.open(device.address, serial="SG0001", clock=SystemClock())


def test_a_wrong_baud_rate_is_told(device) -> None:
    with pytest.raises(ReplyError):
        ScpiLight.open(device.address, baudrate=115200, clock=SystemClock())
