"""Every family of lights on its simulated driver, on a virtual clock: one behaviour.

What its faults do stands in test_every_light_fault.py, what a port does in test_plugin_contract.py.
"""

import numpy as np
import pytest

from drivers.errors import DriverError, SettingRefused
from drivers.light import LightSettings
from drivers.light.scpi import ScpiLight
from simulators.faults.line_faults import LineFault
from simulators.lights.generators import GeneratorModel, ScpiGenerator
from tests.hil.direct_lights import OPENED, DirectLight, direct_light
from tests.hil.direct_stages import VirtualClock, direct_line

pytestmark = pytest.mark.usefixtures("never_late")

FLICKER = LightSettings("square", 50.0, 40.0, 0.0, 3.0, sync_output=True)


OFFS = {
    "keysight": b"OUTP OFF",
    "rigol": b"OUTP1 OFF",
    "siglent": b"C1:OUTP OFF",
    "gardasoft": b"TT0",
    "microcontroller": b"OFF",
}


IDENTITIES = {
    "keysight": ("Keysight Technologies", "33250A", "SG0042", "2.05-1.01-2.00-03-2"),
    "rigol": ("Rigol Technologies", "DG4062", "SG0042", "00.01.12"),
    "siglent": ("Siglent Technologies", "SDG1032X", "SG0042", "1.01.01.33R6"),
    "gardasoft": ("Gardasoft", "RT460-20", "", "V031"),
    "microcontroller": ("Starbench", "microcontroller light", "SG0042", "sim-1.0"),
}
"""Maker, model, serial number and firmware."""


@pytest.fixture(params=OPENED)
def rig(request) -> DirectLight:
    return direct_light(request.param, VirtualClock(), np.random.default_rng(1))


def test_a_light_is_identified_set_read_back_and_switched(rig) -> None:
    light, states = rig.light, rig.states
    identity = light.identify()
    assert (identity.maker, identity.model, identity.serial, identity.firmware) == IDENTITIES[rig.kind]
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


def test_off_does_not_wait_for_the_line_to_come_into_step(rig) -> None:
    rig.light.apply(FLICKER)
    rig.light.on()
    rig.line.lose_step(rig.light.is_on)
    rig.light.off()
    assert OFFS[rig.kind] in rig.line.sent[0]
    assert not rig.states[-1].output


def test_what_it_cannot_do_is_refused_and_it_still_works(rig) -> None:
    with pytest.raises(SettingRefused):
        rig.light.apply(LightSettings(frequency_hz=1e12))
    assert rig.light.apply(FLICKER).frequency_hz == pytest.approx(50.0, rel=1e-6)


def test_opening_and_closing_switch_nothing(rig) -> None:
    rig.light.apply(FLICKER)
    rig.light.on()
    rig.light.close()
    assert rig.line.closed
    assert rig.states[-1].output
    again = OPENED[rig.kind](rig.line, rig.line.clock)
    assert again.is_on()
    assert again.read().frequency_hz == pytest.approx(50.0, rel=1e-6)
    assert rig.states[-1].output


def test_a_stranger_on_the_port_is_refused(rig) -> None:
    rig.line.device.inject(LineFault("stranger", count=None))
    with pytest.raises(DriverError):
        OPENED[rig.kind](rig.line, rig.line.clock)


def test_a_steady_light_burns_at_its_level_without_an_edge_and_goes_dark(rig) -> None:
    light, states = rig.light, rig.states
    got = light.apply(LightSettings("steady", high_v=3.0))
    assert (got.waveform, got.high_v, got.sync_output) == ("steady", pytest.approx(3.0, abs=2e-3), False)
    assert not any(state.output for state in states)
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
def test_an_inverted_sync_output_of_a_simulated_generator_is_made_normal(maker, inverted) -> None:
    clock, states = VirtualClock(), []
    model = GeneratorModel(numbered_channels=True, maker=maker)
    generator = ScpiGenerator(model, clock.monotonic, states.append)
    generator.receive(f"OUTP1:SYNC:POL {inverted}\n".encode())
    assert states[-1].sync_line.inverted
    line = direct_line(generator, clock)
    light = ScpiLight(line, dialect="numbered", clock=clock)
    assert states[-1].sync_line.inverted  # opening sets nothing
    assert light.sync_polarity() == "normal"
    assert not states[-1].sync_line.inverted
