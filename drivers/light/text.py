"""Lights whose controller has a described text protocol.

`drivers.described.description` says what such a protocol may be; the bench reads it from a file. Such a light is dark
between its pulses. Levels are percent: ``high_v`` = 5 V stands for the full level that the station file allows.
Opening switches nothing.
"""

from __future__ import annotations

from typing import Any

from drivers.clock import Clock
from drivers.described.description import LightDescription, LightQuantity, LightSetting, Value
from drivers.described.line import DescribedLine, shown
from drivers.errors import DeviceRefused, ReplyError, SettingRefused
from drivers.light import LightIdentity, LightSettings
from drivers.light.watched import FULL_SCALE_V, WatchedLight, percent_faults, steady_settings
from drivers.serial_port import LineSettings, Port, closed_on_error
from drivers.wire_log import WireLog


class TextLight(WatchedLight):
    """A light on one controller; its serial number is not checked when ``serial`` is empty.

    ``full_percent`` is the level at ``high_v`` = 5 V, in percent of the controller's range.
    """

    _line: DescribedLine
    OUTPUT = "output"
    STAYS_DARK = ("is off", "Look up the fault that the controller reports in its manual.")
    STAYS_LIT = ("is on", "Cut the light's power.")

    def __init__(
        self,
        port: Port,
        description: LightDescription,
        *,
        serial: str = "",
        full_percent: float = 100.0,
        clock: Clock,
        wire_log: WireLog | None = None,
    ) -> None:
        self._description = description
        self._settings = {setting.quantity: setting for setting in description.settings}
        self._serial = serial
        self._full_percent = full_percent
        super().__init__()
        with closed_on_error(port):
            self._line = DescribedLine(port, description.line, clock=clock, wire_log=wire_log)
            self.identify()

    @classmethod
    def _line_settings(cls, description: LightDescription, *_arguments: Any) -> LineSettings:
        return description.line.settings

    def identify(self) -> LightIdentity:
        """See `Light.identify`; the serial number is compared with the one in the station file."""
        line = self._description.line
        serial = self._line.read_serial(self._serial)
        return LightIdentity(line.maker, line.model, serial, shown(self._line.identity.get("firmware", "")))

    def _refuse_impossible(self, settings: LightSettings) -> None:
        """See `WatchedLight._refuse_impossible`."""
        self._wanted(settings)

    def _apply(self, settings: LightSettings) -> LightSettings:
        """See `Light.apply`. A dark light stays dark."""
        wanted = self._wanted(settings)
        for setting in self._description.settings:
            if setting.quantity in wanted:
                self._set(setting, wanted[setting.quantity])
        return self.read()

    def _switch_on(self) -> None:
        try:
            self._line.query(self._description.on)
        except DeviceRefused as error:
            raise SettingRefused(error.what, where=error.where, remedy=error.remedy) from error

    def _switch_off(self) -> None:
        try:
            self._line.query_urgent(self._description.off)
        except (ReplyError, DeviceRefused):
            self._line.query(self._description.off)

    def is_on(self) -> bool:
        """See `Light.is_on`."""
        return self._line.agreed(lambda: self._line.switch(self._description.is_on)[0], "the output")

    def _reported_faults(self) -> list[str]:
        faults = self._line.take_notices()
        if self._description.faults is not None:
            fine, answer = self._line.switch(self._description.faults)
            faults += [] if fine else [f"the controller reports '{answer}'"]
        return faults

    # ------------------------------------------------------------ inside

    def _wanted(self, settings: LightSettings) -> dict[LightQuantity, Value]:
        """Return the values to write, by quantity; raise SettingRefused for what this light cannot make."""
        steady = settings.waveform == "steady"
        percent = self._full_percent * settings.high_v / FULL_SCALE_V
        wanted: dict[LightQuantity, Value] = {"level_percent": percent, "constant": 0.0}
        wanted["waveform"] = settings.waveform
        wanted["sync"] = "on" if settings.sync_output and not steady else "off"
        if not steady:
            wanted |= {"frequency_hz": settings.frequency_hz, "duty_percent": settings.duty_percent}
        wrong = percent_faults(settings, percent, self._full_percent * (1 + 1e-9))
        if settings.sync_output and not steady and "sync" not in self._settings:
            wrong.append("this light has no sync output")
        if "waveform" not in self._settings and settings.waveform != "square":
            wrong.append("this light makes square pulses only")
        for quantity, value in wanted.items():
            setting = self._settings.get(quantity)
            if setting is None or quantity == "constant":
                continue
            if setting.words and value not in setting.words:
                wrong.append(f"{quantity} cannot be {value}")
            elif not isinstance(value, str) and not setting.lowest <= value <= setting.highest:
                wrong.append(f"{quantity} {value:g} is outside {setting.lowest:g} to {setting.highest:g}")
        self._refuse(wrong, " Nothing was set.")
        return wanted

    def _set(self, setting: LightSetting, value: Value) -> None:
        """Write a setting, and read it back until two readings agree."""
        asked = setting.constant if setting.quantity == "constant" else value
        sent: Value = setting.words[str(asked)] if setting.words else asked
        if not isinstance(sent, str):
            sent = setting.factor * (1.0 / sent if setting.inverse else sent)
        try:
            self._line.query(setting.set, {"value": sent})
        except DeviceRefused as error:
            raise SettingRefused(
                f"{setting.quantity}: {error.what}", where=error.where, remedy=error.remedy
            ) from error
        got = self._line.agreed(lambda: self._line.query(setting.query)["value"], setting.quantity)
        if isinstance(sent, str):
            fits = _is_word(got, sent)
        else:
            got = float(got) * setting.factor / setting.query_factor
            fits = abs(got - sent) <= abs(sent) * setting.tolerance_percent / 100 + 1e-6
        if not fits:
            raise SettingRefused(
                f"{setting.quantity} reads back differently from what was set: asked {sent}, got {got}.",
                where=self._line.name,
                remedy="Ask for values within the controller's range and resolution.",
            )

    def _from_device(self, quantity: LightQuantity, fallback: float) -> float:
        """Read a number; a light without that setting has a fixed one."""
        setting = self._settings.get(quantity)
        if setting is None:
            return fallback
        value = float(self._line.query(setting.query)["value"]) / setting.query_factor
        if setting.inverse and value <= 0:
            raise self._line.garbled_reply(f"the controller reports {value:g} for {quantity}.")
        return 1.0 / value if setting.inverse else value

    def _word(self, quantity: LightQuantity, fallback: str) -> str:
        """Read a word; a light without that setting has a fixed one."""
        setting = self._settings.get(quantity)
        if setting is None:
            return fallback
        got = self._line.query(setting.query)["value"]
        own = next((own for own, theirs in setting.words.items() if _is_word(got, theirs)), None)
        if own is None:
            raise self._line.garbled_reply(f"the controller reports {got!r} for {quantity}.")
        return own

    def _read_once(self) -> LightSettings:
        waveform: Any = self._word("waveform", "square")
        level_v = FULL_SCALE_V * self._from_device("level_percent", 100.0) / self._full_percent
        if waveform == "steady":
            return steady_settings(level_v)
        return LightSettings(
            waveform=waveform,
            frequency_hz=self._from_device("frequency_hz", LightSettings.frequency_hz),
            duty_percent=self._from_device("duty_percent", LightSettings.duty_percent),
            low_v=0.0,
            high_v=level_v,
            sync_output=self._word("sync", "off") == "on",
        )


def _is_word(got: Value, word: str) -> bool:
    """Return whether an answer is a word of a device; a word that is a number may have other digits: 01 and 1."""
    return got == (float(word) if isinstance(got, float) else word)
