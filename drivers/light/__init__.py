"""The interface of a flicker light, which is the clock of a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

Waveform = Literal["square", "sine", "steady"]


@dataclass(frozen=True)
class LightIdentity:
    """Identity of the device that drives the light, as it reports itself.

    Attributes
    ----------
    maker, model
        Maker and model.
    serial
        Serial number; empty when the device has none.
    firmware
        Version of the firmware.
    """

    maker: str
    model: str
    serial: str
    firmware: str


@dataclass(frozen=True)
class LightSettings:
    """Settings of a flicker light: waveform, frequency and two levels.

    A steady light stays at ``high_v``. Its frequency, duty cycle and ``low_v`` have no meaning; it has no sync edges.

    Attributes
    ----------
    waveform
        Shape of a period.
    frequency_hz
        Flicker frequency, in hertz.
    duty_percent
        Share of a period at the high level, in percent; square waves only.
    low_v, high_v
        The two levels, in volts.
    sync_output
        Whether the sync output gives one edge a period to the camera's trigger input: rising at the start of the high
        phase.
    """

    waveform: Waveform = "square"
    frequency_hz: float = 60.0
    duty_percent: float = 50.0
    low_v: float = 0.0
    high_v: float = 5.0  # What inputs of LED drivers take, such as that of a LEDD1B
    sync_output: bool = True


class Light(Protocol):
    """A flicker light. It is dark until ``on``, and after ``apply`` or ``on`` has failed; ``off`` is always allowed."""

    def identify(self) -> LightIdentity:
        """Return the identity of the device.

        Returns
        -------
        LightIdentity
            What the device reports.

        Raises
        ------
        WrongDevice
            The identity is not the one in the station file.
        """

    def apply(self, settings: LightSettings) -> LightSettings:
        """Send all settings and read them back.

        Parameters
        ----------
        settings
            The settings that the light shall have.

        Returns
        -------
        LightSettings
            The settings that the device reports.

        Raises
        ------
        SettingRefused
            The device refuses a setting, or a value reads back differently.
        """

    def read(self) -> LightSettings:
        """Ask the device for its present settings.

        Returns
        -------
        LightSettings
            The settings that the device reports.
        """

    def on(self) -> None:
        """Switch the output on, and check that it is on.

        Raises
        ------
        LightFault
            The output stays off.
        """

    def off(self) -> None:
        """Switch the output off, and check that it is off.

        Raises
        ------
        LightFault
            The output stays on.
        """

    def is_on(self) -> bool:
        """Ask the device whether the output is on.

        Returns
        -------
        bool
            Whether it is.
        """

    def faults(self) -> Sequence[str]:
        """Ask the device for its faults.

        Returns
        -------
        sequence of str
            One sentence a fault; empty without faults.
        """

    def close(self) -> None:
        """Close the port. This switches nothing."""


@runtime_checkable
class StatesSyncPolarity(Protocol):
    """A light that can say whether its sync output rises at the start of the high phase."""

    def sync_polarity(self) -> str:
        """Make the polarity of the sync output normal, if the device can, and say what is known of it.

        Returns
        -------
        str
            "normal", or that the device does not state it.
        """
