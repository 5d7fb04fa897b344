"""Every family of lights on its simulated controller: one behaviour, every clipped setting noticed."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pytest

from drivers.clock import SystemClock
from drivers.errors import PortBusy, PortLost, ReplyError, SettingRefused
from drivers.light import Light, LightSettings
from drivers.light.gardasoft import GardasoftLight
from drivers.light.scpi import ScpiLight
from drivers.light.text import TextLight
from simulators.lights.gardasoft import GardasoftRt
from simulators.lights.generators import GeneratorModel, ScpiGenerator
from simulators.lights.microcontroller import MicrocontrollerLight
from simulators.lights.siglent import SiglentGenerator
from simulators.ports.pseudo_terminal import PseudoTerminal
from simulators.ports.serial_device import SerialDevice
from tests.hil.direct_lights import MICROCONTROLLER

FLICKER = LightSettings("square", 50.0, 40.0, 0.0, 3.0, sync_output=True)


def keysight(drive: Callable) -> tuple[object, Callable[..., Light]]:
    return ScpiGenerator(GeneratorModel(), time.monotonic, drive), ScpiLight.open


def numbered(drive: Callable) -> tuple[object, Callable[..., Light]]:
    model = GeneratorModel(numbered_channels=True)
    return ScpiGenerator(model, time.monotonic, drive), lambda port, **more: ScpiLight.open(
        port, dialect="numbered", **more
    )


def siglent(drive: Callable) -> tuple[object, Callable[..., Light]]:
    return SiglentGenerator("SDG1XCAQ3R1234", time.monotonic, drive), lambda port, **more: ScpiLight.open(
        port, dialect="siglent", **more
    )


def gardasoft(drive: Callable) -> tuple[object, Callable[..., Light]]:
    return GardasoftRt(time.monotonic, drive), GardasoftLight.open


def microcontroller(drive: Callable) -> tuple[object, Callable[..., Light]]:
    return MicrocontrollerLight("SB1", time.monotonic, drive), lambda port, **more: TextLight.open(
        port, MICROCONTROLLER, **more
    )


@pytest.fixture
def states() -> list:
    """What the lamp was driven to, in turn."""
    return []


EVERY = [keysight, numbered, siglent, gardasoft, microcontroller]
each_in_turn = pytest.mark.parametrize(
    "device", [keysight, *(pytest.param(make, marks=pytest.mark.slow) for make in EVERY[1:])], indirect=True
)


@pytest.fixture(params=EVERY)
def device(request, tmp_path: Path, states) -> Iterator[tuple[SerialDevice, Callable[[], Light]]]:
    dialect, opened = request.param(states.append)
    with SerialDevice(PseudoTerminal(tmp_path / "light"), dialect) as device:
        yield device, lambda **more: opened(device.address, clock=SystemClock(), **more)


@pytest.fixture
def light(device) -> Iterator[Light]:
    with closing(device[1]()) as light:
        yield light


def test_a_light_is_identified_set_read_back_and_switched(light, states) -> None:
    assert light.identify().maker
    assert not light.is_on()
    got = light.apply(FLICKER)
    assert (got.waveform, got.sync_output) == ("square", True)
    assert got.frequency_hz == pytest.approx(50.0, rel=1e-6)
    assert got.duty_percent == pytest.approx(40.0, rel=1e-3)
    assert (got.low_v, got.high_v) == pytest.approx((0.0, 3.0), abs=2e-3)
    assert light.read() == got
    assert not light.is_on()
    assert not any(state.output for state in states)
    light.on()
    assert light.is_on()
    assert states[-1].output
    assert states[-1].frequency_hz == pytest.approx(50.0)
    assert light.faults() == []
    light.off()
    assert not light.is_on()
    assert not states[-1].output


@each_in_turn
def test_what_it_cannot_do_is_refused_and_it_still_works(light) -> None:
    with pytest.raises(SettingRefused):
        light.apply(LightSettings(frequency_hz=1e12))
    assert light.apply(FLICKER).frequency_hz == pytest.approx(50.0, rel=1e-6)


@each_in_turn
def test_a_second_opening_is_refused(device, light) -> None:
    with pytest.raises(PortBusy):
        device[1]()
    assert light.is_on() is False


@each_in_turn
def test_opening_and_closing_switch_nothing(device, states) -> None:
    with closing(device[1]()) as light:
        light.apply(FLICKER)
        light.on()
    with closing(device[1]()) as again:
        assert again.is_on()
        assert again.read().frequency_hz == pytest.approx(50.0, rel=1e-6)
    assert states[-1].output


@each_in_turn
def test_a_wrong_baud_rate_is_told_and_switches_nothing(device, states) -> None:
    with pytest.raises(ReplyError):
        device[1](baudrate=38400)
    assert not any(state.output for state in states)
    device[1]().close()


@each_in_turn
def test_an_unplugged_light_is_lost(device, light) -> None:
    device[0].unplug()
    with pytest.raises(PortLost):
        light.is_on()


@each_in_turn
def test_a_steady_light_burns_at_its_level_without_an_edge_and_goes_dark(device, states) -> None:
    with closing(device[1]()) as light:
        got = light.apply(LightSettings("steady", high_v=3.0))
        assert (got.waveform, got.high_v, got.sync_output) == ("steady", pytest.approx(3.0, abs=2e-3), False)
        assert not states[-1].output
        light.on()
        burning = states[-1]
        assert burning.output
        assert burning.low == burning.high == pytest.approx(0.6, abs=1e-3)
        assert not burning.sync
        light.off()
        assert not light.is_on()
        assert not states[-1].output or states[-1].high == 0.0
        light.apply(FLICKER)
        light.on()
        assert states[-1].low == 0.0 < states[-1].high


@pytest.mark.parametrize(
    ("maker", "inverted"), [("Agilent Technologies", "INV"), ("RIGOL TECHNOLOGIES", "NEG")]
)
def test_an_inverted_sync_output_of_a_simulated_generator_is_made_normal(
    tmp_path, states, maker, inverted
) -> None:
    generator = ScpiGenerator(
        GeneratorModel(numbered_channels=True, maker=maker), time.monotonic, states.append
    )
    generator.receive(f"OUTP1:SYNC:POL {inverted}\n".encode())
    assert states[-1].sync_line.inverted
    with SerialDevice(PseudoTerminal(tmp_path / "light"), generator) as device:
        light = ScpiLight.open(device.address, dialect="numbered", clock=SystemClock())
        with closing(light):
            assert light.sync_polarity() == "normal"
    assert not states[-1].sync_line.inverted
