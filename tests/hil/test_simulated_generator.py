"""The simulated function generator, line by line; test_wire_parity.py has it driven by an independent client."""

from functools import partial

import pytest

from simulators.lights.generators import GeneratorModel, ScpiGenerator
from simulators.lights.siglent import SiglentGenerator
from tests.hil.direct_lights import LightAlone


def made(**model) -> LightAlone:
    return LightAlone(partial(ScpiGenerator, GeneratorModel(**model)), "\n")


@pytest.fixture
def generator() -> LightAlone:
    return made()


@pytest.mark.parametrize(
    ("command", "query", "answer"),
    [
        ("FUNC SQU", "FUNC?", "SQU"),
        ("function:shape square", ":SOURCE:FUNC:SHAP?", "SQU"),
        ("FREQ 1.5E3", "FREQUENCY?", "+1.5000000000000E+03"),
        ("SOUR:FREQ 6E1", "FREQ?", "+6.0000000000000E+01"),
        ("FUNC:SQU:DCYC 35.5", "func:squ:dcyc?", "+3.5500000000000E+01"),
        ("VOLT:UNIT VPP", "VOLT:UNIT?", "VPP"),
        ("VOLT:HIGH 3;LOW -1", "VOLT:HIGH?;OFFS?", "+3.0000000000000E+00;+1.0000000000000E+00"),
        ("OUTPUT:STATE 1", "OUTP?", "1"),
        ("OUTP:SYNC OFF", "OUTP:SYNC?", "0"),
    ],
)
def test_a_setting_reads_back_in_any_form_of_its_header(generator, command, query, answer):
    assert generator.say(command) == ""
    assert generator.say(query) == answer + "\n"
    assert generator.say("SYST:ERR?") == '+0,"No error"\n'


@pytest.mark.parametrize(
    ("command", "code"),
    [
        ("FREQUEN 60", -113),
        ("VOLT:HIGH 2;VOLT:LOW 0", -113),
        ("FREQ sixty", -104),
        ("FREQ", -109),
        ("FREQ 60,70", -108),
        ("FUNC TRIANGLE", -224),
        ("FREQ 1e12", -222),
        ("FUNC:SQU:DCYC 5", -222),
        ("VOLT:HIGH 40", -222),
        ("VOLT:LOW 0;HIGH -1", -221),
    ],
)
def test_a_fault_waits_in_the_queue_until_it_is_asked_for(generator, command, code):
    assert generator.say(command) == ""
    assert generator.say("SYST:ERR?").startswith(f"{code},")
    assert generator.say("SYST:ERR?") == '+0,"No error"\n'


@pytest.mark.parametrize(
    ("command", "query", "held"),
    [
        ("VOLT:LOW -7", "VOLT:LOW?", -5.0),
        ("VOLT:HIGH 7", "VOLT:HIGH?", 5.0),
        ("VOLT:OFFS 6", "VOLT:OFFS?", 4.95),
        ("FREQ 0", "FREQ?", 1e-6),
        ("OUTP:LOAD 0.5", "OUTP:LOAD?", 1.0),
    ],
)
def test_each_value_is_held_at_its_own_limit(generator, command, query, held):
    generator.say(command)
    assert float(generator.say(query)) == pytest.approx(held, abs=1e-6)
    assert generator.say("SYST:ERR?").startswith("-222,")


def test_an_open_lamp_sees_twice_the_voltage_shown_for_fifty_ohm(generator):
    generator.say("VOLT:HIGH 2;LOW 0")
    assert (generator.light.low_v, generator.light.high_v) == pytest.approx((0.0, 4.0))
    generator.say("OUTP:LOAD INF")
    assert generator.say("VOLT:HIGH?") == "+4.0000000000000E+00\n"
    assert generator.light.high_v == pytest.approx(4.0)


# ---------------------------------------------------------------- other makes
def test_a_make_with_numbered_channels_answers_on_and_off():
    generator = made(numbered_channels=True, maker="RIGOL TECHNOLOGIES", name="DG4062")
    generator.say(":SOUR1:FUNC SQU", ":SOUR1:FREQ 60", ":OUTPUT1:STATE ON", ":OUTP1:SYNC OFF")
    assert generator.say(":SOUR1:FREQ?") == "+6.0000000000000E+01\n"
    assert generator.say("OUTP1?;:OUTP1:SYNC?") == "ON;OFF\n"
    assert generator.say("SOURCE1:FUNCTION:SHAPE?;:OUTP1?") == "SQU;ON\n"
    assert generator.light.output
    assert generator.say(":SOUR2:FREQ 60;:SYST:ERR?") == ""
    assert generator.say("SYST:ERR?").startswith("-113,")


@pytest.fixture
def siglent() -> LightAlone:
    return LightAlone(partial(SiglentGenerator, "SDG1"), "\n")


def test_a_siglent_sets_several_values_at_once_and_reports_all(siglent):
    assert not siglent.say("C1:OUTP LOAD,HZ", "C1:BSWV WVTP,SQUARE,FRQ,60HZ,HLEV,4V,LLEV,0V,DUTY,30")
    assert not siglent.say("C1:OUTP ON")
    assert siglent.say("C1:BSWV?") == (
        "C1:BSWV WVTP,SQUARE,FRQ,60HZ,PERI,0.0166667S,AMP,4V,OFST,2V,HLEV,4V,LLEV,0V,PHSE,0,DUTY,30\n"
    )
    assert siglent.say("C1:OUTP?") == "C1:OUTP ON,LOAD,HZ,PLRT,NOR\n"
    assert siglent.say("C1:SYNC OFF;C1:SYNC?") == "C1:SYNC OFF\n"
    assert siglent.say("*IDN?") == "Siglent Technologies,SDG1032X,SDG1,1.01.01.33R6\n"
    assert (siglent.light.frequency_hz, siglent.light.high_v, siglent.light.output) == (60.0, 4.0, True)


def test_a_siglent_clips_values_and_ignores_invalid_ones_silently(siglent):
    assert not siglent.say("C1:BSWV WVTP,SQUARE,DUTY,5", "C1:BSWV FRQ,fast", "C1:NONSENSE 5")
    assert not siglent.say("hello", "SYST:ERR?")
    assert ",DUTY,20\n" in siglent.say("C1:BSWV?")
