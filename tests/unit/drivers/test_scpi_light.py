"""The SCPI light: what it sends, and that no setting is taken for made that was not.

A small model of a generator answers in memory; each test breaks one thing about it.
"""

from __future__ import annotations

import pytest

from drivers.clock import SystemClock
from drivers.errors import DriverError, LightFault, ReplyError, SettingRefused, WrongDevice
from drivers.light import LightSettings
from drivers.light.scpi import DIALECTS, DialectName, ScpiLight
from drivers.text_line import ScpiLine
from tests.unit.drivers.generator_peer import Generator, NumberedGenerator, SiglentGenerator


@pytest.fixture
def generator() -> Generator:
    return Generator()


@pytest.fixture
def light(generator, clock) -> ScpiLight:
    return ScpiLight(generator, serial="SG0042", clock=clock)


FLICKER = LightSettings("square", 60.0, 30.0, 0.0, 3.3, sync_output=True)


def test_opening_sets_and_switches_nothing(light, generator) -> None:
    assert generator.commands() == []


def test_identity_is_what_the_generator_says(light) -> None:
    identity = light.identify()
    assert (identity.maker, identity.model) == ("Agilent Technologies", "33250A")
    assert (identity.serial, identity.firmware) == ("SG0042", "2.00")


def beside_modes(generator: Generator, dialect: DialectName) -> list[str]:
    """Commands that it was sent, those aside that end what somebody may have left on."""
    ended = {command for _, command in DIALECTS[dialect].reset_modes()}
    return [command for command in generator.commands() if command not in ended]


def test_another_serial_number_is_refused(generator, clock) -> None:
    with pytest.raises(
        WrongDevice, match="serial SG0043, but Agilent Technologies 33250A with serial SG0042"
    ):
        ScpiLight(generator, serial="SG0043", clock=clock)
    assert generator.closed
    assert generator.commands() == []


def test_a_flicker_is_set_in_the_generators_words(light, generator) -> None:
    assert light.apply(FLICKER) == FLICKER
    assert beside_modes(generator, "keysight") == [
        "OUTP:LOAD INF",
        "FUNC SQU",
        "FREQ 60",
        "FUNC:SQU:DCYC 30",
        "VOLT:HIGH 3.3",
        "VOLT:LOW 0",
        "OUTP:SYNC ON",
    ]
    assert generator.values["OUTP"] == "0"


def test_a_sine_has_no_duty(light, generator) -> None:
    sine = LightSettings("sine", 59.94, low_v=1.0, high_v=2.0, sync_output=False)
    assert light.apply(sine) == sine
    assert not any("DCYC" in line for line in generator.sent)


@pytest.mark.parametrize(("low", "high"), [(6.0, 8.0), (-8.0, -6.0), (-5.0, 0.5)])
def test_levels_are_set_in_an_order_that_never_crosses_them(light, generator, low, high) -> None:
    generator.values.update({"VOLT:LOW": low, "VOLT:HIGH": high})
    light.apply(FLICKER)
    assert (generator.values["VOLT:LOW"], generator.values["VOLT:HIGH"]) == (0.0, 3.3)


def test_a_clipped_value_with_an_error_is_refused(light, generator) -> None:
    generator.highest_hz = 50.0
    with pytest.raises(SettingRefused, match=r'frequency is refused: .FREQ 60. .*-222 "Data out of range"'):
        light.apply(FLICKER)


def test_a_value_clipped_in_silence_is_refused_with_both_values(light, generator) -> None:
    generator.highest_hz = 50.0
    generator.has_queue = False
    quiet = ScpiLight(generator, clock=SystemClock())
    with pytest.raises(SettingRefused, match=r"frequency_hz: asked 60\.0, got 50\.0"):
        quiet.apply(FLICKER)


@pytest.mark.parametrize(
    ("header", "value", "name"),
    [
        ("FREQ", 59.94, "frequency_hz"),
        ("FUNC:SQU:DCYC", 50.0, "duty_percent"),
        ("VOLT:HIGH", 3.2, "high_v"),
        ("VOLT:LOW", 0.1, "low_v"),
        ("OUTP:SYNC", "0", "sync_output"),
        ("FUNC", "SIN", "waveform"),
    ],
)
def test_a_setting_that_does_not_stick_is_refused(light, generator, header, value, name) -> None:
    read = generator.answer
    generator.answer = lambda asked: (
        (value if isinstance(value, str) else f"{value:.6g}") if asked == header else read(asked)
    )
    with pytest.raises(SettingRefused, match=f"{name}: asked"):
        light.apply(FLICKER)


def test_rounding_to_the_generators_digits_is_no_refusal(light, generator) -> None:
    read = generator.answer
    generator.answer = lambda asked: (
        {"FREQ": "+6.000000E+01", "VOLT:HIGH": "3.3003"}.get(asked) or read(asked)
    )
    assert light.apply(FLICKER).high_v == pytest.approx(3.3003)


def test_a_generator_without_error_queue_is_served_all_the_same(generator, clock) -> None:
    generator.has_queue = False
    light = ScpiLight(generator, clock=clock)
    assert light.apply(FLICKER) == FLICKER
    light.on()
    assert light.faults() == []


def test_a_generator_without_load_setting_is_told_how_to_be_named(light, generator) -> None:
    del generator.values["OUTP:LOAD"]
    with pytest.raises(SettingRefused, match="load: unchanged"):
        light.apply(FLICKER)
    assert ScpiLight(generator, clock=SystemClock(), load="unchanged").apply(FLICKER) == FLICKER


def test_errors_from_before_us_are_not_ours(generator, clock) -> None:
    generator.queue = ['-410,"Query INTERRUPTED"', '-222,"Data out of range"']
    light = ScpiLight(generator, clock=clock)
    assert light.apply(FLICKER) == FLICKER


def test_the_output_is_switched_and_seen_to_be(light, generator) -> None:
    assert not light.is_on()
    light.on()
    assert light.is_on()
    light.off()
    assert not light.is_on()
    assert generator.commands() == ["OUTP ON", "OUTP OFF"]


@pytest.mark.parametrize(("word", "on"), [("1", True), ("ON", True), ("0", False), ("OFF", False)])
def test_on_and_off_are_read_in_either_dialect(light, generator, word, on) -> None:
    generator.values["OUTP"] = word
    assert light.is_on() is on


def test_an_output_that_does_not_come_on_is_a_fault(light, generator) -> None:
    generator.set = lambda header, value: None
    with pytest.raises(LightFault, match="switched on, but reads off"):
        light.on()


def test_an_output_that_does_not_go_off_is_a_fault(light, generator) -> None:
    light.on()
    generator.set = lambda header, value: None
    with pytest.raises(LightFault, match="by hand"):
        light.off()
    assert generator.commands().count("OUTP OFF") == 2


def test_an_output_that_goes_dark_by_itself_is_told(light, generator) -> None:
    light.on()
    assert light.faults() == []
    generator.values["OUTP"] = "0"
    generator.queue.append('-315,"Overload"')
    assert light.faults() == [
        'the generator reports -315 "Overload"',
        "the output was switched on, but is off",
    ]


def test_off_goes_out_before_the_line_comes_into_step(light, generator) -> None:
    light.on()
    generator.spoil = lambda line: b""
    with pytest.raises(ReplyError):
        light.is_on()
    generator.spoil = lambda line: line
    generator.sent.clear()
    light.off()
    assert generator.sent[0] == "OUTP OFF"
    assert generator.values["OUTP"] == "0"


def test_another_waveform_is_told_not_taken_for_one_of_ours(light, generator) -> None:
    generator.values["FUNC"] = "RAMP"
    with pytest.raises(LightFault, match="waveform is 'RAMP'"):
        light.read()


def test_a_late_reply_never_becomes_another_setting(light, generator) -> None:
    light.apply(FLICKER)
    held = []

    def hold_one(line: bytes) -> bytes:
        if not held and b"E+" in line:
            held.append(line)
            return b""
        return line

    def release(line: str) -> None:
        if held and held[0]:
            generator.ready += held[0]
            held[0] = b""

    generator.spoil, generator.before = hold_one, release
    assert light.read() == FLICKER
    assert held == [b""]


def test_a_digit_changed_on_the_line_is_not_believed(light, generator) -> None:
    light.apply(FLICKER)
    hit = []

    def spoil(line: bytes) -> bytes:
        if b"+6.0" in line and not hit:
            hit.append(line)
            return line.replace(b"+6.0", b"+6.1")
        return line

    generator.spoil = spoil
    assert light.read() == FLICKER
    assert hit


@pytest.mark.parametrize(
    "garbage", [b"\xff\xfe\r\n", b"\r\n", b"six\r\n", b"nan\r\n", b"6_0\r\n", b"1E999\r\n", b"1,2\r\n"]
)
def test_what_is_no_number_is_refused(light, generator, garbage) -> None:
    generator.spoil = lambda line: garbage if b"E+" in line else line
    with pytest.raises(ReplyError):
        light.read()


@pytest.mark.parametrize("said", ["hello", "Agilent Technologies,33220A-SIM,1.0", ",,1,2"])
def test_something_else_than_an_instrument_is_refused_with_what_it_said(generator, clock, said) -> None:
    """Instruments with three fields exist; "no identity" was all that was told."""
    generator.identity = said
    with pytest.raises(ReplyError, match=r"the four fields of IEEE 488\.2, was expected") as caught:
        ScpiLight(generator, clock=clock)
    assert repr(said) in caught.value.what
    assert generator.closed


def test_a_silent_port_is_refused(scripted, clock) -> None:
    port = scripted([(b"*IDN?\n", b"")] * 3)
    with pytest.raises(DriverError, match="no complete reply"):
        ScpiLight(port, clock=clock)


def test_a_query_the_instrument_does_not_know_is_told_in_its_words(generator, clock) -> None:
    line = ScpiLine(generator, clock=clock)
    with pytest.raises(DriverError, match=r'FLICKER\? is refused: -113 "Undefined header"'):
        line.query("FLICKER?")


def test_an_error_queue_that_never_ends_is_given_up(generator, clock) -> None:
    line = ScpiLine(generator, clock=clock)
    generator.answer = lambda header: '-222,"Data out of range"'
    with pytest.raises(ReplyError, match="never ends"):
        line.read_errors()


def test_closing_switches_nothing(light, generator) -> None:
    light.on()
    light.close()
    assert generator.closed
    assert generator.values["OUTP"] == "1"


# ---------------------------------------------------------------- other makes
OTHERS = pytest.mark.parametrize(
    ("dialect", "make"), [("numbered", NumberedGenerator), ("siglent", SiglentGenerator)]
)
SINE = LightSettings("sine", 59.94, low_v=1.0, high_v=2.0, sync_output=False)


@OTHERS
@pytest.mark.parametrize("settings", [FLICKER, SINE])
def test_other_makes_are_set_read_back_and_switched(clock, dialect, make, settings) -> None:
    generator = make()
    light = ScpiLight(generator, clock=clock, dialect=dialect)
    assert light.apply(settings) == settings
    assert not light.is_on()
    light.on()
    assert generator.values["OUTP"] == "1"
    light.off()
    assert generator.values["OUTP"] == "0"


@OTHERS
def test_other_makes_are_refused_when_they_clip(clock, dialect, make) -> None:
    generator = make()
    generator.highest_hz = 50.0
    light = ScpiLight(generator, clock=clock, dialect=dialect)
    with pytest.raises(SettingRefused, match="frequency"):
        light.apply(FLICKER)


def test_the_siglent_way_is_one_command(clock) -> None:
    generator = SiglentGenerator()
    ScpiLight(generator, clock=clock, dialect="siglent").apply(FLICKER)
    assert beside_modes(generator, "siglent") == [
        "C1:OUTP LOAD,HZ",
        "C1:BSWV WVTP,SQUARE,FRQ,60,HLEV,3.3,LLEV,0,DUTY,30",
        "C1:SYNC ON",
    ]


@pytest.mark.parametrize("wrong", [b"C1:BSWV\n", b"C2:BSWV WVTP,SQUARE\n", b"C1:BSWV WVTP,SQUARE,FRQ,60KZ\n"])
def test_an_answer_of_another_form_is_refused_by_the_siglent_way(clock, wrong) -> None:
    generator = SiglentGenerator()
    light = ScpiLight(generator, clock=clock, dialect="siglent")
    generator.spoil = lambda line: wrong if b"BSWV" in line else line
    with pytest.raises(ReplyError):
        light.read()


def test_the_wrong_dialect_is_told_by_the_instrument_itself(generator, clock) -> None:
    light = ScpiLight(generator, clock=clock, dialect="numbered")
    with pytest.raises(DriverError, match="-113"):
        light.apply(FLICKER)


STEADY = LightSettings("steady", low_v=3.3, high_v=3.3, sync_output=False)


def test_a_steady_light_is_the_generators_direct_voltage(light, generator) -> None:
    assert light.apply(LightSettings("steady", high_v=3.3)) == STEADY
    assert beside_modes(generator, "keysight") == ["OUTP:LOAD INF", "FUNC DC", "VOLT:OFFS 3.3"]


@pytest.mark.parametrize(
    ("peer", "dialect"), [(NumberedGenerator(), "numbered"), (SiglentGenerator(), "siglent")]
)
def test_a_steady_light_and_a_flicker_follow_each_other_in_other_dialects(clock, peer, dialect) -> None:
    other = ScpiLight(peer, clock=clock, dialect=dialect)
    assert other.apply(LightSettings("steady", high_v=3.3)) == STEADY
    assert other.apply(FLICKER) == FLICKER
    assert other.apply(LightSettings("steady", high_v=3.3)) == STEADY


def test_a_steady_level_that_reads_back_lower_is_refused(light, generator) -> None:
    set_ = generator.set
    generator.set = lambda header, value: set_(header, "2.0" if header == "VOLT:OFFS" else value)
    with pytest.raises(SettingRefused, match=r"high_v: asked 3\.3, got 2\.0"):
        light.apply(LightSettings("steady", high_v=3.3))
