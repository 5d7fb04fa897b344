"""The SCPI light on simulated generators: what it sends, and that no setting is taken for made that was not."""

from dataclasses import replace

import pytest

from drivers.errors import DriverError, LightFault, ReplyError, SettingRefused
from drivers.light import LightSettings
from drivers.light.scpi import ScpiLight
from drivers.text_line import ScpiLine
from tests.unit.drivers.light.generator_bench import Bench

pytestmark = pytest.mark.usefixtures("never_late")


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.fixture
def light(bench) -> ScpiLight:
    return bench.open(serial="SG0042")


FLICKER = LightSettings("square", 60.0, 30.0, 0.0, 3.3, sync_output=True)


def test_a_flicker_is_set_in_the_generators_words(light, bench) -> None:
    assert light.apply(FLICKER) == FLICKER
    assert bench.settings_sent() == [
        "OUTP:LOAD INF",
        "FUNC SQU",
        "FREQ 60",
        "FUNC:SQU:DCYC 30",
        "VOLT:HIGH 3.3",
        "VOLT:LOW 0",
        "OUTP:SYNC ON",
    ]
    assert not bench.lit()


@pytest.mark.parametrize(("low", "high"), [(6.0, 8.0), (-8.0, -6.0), (-5.0, 0.5)])
def test_levels_are_set_in_an_order_that_never_crosses_them(light, bench, low, high) -> None:
    bench.device.receive(f"OUTP:LOAD INF;VOLT:LOW {low};HIGH {high}\n".encode())
    bench.device.receive(b"*CLS\n")
    light.apply(FLICKER)
    assert (bench.states[-1].low_v, bench.states[-1].high_v) == pytest.approx((0.0, 3.3))


def test_a_clipped_value_with_an_error_is_refused(light, bench) -> None:
    with pytest.raises(SettingRefused, match=r'frequency is refused: .FREQ 1000000000. .*-222 "'):
        light.apply(LightSettings(frequency_hz=1e9))


def test_a_value_clipped_in_silence_is_refused_with_both_values() -> None:
    quiet = Bench(error_queue=False).open()
    with pytest.raises(SettingRefused, match=r"frequency_hz: asked 1000000000\.0, got 80000000\.0"):
        quiet.apply(LightSettings(frequency_hz=1e9))


def test_a_generator_without_load_setting_is_told_how_to_be_named(light, bench) -> None:
    bench.device.receive(b"OUTP:LOAD INF\n")
    bench.line.turn("OUTP:LOAD", "OUTP:LOAF")
    with pytest.raises(SettingRefused, match="load: unchanged"):
        light.apply(FLICKER)
    assert bench.open(load="unchanged").apply(FLICKER) == FLICKER


def test_errors_from_before_us_are_not_ours(bench) -> None:
    bench.device.receive(b"NONSENSE\nFREQ 1e12\n")
    assert bench.open().apply(FLICKER) == FLICKER


def test_a_light_whose_settings_or_switch_were_refused_is_dark(light, bench) -> None:
    """Also one that another program has left on, and one that comes on though it answers with an error."""
    bench.device.receive(b"OUTP ON\n")
    with pytest.raises(SettingRefused):
        light.apply(replace(FLICKER, frequency_hz=1e12))
    assert not bench.lit()
    with pytest.raises(SettingRefused, match="not switched on"):
        light.on()
    light.apply(FLICKER)
    light.on()
    assert bench.lit()
    bench.line.turn("OUTP ON", "OUTP ON;NONSENSE")
    with pytest.raises(SettingRefused):
        light.on()
    assert not bench.lit()


def test_an_output_that_does_not_come_on_is_a_fault(light, bench) -> None:
    light.apply(FLICKER)
    bench.line.turn("OUTP ON", "OUTP OFF")
    with pytest.raises(LightFault, match="reads off"):
        light.on()


def test_an_output_that_does_not_go_off_is_a_fault(light, bench) -> None:
    light.apply(FLICKER)
    light.on()
    bench.line.turn("OUTP OFF", "OUTP ON")
    with pytest.raises(LightFault, match="by hand"):
        light.off()
    assert bench.commands().count("OUTP OFF") == 2


def test_another_waveform_is_told_not_taken_for_one_of_ours(light, bench) -> None:
    bench.answer({"FUNC": "RAMP"})
    with pytest.raises(LightFault, match="waveform is 'RAMP'"):
        light.read()


def test_a_query_the_instrument_does_not_know_is_told_in_its_words(bench) -> None:
    line = ScpiLine(bench.line, clock=bench.clock)
    with pytest.raises(DriverError, match=r"FLICKER\? .*-113"):
        line.query("FLICKER?")


def test_an_error_queue_that_never_ends_is_given_up(bench) -> None:
    line = ScpiLine(bench.line, clock=bench.clock)
    bench.answer({"SYST:ERR": '-222,"Data out of range"'})
    with pytest.raises(ReplyError, match="never ends"):
        line.read_errors()


# ---------------------------------------------------------------- other makes


def test_a_steady_level_that_reads_back_lower_is_refused(light, bench) -> None:
    bench.line.turn("VOLT:OFFS 3.3", "VOLT:OFFS 2")
    with pytest.raises(SettingRefused, match=r"high_v: asked 3\.3, got 2\.0"):
        light.apply(LightSettings("steady", high_v=3.3))
