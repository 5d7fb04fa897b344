"""Lights whose controller has a described text protocol.

`drivers.described.description` says what such a protocol may be; the bench reads it from a file. Such a light is dark
between its pulses. Levels are percent: ``high_v`` = 5 V stands for the full level that the station file allows.
Opening switches nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from drivers.clock import Clock
from drivers.described.description import LightDescription, LightQuantity, LightSetting
from drivers.described.line import DescribedLine
from drivers.described.template import Value
from drivers.errors import DeviceRefused, LightFault, ReplyError, SettingRefused
from drivers.light import LightIdentity, LightSettings
from drivers.readings import read_until_agreed
from drivers.serial_port import Port, SerialPort
from drivers.wire_log import WireLog

FULL_SCALE_V = 5.0
"""Value of ``high_v`` that stands for the full level, in volts."""


class TextLight:
    """A light on one controller. Implements ``drivers.light.Light``.

    Open it with ``TextLight.open``; the constructor takes a port that is open already.

    serial: Serial number of the controller; empty when it is not checked.
    full_percent: Level at ``high_v`` = 5 V, in percent of the controller's range.
    clock, wire_log: See ``drivers.link.Link``.
    Raises ReplyError, PortLost: The controller does not answer as described.
    """

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
        self._switched_on = False
        try:
            self._line = DescribedLine(port, description.line, clock=clock, wire_log=wire_log)
            self.identify()
        except BaseException:
            port.close()
            raise

    @classmethod
    def open(
        cls,
        port: str,
        description: LightDescription,
        *,
        serial: str = "",
        full_percent: float = 100.0,
        baudrate: int | None = None,
        clock: Clock,
        wire_log: WireLog | None = None,
    ) -> TextLight:
        """Open the port and check the serial number. Sets and switches nothing.

        port: Address of the port; see ``drivers.serial_port.SerialPort``, which raises the errors of opening.
        baudrate: Bits per second; None for the description's.
        """
        opened = SerialPort(port, baudrate=baudrate or description.line.baudrate)
        return cls(
            opened, description, serial=serial, full_percent=full_percent, clock=clock, wire_log=wire_log
        )

    def identify(self) -> LightIdentity:
        """See `Light.identify`.

        Raises WrongDevice: The serial number is not the one in the station file.
        """
        line = self._description.line
        serial = self._line.read_serial(self._serial)
        return LightIdentity(line.maker, line.model, serial, str(self._line.identity.get("firmware", "")))

    def apply(self, settings: LightSettings) -> LightSettings:
        """See `Light.apply`. A dark light stays dark."""
        wanted = self._wanted(settings)
        for setting in self._description.settings:
            if setting.quantity in wanted:
                self._set(setting, wanted[setting.quantity])
        return self.read()

    def read(self) -> LightSettings:
        """See `Light.read`. The settings are read until two readings agree.

        Raises ReplyGarbled: The readings do not agree.
        """
        return read_until_agreed(self._read_once, what="the settings", where=self._line.name)

    def on(self) -> None:
        """See `Light.on`."""
        try:
            self._line.query(self._description.on)
        except DeviceRefused as error:
            raise SettingRefused(error.what, where=error.where, remedy=error.remedy) from error
        if not self.is_on():
            raise LightFault(
                "the output was switched on, but is off.",
                where=self._line.name,
                remedy="Look up the fault that the controller reports in its manual.",
            )
        self._switched_on = True

    def off(self) -> None:
        """See `Light.off`. Sent at once, without resynchronising.

        Raises ReplyError, PortLost: The controller does not answer, so its state is unknown.
        """
        self._switched_on = False
        try:
            self._line.query_urgent(self._description.off)
        except (ReplyError, DeviceRefused):
            self._line.query(self._description.off)
        if self.is_on():
            raise LightFault(
                "the output was switched off, but is on.",
                where=self._line.name,
                remedy="Cut the light's power.",
            )

    def is_on(self) -> bool:
        """See `Light.is_on`. Asked until two answers agree."""
        return read_until_agreed(
            lambda: self._line.switch(self._description.is_on)[0], what="the output", where=self._line.name
        )

    def faults(self) -> Sequence[str]:
        """See `Light.faults`. Returns what the controller reports, and an unexpected darkness."""
        found = self._line.take_notices()
        if self._description.faults is not None:
            fine, answer = self._line.switch(self._description.faults)
            found += [] if fine else [f"the controller reports '{answer}'"]
        if self._switched_on and not self.is_on():
            found.append("the light was switched on, but is off")
        return found

    def close(self) -> None:
        """See `Light.close`."""
        self._line.close()

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
        wrong = []
        if settings.low_v != 0 and not steady:
            wrong.append("this light is dark between pulses: low_v must be 0")
        if not 0 < percent <= self._full_percent * (1 + 1e-9):
            wrong.append(f"high_v must be above 0 V and at most {FULL_SCALE_V:g} V, its full scale")
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
        if wrong:
            raise SettingRefused(
                f"{'; '.join(wrong)}. Nothing was set.",
                where=self._line.name,
                remedy="Change the light step in the sequence, or the light in the station file.",
            )
        return wanted

    def _set(self, setting: LightSetting, value: Value) -> None:
        """Write a setting, and read it back until two readings agree."""
        asked = setting.constant if setting.quantity == "constant" else value
        sent: Value = setting.words[str(asked)] if setting.words else self._to_device(setting, float(asked))
        try:
            self._line.query(setting.set, {"value": sent})
        except DeviceRefused as error:
            raise SettingRefused(
                f"{setting.quantity}: {error.what}", where=error.where, remedy=error.remedy
            ) from error
        got = read_until_agreed(
            lambda: self._line.query(setting.query)["value"], what=setting.quantity, where=self._line.name
        )
        fits = (
            got == sent
            if setting.words
            else abs(float(got) - float(sent)) <= abs(float(sent)) * setting.tolerance_percent / 100 + 1e-6
        )
        if not fits:
            raise SettingRefused(
                f"{setting.quantity} reads back differently from what was set: asked {sent}, got {got}.",
                where=self._line.name,
                remedy="Ask for values within the controller's range and resolution.",
            )

    def _to_device(self, setting: LightSetting, value: float) -> float:
        return setting.factor * (1.0 / value if setting.inverse else value)

    def _from_device(self, quantity: LightQuantity, fallback: float) -> float:
        """Read a number; a light without that setting has a fixed one."""
        setting = self._settings.get(quantity)
        if setting is None:
            return fallback
        value = float(self._line.query(setting.query)["value"]) / setting.factor
        if setting.inverse and value <= 0:
            raise self._line.garbled_reply(f"the controller reports {value:g} for {quantity}.")
        return 1.0 / value if setting.inverse else value

    def _word(self, quantity: LightQuantity, fallback: str) -> str:
        """Read a word; a light without that setting has a fixed one."""
        setting = self._settings.get(quantity)
        if setting is None:
            return fallback
        got = self._line.query(setting.query)["value"]
        ours = {theirs: own for own, theirs in setting.words.items()}
        if got not in ours:
            raise self._line.garbled_reply(f"the controller reports {got!r} for {quantity}.")
        return ours[got]

    def _read_once(self) -> LightSettings:
        waveform: Any = self._word("waveform", "square")
        level_v = FULL_SCALE_V * self._from_device("level_percent", 100.0) / self._full_percent
        if waveform == "steady":
            return LightSettings(waveform="steady", low_v=level_v, high_v=level_v, sync_output=False)
        return LightSettings(
            waveform=waveform,
            frequency_hz=self._from_device("frequency_hz", LightSettings.frequency_hz),
            duty_percent=self._from_device("duty_percent", LightSettings.duty_percent),
            low_v=0.0,
            high_v=level_v,
            sync_output=self._word("sync", "off") == "on",
        )
