"""Generators with USB-TMC through PyVISA: the same dialects, the same behaviour; no read without a query."""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Iterator

import pytest
import pyvisa
from pyvisa.constants import StatusCode
from pyvisa.errors import VisaIOError
from station_texts import PLAIN, station_of

from drivers.clock import SystemClock
from drivers.errors import PortBusy, PortLost, PortNotFound
from drivers.light import LightSettings
from drivers.light.scpi import ScpiLight
from simulators.assembly import make_light
from simulators.config import LightConfig
from simulators.ports.serial_device import SerialDevice, TcpPort

FLICKER = LightSettings("square", 60.0, 30.0, 0.0, 3.3, sync_output=True)
ADDRESS = "visa:USB0::0x1AB1::0x0642::DG1ZA244406036::INSTR"
DIALECTS = {"keysight": "keysight", "rigol": "numbered", "siglent": "siglent"}


class Instrument:
    """A simulated generator as PyVISA shows it: one answer a query; a read without a query is an error."""

    def __init__(self, kind: str = "rigol") -> None:
        self.states = []
        self.device = make_light(LightConfig(kind), time.monotonic, self.states.append)
        self.answer, self.asked = b"", False
        self.timeout = 0
        self.gone = self.never_back = False
        self.slow = 0
        self.reads_without_query = self.opened = 0

    def open_resource(self, name: str, **_settings: object) -> Instrument:
        assert name == ADDRESS.removeprefix("visa:")
        if self.never_back:
            raise ValueError("No device found.")
        self.gone = False
        self.opened += 1
        return self

    def write_raw(self, data: bytes) -> None:
        self._check()
        if self.answer and b"?" in data:
            raise AssertionError("a query while an answer is unread")
        self.asked = b"?" in data
        self.answer = self.device.receive(data)

    def read_raw(self) -> bytes:
        self._check()
        if self.slow:
            self.slow -= 1
            raise VisaIOError(StatusCode.error_timeout)
        if not self.answer:
            self.reads_without_query += not self.asked
            raise VisaIOError(StatusCode.error_timeout)
        answer, self.answer, self.asked = self.answer, b"", False
        return answer

    def clear(self) -> None:
        self.answer = b""

    def close(self) -> None:
        pass

    def _check(self) -> None:
        if self.gone:
            raise OSError(19, "No such device")


def opened(kind: str = "rigol") -> ScpiLight:
    return ScpiLight.open(ADDRESS, dialect=DIALECTS[kind], serial="SG0042", clock=SystemClock())


@pytest.fixture
def kind() -> str:
    return "rigol"


@pytest.fixture
def instrument(monkeypatch, kind) -> Instrument:
    instrument = Instrument(kind)
    monkeypatch.setattr(pyvisa, "ResourceManager", lambda *_: instrument)
    return instrument


@pytest.fixture
def light(instrument, kind) -> Iterator[ScpiLight]:
    light = opened(kind)
    yield light
    light.close()


@pytest.mark.parametrize("kind", DIALECTS)
def test_a_generator_is_set_read_back_and_switched(instrument, light) -> None:
    assert light.apply(FLICKER) == FLICKER
    light.on()
    assert instrument.states[-1].output
    assert light.faults() == []
    light.off()
    assert not instrument.states[-1].output
    assert instrument.reads_without_query == 0


def test_a_station_file_names_a_generator_by_its_address(instrument) -> None:
    station = station_of(PLAIN.replace("port: sim:light", f'dialect: numbered\n  port: "{ADDRESS}"'))
    light = station.light.open_device(str, clock=SystemClock(), wire_log=None)
    light.apply(FLICKER)
    light.on()
    assert instrument.states[-1].output
    light.close()


def test_without_the_extra_one_sentence_says_how_to_install_it(monkeypatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _name: None)
    with pytest.raises(PortNotFound, match=r'needs PyVISA.*pip install "starbench\[visa\]"'):
        opened()


def test_an_instrument_that_is_not_there_is_told_without_the_words_of_a_library(instrument) -> None:
    instrument.never_back = True
    with pytest.raises(PortNotFound, match="find the instrument") as error:
        opened()
    assert "No device found" not in str(error.value)
    assert error.value.where == ADDRESS


def test_a_lost_connection_is_opened_again_and_the_light_is_switched_off(instrument, light) -> None:
    light.apply(FLICKER)
    light.on()
    instrument.gone = True
    assert light.faults() == []
    instrument.gone = instrument.never_back = True
    with pytest.raises(PortLost, match="cannot be opened again"):
        light.off()
    assert instrument.states[-1].output
    instrument.never_back = False
    light.off()
    assert not instrument.states[-1].output
    assert instrument.opened == 3


def test_an_answer_that_came_too_late_is_cleared_and_asked_for_again(instrument, light) -> None:
    light.apply(FLICKER)
    instrument.slow = 1
    assert light.read() == FLICKER


def test_one_instrument_has_one_user(light) -> None:
    with pytest.raises(PortBusy):
        opened()
    light.close()
    opened().close()


def test_a_plain_socket_of_visa_is_a_socket() -> None:
    states = []
    driver = make_light(LightConfig("rigol"), time.monotonic, states.append)
    with SerialDevice(TcpPort("light"), driver, paced=False) as device:
        number = device.address.rpartition(":")[2]
        light = ScpiLight.open(
            f"visa:TCPIP0::127.0.0.1::{number}::SOCKET", dialect="numbered", clock=SystemClock()
        )
        assert light.apply(FLICKER) == FLICKER
        light.on()
        assert states[-1].output
        light.close()
