"""What the bench expects of a flicker light: it is the clock of a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

Waveform = Literal["square", "sine", "steady"]


@dataclass(frozen=True)
class LightIdentity:
    """Who drives the light, as it says itself."""

    maker: str
    model: str
    serial: str
    firmware: str


@dataclass(frozen=True)
class LightSettings:
    """A flicker: waveform, frequency and the levels between which it swings.

    A steady light burns at ``high_v``; its frequency, duty and ``low_v`` mean nothing, and it has no sync edges.
    """

    waveform: Waveform = "square"
    frequency_hz: float = 60.0
    duty_percent: float = 50.0
    """Share of a period at the high level; square waves only."""
    low_v: float = 0.0
    high_v: float = 5.0
    sync_output: bool = True
    """One edge a period to the camera's trigger input: rising at the start of the high phase."""


class Light(Protocol):
    """A flicker light. Dark until ``on``; ``off`` is always allowed."""

    def identify(self) -> LightIdentity:
        """Ask who it is. Raises WrongDevice when the serial number differs from the given one."""
        ...

    def apply(self, settings: LightSettings) -> LightSettings:
        """Set everything, read it back, and return what the device says.

        Raises SettingRefused when a value read back differs from the one asked for.
        """
        ...

    def read(self) -> LightSettings:
        """The present settings, asked of the device."""
        ...

    def on(self) -> None:
        """Switch the output on and see that it is."""
        ...

    def off(self) -> None:
        """Switch the output off and see that it is."""
        ...

    def is_on(self) -> bool:
        """Whether the output is on, asked of the device."""
        ...

    def faults(self) -> Sequence[str]:
        """Present faults in plain words; empty when all is well."""
        ...

    def close(self) -> None:
        """Give the port back; does not switch anything."""
        ...
