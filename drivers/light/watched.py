"""What every light on a line does: switch and check, notice an unexpected darkness, read until readings agree.

A driver of a family of lights implements the abstract methods, which talk on its wire. This module implements no
protocol.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import ClassVar, Final

from drivers.errors import DriverError, LightFault, ReplyTimeout, SettingRefused
from drivers.light import LightIdentity, LightSettings
from drivers.link import Link
from drivers.serial_port import LineSettings, OnOnePort, Port, ReopeningPort
from drivers.visa_port import VISA_PREFIX, VisaPort, socket_url

FULL_SCALE_V: Final = 5.0
"""Value of ``high_v`` that stands for the full level of a light whose levels are percent, in volts."""


class WatchedLight(OnOnePort, ABC):
    """A light behind a controller. Implements ``drivers.light.Light``.

    Opening checks who answers. It sets and switches nothing. All its requests may be sent twice.
    """

    OUTPUT: ClassVar[str] = "light"
    """What is switched, in messages."""
    LAMP: ClassVar[str] = "light"
    """What is dark, in messages."""
    STAYS_DARK: ClassVar[tuple[str, str]]
    """How a light that was switched on reads, and what to do."""
    STAYS_LIT: ClassVar[tuple[str, str]]
    """How a light that was switched off reads, and what to do."""

    _line: Link

    def __init__(self) -> None:
        self._switched_on = False
        self._applied: LightSettings | None = None
        self._connections_checked = 0

    @classmethod
    def _opened(cls, address: str, settings: LineSettings) -> Port:
        url = socket_url(address) or address
        if url.startswith(VISA_PREFIX):
            return VisaPort(url)
        return ReopeningPort(url, settings)

    # ------------------------------------------------------------ what a family implements

    @abstractmethod
    def identify(self) -> LightIdentity:
        """See `Light.identify`."""

    def _refuse_impossible(self, settings: LightSettings) -> None:
        """Raise SettingRefused for settings that no light of the family can make; nothing was sent."""

    @abstractmethod
    def _apply(self, settings: LightSettings) -> LightSettings:
        """Send all settings and read them back; see `Light.apply`."""

    @abstractmethod
    def _read_once(self) -> LightSettings:
        """Ask for all settings."""

    @abstractmethod
    def _switch_on(self) -> None:
        """Send what switches the light on."""

    @abstractmethod
    def _switch_off(self) -> None:
        """Send what switches the light off, at once, without resynchronising."""

    def _insist_off(self) -> bool:
        """Send it once more to a light that is still on; return whether that was done."""
        return False

    @abstractmethod
    def is_on(self) -> bool:
        """See `Light.is_on`. Asks until two answers agree."""

    @abstractmethod
    def _reported_faults(self) -> list[str]:
        """Ask for the faults that the controller reports."""

    # ------------------------------------------------------------ the same for all

    def read(self) -> LightSettings:
        """See `Light.read`. Reads until two readings agree."""
        return self._line.agreed(self._read_once, "the settings")

    def apply(self, settings: LightSettings) -> LightSettings:
        """See `Light.apply`."""
        self._applied, self._connections_checked = None, self._line.connections
        self._refuse_impossible(settings)
        with self._dark_after_error():
            self._applied = self._apply(settings)
        return self._applied

    def on(self) -> None:
        """See `Light.on`. A light that restarted meanwhile is switched off again."""
        if self._applied is None:  # it would shine as another program has left it
            raise SettingRefused(
                f"its settings were not applied, or were refused. The {self.OUTPUT} was not switched on.",
                where=self._line.name,
                remedy="Apply settings first that the light takes.",
            )
        with self._dark_after_error():
            self._switch_on()
            if not self.is_on():
                reads, remedy = self._stays_dark()
                raise LightFault(reads, where=self._line.name, remedy=remedy)
            if others := self._other_settings():
                remedy = "Check its supply, and that nobody operates it by hand; then begin again."
                raise LightFault(f"{others}.", where=self._line.name, remedy=remedy)
        self._switched_on = True

    def off(self) -> None:
        """See `Light.off`. An error means that the state is unknown."""
        self._switched_on = False
        try:
            self._make_dark()
        except ReplyTimeout:  # a network may forget a connection without closing it
            if not self._line.connect_again():
                raise
            self._make_dark()

    def faults(self) -> Sequence[str]:
        """See `Light.faults`. Returns what the controller reports, and an unexpected darkness."""
        faults = self._reported_faults()
        if self._switched_on and not self.is_on():
            faults.append(f"the {self.LAMP} was switched on, but is off")
        elif self._switched_on:
            faults += filter(None, [self._other_settings()])
        return faults

    def close(self) -> None:
        """See `Light.close`."""
        self._line.close()

    @contextmanager
    def _dark_after_error(self) -> Iterator[None]:
        """Switch the light off after an error: it may shine with settings that nobody asked for, or half of them."""
        try:
            yield
        except DriverError as error:
            try:
                with suppress(ReplyTimeout):  # a silent light is switched off too, but not another device
                    self._line.bring_into_step()
                self.off()
            except DriverError as second:
                what = f"{error.what} Whether the {self.OUTPUT} is off is not known: {second.what}"
                raise type(error)(what, where=error.where, remedy=second.remedy) from error
            raise

    def _make_dark(self) -> None:
        self._switch_off()
        if self.is_on() and not (self._insist_off() and not self.is_on()):
            reads, remedy = self.STAYS_LIT
            raise LightFault(
                f"the {self.OUTPUT} was switched off, but {reads}.", where=self._line.name, remedy=remedy
            )

    def _other_settings(self) -> str:
        """Say, after its line was opened again, that the light has other settings than were applied; empty if not."""
        if self._line.connections == self._connections_checked:
            return ""
        self._connections_checked = self._line.connections
        if self._applied is None or self._applied.waveform == "steady":
            return ""
        got = self.read()
        if got == self._applied:
            return ""
        return (
            f"the {self.LAMP} no longer has the settings that were applied ({self._applied}, now {got}): it has"
            " restarted, or somebody has changed them"
        )

    def _stays_dark(self) -> tuple[str, str]:
        reads, remedy = self.STAYS_DARK
        return f"the {self.OUTPUT} was switched on, but {reads}.", remedy

    def _refuse(self, wrong: Sequence[str], after: str = "") -> None:
        """Raise SettingRefused if there is something that this light cannot make."""
        if wrong:
            raise SettingRefused(
                f"{'; '.join(wrong)}.{after}",
                where=self._line.name,
                remedy="Change the light step in the sequence, or the light in the station file.",
            )

    def _refuse_otherwise(self, wrong: Sequence[str], remedy: str) -> None:
        """Raise SettingRefused if settings read otherwise than they were set."""
        if wrong:
            raise SettingRefused(
                f"settings read back differently from what was set ({'; '.join(wrong)}).",
                where=self._line.name,
                remedy=remedy,
            )


def percent_faults(settings: LightSettings, percent: float, most_percent: float) -> list[str]:
    """Say what a light whose levels are percent, and that is dark between pulses, cannot make of the levels."""
    wrong = []
    if settings.low_v != 0 and settings.waveform != "steady":
        wrong.append("this light is dark between pulses: low_v must be 0")
    if not 0 < percent <= most_percent:
        wrong.append(f"high_v must be above 0 V and at most {FULL_SCALE_V:g} V, its full scale")
    return wrong


def steady_settings(level_v: float) -> LightSettings:
    """Return the settings of a steady light."""
    return LightSettings(waveform="steady", low_v=level_v, high_v=level_v, sync_output=False)
