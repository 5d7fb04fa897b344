"""The contract tests of a light: what every driver of a light must do, with any device."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, suppress
from typing import ClassVar

import pytest

from bench.plugin_tests.rig import SPOILT, Rig, SimulatedLight, fails_in_time
from bench.plugin_tests.stages import SerialContract
from drivers.errors import DriverError, PortBusy, PortLost, ReplyError, SettingRefused, WrongDevice
from drivers.light import Light, LightSettings


class LightContract(SerialContract):
    """Derive from this class, name it ``Test...``, and give ``section`` and ``device``, a `SimulatedLight`.

    Attributes
    ----------
    flicker
        Settings that the light can make.
    impossible
        Settings that it cannot make.
    """

    kind = "light"
    flicker: ClassVar[LightSettings] = LightSettings("square", 50.0, 50.0, 0.0, 3.0)
    impossible: ClassVar[LightSettings] = LightSettings("square", 1e12, 50.0, 0.0, 3.0)

    @pytest.fixture
    def light(self, rig: Rig) -> Iterator[Light]:
        """The open light."""
        with closing(self._opened(rig.station({}))) as light:
            yield light

    def test_settings_are_read_back_and_the_light_stays_dark(
        self, light: Light, simulated: SimulatedLight
    ) -> None:
        """Settings are read back and the light stays dark."""
        assert light.identify().maker
        got = light.apply(self.flicker)
        assert got.waveform == self.flicker.waveform
        assert got.frequency_hz == pytest.approx(self.flicker.frequency_hz, rel=1e-3)
        assert got.duty_percent == pytest.approx(self.flicker.duty_percent, rel=1e-2)
        assert got.high_v == pytest.approx(self.flicker.high_v, rel=1e-2)
        assert light.read() == got
        assert not light.is_on()
        assert not simulated.is_lit()

    def test_on_and_off_are_what_the_lamp_does(self, light: Light, simulated: SimulatedLight) -> None:
        """On and off are what the lamp does."""
        light.apply(self.flicker)
        light.on()
        assert light.is_on()
        assert simulated.is_lit()
        assert list(light.faults()) == []
        light.off()
        assert not light.is_on()
        assert not simulated.is_lit()

    def test_what_is_impossible_is_refused_and_the_light_still_works(self, light: Light) -> None:
        """What is impossible is refused and the light still works."""
        fails_in_time(lambda: light.apply(self.impossible), SettingRefused)
        light.apply(self.flicker)

    def test_opening_and_closing_switch_nothing(self, rig: Rig, simulated: SimulatedLight) -> None:
        """Opening and closing switch nothing."""
        with closing(self._opened(rig.station({}))) as light:
            assert not simulated.is_lit()
            light.apply(self.flicker)
            light.on()
        assert simulated.is_lit()
        with closing(self._opened(rig.station({}))) as again:
            assert simulated.is_lit()
            assert again.is_on()
            again.off()
        assert not simulated.is_lit()

    def test_another_serial_number_is_refused(self, rig: Rig) -> None:
        """Another serial number is refused."""
        if not self.other_serial:
            pytest.skip("this device has no serial number")
        fails_in_time(lambda: self._opened(rig.station({"serial": self.other_serial})), WrongDevice)

    def test_a_second_opening_is_refused(self, rig: Rig, light: Light) -> None:
        """A second opening is refused."""
        fails_in_time(lambda: self._opened(rig.station({})), PortBusy)
        assert light.is_on() is False

    @pytest.mark.parametrize("kind", SPOILT)
    def test_one_spoilt_message_never_becomes_a_wrong_setting(
        self, rig: Rig, light: Light, simulated: SimulatedLight, kind: str
    ) -> None:
        """One spoilt message never becomes a wrong setting."""
        light.apply(self.flicker)
        light.on()
        rig.spoil(kind)
        told = []
        for _ in range(3):
            with suppress(ReplyError):
                told.append(light.read().frequency_hz)
        assert told, "the line must be usable again after one spoilt message"
        assert told == pytest.approx([self.flicker.frequency_hz] * len(told), rel=1e-3)
        rig.spoil(kind)
        try:
            light.off()
        except DriverError:
            light.off()
        assert not simulated.is_lit()

    def test_a_silent_device_is_an_error_in_bounded_time(self, rig: Rig, light: Light) -> None:
        """A silent device is an error in bounded time."""
        rig.spoil("lost", count=None)
        fails_in_time(light.is_on, ReplyError)
        fails_in_time(light.off)

    def test_a_pulled_cable_is_a_lost_port(self, rig: Rig, light: Light) -> None:
        """A pulled cable is a lost port."""
        rig.plugged.unplug()
        fails_in_time(light.is_on, PortLost)
