"""Answers as instruments give them: identities with five fields, prompts, echoes, numbers in other forms."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import ReplyError, SettingRefused
from drivers.light import LightIdentity, LightSettings
from drivers.quantity import read_quantity
from tests.unit.drivers.light.generator_bench import Bench

pytestmark = pytest.mark.usefixtures("never_late")

FLICKER = LightSettings("square", 60.0, 30.0, 0.0, 3.3, sync_output=True)


# ---------------------------------------------------------------- who answers


@pytest.mark.parametrize(
    ("answer", "identity"),
    [
        (
            "*IDN SDG,SDG1025,SDG10GA1234567,1.01.01.39R5,04-00-00-30-28",
            LightIdentity("SDG", "SDG1025", "SDG10GA1234567", "1.01.01.39R5,04-00-00-30-28"),
        ),
        (
            "RIGOL TECHNOLOGIES,DG1022 ,DG1D144904270,,00.03.00.09.00.02.11",
            LightIdentity("RIGOL TECHNOLOGIES", "DG1022", "DG1D144904270", "00.03.00.09.00.02.11"),
        ),
        (
            "Agilent Technologies,33522B,MY52800001,3.05-1.19-2.00-52-00",
            LightIdentity("Agilent Technologies", "33522B", "MY52800001", "3.05-1.19-2.00-52-00"),
        ),
        ("Maker,Model,,", LightIdentity("Maker", "Model", "", "")),
    ],
)
def test_an_identity_has_four_fields_or_more(answer, identity) -> None:
    bench = Bench()
    bench.answer({"*IDN": answer})
    assert bench.open(serial=identity.serial or None).identify() == identity


@pytest.mark.parametrize(
    "answer", ["+1,2,3,4", "hello", "a,b", ",,1,2", "Agilent Technologies,33220A-SIM,1.0"]
)
def test_what_is_no_identity_is_named_and_no_cable_is_blamed(answer) -> None:
    bench = Bench()
    bench.answer({"*IDN": answer})
    with pytest.raises(ReplyError, match="IEEE 488") as caught:
        bench.open()
    assert repr(answer) in caught.value.what
    assert "cable" not in str(caught.value)
    assert bench.line.closed


# ---------------------------------------------------------------- what surrounds an answer


PROMPTED = {
    "a prompt after each answer": lambda sent, reply: reply.replace(b"\n", b"\r\n> "),
    "a prompt with a name": lambda sent, reply: reply.replace(b"\n", b"\r\n33500B> "),
    "a prompt before each answer": lambda sent, reply: re.sub(rb"(?m)^(?=.)", b"SCPI> ", reply),
    "two line ends": lambda sent, reply: reply.replace(b"\n", b"\r\n\r\n"),
    "line ends the other way round": lambda sent, reply: reply.replace(b"\n", b"\n\r"),
    "CR alone": lambda sent, reply: reply.replace(b"\n", b"\r"),
    "an empty line first": lambda sent, reply: b"\r\n" + reply if reply else reply,
    "an echo": lambda sent, reply: sent.replace(b"\n", b"\r\n") + reply,
    "echo and prompt": lambda sent, reply: sent.replace(b"\n", b"\r\n") + reply + b"33500B> ",
    "blanks around": lambda sent, reply: b"  " + reply.replace(b"\n", b"  \n") if reply else reply,
    "quotation marks": lambda sent, reply: reply.replace(b"SQU", b'"SQU"'),
    "the channel before": lambda sent, reply: reply.replace(b"SQU", b"CH1:SQU").replace(b"+6.", b"CH1:+6."),
}


NOT_SIGLENT = {"quotation marks", "the channel before"}


@pytest.mark.parametrize(
    ("form", "dialect"),
    [
        (form, dialect)
        for form in PROMPTED
        for dialect in ("keysight", "numbered", "siglent")
        if dialect != "siglent" or form not in NOT_SIGLENT
    ],
)
def test_an_answer_is_read_among(form, dialect) -> None:
    bench = Bench(dialect)
    receive = bench.line.device.receive
    bench.line.device.receive = lambda data: PROMPTED[form](data, receive(data))
    light = bench.open()
    assert light.apply(FLICKER) == FLICKER
    light.on()
    assert bench.lit()
    assert light.faults() == []
    light.off()
    assert not bench.lit()


@pytest.mark.parametrize("empty", ['0,"No error"', "0", "+0", "0 No error", "0, No error", '+0 , "No error"'])
def test_an_empty_error_queue_is_known_in_another_form(empty) -> None:
    bench = Bench()
    bench.answer({"SYST:ERR": empty})
    assert bench.open().apply(FLICKER) == FLICKER


# ---------------------------------------------------------------- numbers


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("60HZ", "Hz", 60.0),
        ("0.06KHZ", "Hz", 60.0),
        ("0.06 kHz", "Hz", 60.0),
        ("6e1 Hz", "Hz", 60.0),
        ("60000000uHz", "Hz", 60.0),
        ("0.00006MHZ", "Hz", 60.0),
        ("60,00", "Hz", 60.0),
        ("+6.0000000E+01", "Hz", 60.0),
        ("1 234.5 Hz", "Hz", 1234.5),
        ("3300MV", "V", 3.3),
        ("3.3Vpp", "V", 3.3),
        ("- 3,3 V", "V", -3.3),
        ("30%", "%", 30.0),
        ("30 PCT", "%", 30.0),
        ("20ms", "s", 0.02),
    ],
)
def test_a_number_is_read_in_the_forms_of_the_field(text, unit, value) -> None:
    quantity = read_quantity(text, unit)
    assert quantity is not None
    assert quantity.value == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    "text", ["", ".", "V", "60KZ", "60V", "1E999HZ", "1e308kHz", "nan", "inf", "60 60", "6O"]
)
def test_what_is_no_number_of_that_unit_is_none(text) -> None:
    assert read_quantity(text, "Hz") is None


@given(st.text(max_size=30), st.sampled_from(["", "Hz", "V", "%", "s"]))
def test_any_text_is_a_finite_number_or_none(text, unit) -> None:
    quantity = read_quantity(text, unit)
    assert quantity is None or (abs(quantity.value) < float("inf") and quantity.half_digit >= 0)


@given(st.floats(1e-3, 1e8), st.integers(4, 12))
def test_a_number_printed_with_at_least_four_digits_agrees_with_itself(value, digits) -> None:
    quantity = read_quantity(f"{value:.{digits}g} Hz", "Hz")
    assert quantity is not None
    assert quantity.agrees_with(value)
    assert not quantity.agrees_with(value * 1.01)


@pytest.mark.parametrize("digits", [6, 4])
@pytest.mark.parametrize("unit", [("", 1.0), (" kHz", 1e-3), ("MHZ", 1e-6)])
@pytest.mark.parametrize("comma", [False, True])
@pytest.mark.parametrize("frequency_hz", [50.0, 123.456789])
def test_a_siglent_with_fewer_digits_and_other_units_is_taken_at_its_word(digits, unit, comma, frequency_hz):
    bench = Bench("siglent")
    name, factor = unit

    def printed(match: re.Match[bytes]) -> bytes:
        text = f"{float(match[1]) * factor:.{digits}g}"
        return f"FRQ,{text.replace('.', ',') if comma else text}{name}".encode()

    bench.line.spoil = lambda reply: re.sub(rb"FRQ,([\d.]+)HZ", printed, reply)
    got = bench.open().apply(LightSettings("square", frequency_hz, 30.0, 0.0, 3.3))
    assert got.frequency_hz == pytest.approx(frequency_hz, rel=1e-3)


@pytest.mark.parametrize(
    ("asked_hz", "printed"), [(60.4, b"60HZ"), (60.0, b"61HZ"), (1234.5, b"1.3KHZ"), (50.0, b"50.1HZ")]
)
def test_another_frequency_than_the_digits_can_hide_is_refused(asked_hz, printed) -> None:
    bench = Bench("siglent")
    bench.line.spoil = lambda reply: re.sub(rb"FRQ,[\d.]+HZ", b"FRQ," + printed, reply)
    with pytest.raises(SettingRefused, match="frequency_hz: asked"):
        bench.open().apply(LightSettings("square", asked_hz, 30.0, 0.0, 3.3))


@pytest.mark.parametrize("header", ["SHORT", "LONG", "OFF"])
def test_a_late_answer_of_a_siglent_is_not_taken_for_another(header) -> None:
    bench = Bench("siglent")
    if header != "SHORT":
        bench.device.leave(f"CHDR-{header}")
    light = bench.open()
    light.apply(FLICKER)
    for stranger in (b"C1:SYNC ON\n", b"ON\n", b"C1:OUTPUT ON,LOAD,HZ,PLRT,NOR\n", b"OFF,LOAD,HZ\n"):
        bench.line.spoil = lambda reply, stranger=stranger: stranger if b"WVTP" in reply else reply
        with pytest.raises(ReplyError):
            light.read()
