"""Generators that somebody used before us: bursts, sweeps, modulations and a turned polarity do not survive into a run."""

from __future__ import annotations

import pytest

from drivers.errors import ReplyError, SettingRefused
from drivers.light import LightSettings
from drivers.light.scpi import ScpiLight
from tests.unit.drivers.generator_peer import Generator, NumberedGenerator, SiglentGenerator

MODES = ("BURS:STAT", "SWE:STAT", "AM:STAT", "FM:STAT", "FSK:STAT")


class UsedGenerator(Generator):
    """One that makes bursts, sweeps and modulates, upside down."""

    def __init__(self) -> None:
        super().__init__()
        self.values |= dict.fromkeys(MODES, "ON") | {"OUTP:POL": "INV"}

    def set(self, header: str, value: str) -> None:
        if header in {*MODES, "OUTP:POL"}:
            self.values[header] = value
        else:
            super().set(header, value)

    def left_on(self) -> list[str]:
        return [mode for mode in (*MODES, "OUTP:POL") if self.values[mode] not in {"OFF", "NORM"}]


class UsedNumberedGenerator(UsedGenerator, NumberedGenerator):
    """The same by channel."""


@pytest.mark.parametrize(
    ("kind", "dialect"), [(UsedGenerator, "keysight"), (UsedNumberedGenerator, "numbered")]
)
def test_the_signal_is_the_plain_one_that_was_asked_for(clock, kind, dialect) -> None:
    generator = kind()
    light = ScpiLight(generator, clock=clock, dialect=dialect)
    assert generator.left_on() == [*MODES, "OUTP:POL"]  # opening sets nothing
    light.apply(LightSettings(frequency_hz=60.0))
    assert generator.left_on() == []


def test_a_siglent_is_told_in_its_own_words(clock) -> None:
    generator = SiglentGenerator()
    ScpiLight(generator, clock=clock, dialect="siglent").apply(LightSettings(frequency_hz=60.0))
    for words in ("C1:BTWV STATE,OFF", "C1:SWWV STATE,OFF", "C1:MDWV STATE,OFF", "C1:OUTP PLRT,NOR"):
        assert words in generator.sent


def test_a_generator_without_such_modes_is_not_asked_for_them_again(clock) -> None:
    generator = Generator()
    light = ScpiLight(generator, clock=clock)
    light.apply(LightSettings(frequency_hz=60.0))
    assert "BURS:STAT OFF" in generator.sent
    generator.sent.clear()
    light.apply(LightSettings(frequency_hz=50.0))
    assert "BURS:STAT OFF" not in generator.sent


def test_a_mode_that_does_not_go_off_is_told(clock) -> None:
    generator = UsedGenerator()

    def refuse(line: str) -> None:
        if line == "SWE:STAT OFF":
            generator.queue.append('-221,"Settings conflict"')

    generator.before = refuse
    light = ScpiLight(generator, clock=clock)
    with pytest.raises(SettingRefused, match=r"sweep is refused.*-221"):
        light.apply(LightSettings(frequency_hz=60.0))


def test_a_number_beyond_all_numbers_is_no_setting(clock) -> None:
    generator = SiglentGenerator()
    light = ScpiLight(generator, clock=clock, dialect="siglent")
    generator.spoil = lambda line: line.replace(b"FRQ,1000HZ", b"FRQ,1E999HZ")
    with pytest.raises(ReplyError, match="no number FRQ"):
        light.read()


class InvertedSync(NumberedGenerator):
    """One whose sync output was inverted; it knows the polarity by its own words."""

    def __init__(self, words: str) -> None:
        super().__init__()
        self.normal, self.inverted = words.split(",")
        self.values["OUTP:SYNC:POL"] = self.inverted

    def set(self, header: str, value: str) -> None:
        if header != "OUTP:SYNC:POL":
            super().set(header, value)
        elif value in {self.normal, self.inverted}:
            self.values[header] = value
        else:
            self.queue.append('-224,"Illegal parameter value"')


@pytest.mark.parametrize("words", ["NORM,INV", "POS,NEG"])
def test_an_inverted_sync_output_is_made_normal(clock, words) -> None:
    generator = InvertedSync(words)
    light = ScpiLight(generator, clock=clock, dialect="numbered")
    assert generator.values["OUTP:SYNC:POL"] == generator.inverted  # opening sets nothing
    assert light.sync_polarity() == "normal"
    assert generator.values["OUTP:SYNC:POL"] == generator.normal
    assert not generator.queue


@pytest.mark.parametrize(
    ("kind", "dialect"),
    [(Generator, "keysight"), (NumberedGenerator, "numbered"), (SiglentGenerator, "siglent")],
)
def test_a_generator_without_that_setting_is_not_said_to_have_it(clock, kind, dialect) -> None:
    light = ScpiLight(kind(), clock=clock, dialect=dialect)
    assert light.sync_polarity() == "not stated by the device"
