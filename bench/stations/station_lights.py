"""The light section of a station file: keys, ranges and defaults. One model for each driver; `devices` opens them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from bench.stations.placeholders import ToFillIn
from bench.stations.plugins import with_plugins
from bench.stations.sections import Hertz, LightSection
from bench.stations.station_fields import Port, Serial, Text
from bench.stations.station_text import TextLightConfig
from drivers.light import LightSettings
from drivers.light.scpi import DialectName, Load
from sequences.plain_number import Within
from sequences.script import Flicker
from sequences.strict_model import StrictModel

Volts = Annotated[float, Field(ge=-20, le=20)]
Percent = Annotated[float, Within(0.01, 1000, "%")]
_BAUD_RATES = Within(50, 20_000_000, "Bd")


class ScpiLightConfig(StrictModel):
    """A function generator that drives the lamp. Its sync output is connected to the camera's trigger input."""

    driver: Literal["scpi"]
    port: Port
    baudrate: Annotated[int, _BAUD_RATES] = 9600
    serial: Serial | None = None
    dialect: Annotated[
        DialectName, Field(description="Command dialect of the generator; see docs/stations.md.")
    ] = "keysight"
    load: Annotated[Load, Field(description="Load impedance for which the levels are stated.")] = "high-z"
    low_v: Annotated[Volts, Field(description="Level at which the lamp is dark, V.")] = 0.0
    high_v: Annotated[Volts, ToFillIn, Field(description="Level at which the lamp is brightest, V.")] = 5.0
    frequency_range_hz: tuple[Hertz, Hertz] = (0.1, 10_000.0)
    sync_output: bool = True

    @model_validator(mode="after")
    def _in_order(self) -> ScpiLightConfig:
        if self.low_v >= self.high_v:
            raise PydanticCustomError("levels_order", "low_v must be below high_v.")
        if self.frequency_range_hz[0] >= self.frequency_range_hz[1]:
            raise PydanticCustomError("range_order", "frequency_range_hz must be [lowest, highest].")
        return self

    @property
    def ports(self) -> tuple[str, ...]:
        """Port of the device."""
        return (self.port,)

    def settings(self, flicker: Flicker) -> LightSettings:
        """Convert the flicker of a sequence to settings of the driver.

        Returns: With the levels of this lamp, V.
        """
        return LightSettings(
            waveform=flicker.waveform,
            frequency_hz=flicker.frequency_hz,
            duty_percent=flicker.duty_percent,
            low_v=self.low_v,
            high_v=self.low_v + (self.high_v - self.low_v) * flicker.level_percent / 100,
            sync_output=self.sync_output,
        )


class GardasoftLightConfig(StrictModel):
    """A Gardasoft RT strobe controller. One channel drives the lamp, another one the camera's trigger input."""

    driver: Literal["gardasoft"]
    port: Port
    baudrate: Annotated[int, _BAUD_RATES] = 115_200
    model: Annotated[
        Text | None,
        Field(description="Model that the controller reports (RT420F-20). Without it, any is accepted."),
    ] = None
    channel: Annotated[int, Field(ge=1, le=8)] = 1
    sync_channel: Annotated[int, Field(ge=1, le=8)] | None = 2
    full_percent: Annotated[Percent, Field(description="Brightness of the lamp at level 100 %.")] = 100.0
    sync_percent: Percent = 100.0
    frequency_range_hz: tuple[Hertz, Hertz] = (1.0, 1_000.0)

    @property
    def ports(self) -> tuple[str, ...]:
        """Port of the device."""
        return (self.port,)

    @property
    def sync_output(self) -> bool:
        """Whether a channel drives the camera's trigger input."""
        return self.sync_channel is not None

    def settings(self, flicker: Flicker) -> LightSettings:
        """Convert the flicker of a sequence to settings of the driver, which takes 5 V as full brightness.

        Returns: The level is in ``high_v``, V.
        """
        return LightSettings(
            waveform=flicker.waveform,
            frequency_hz=flicker.frequency_hz,
            duty_percent=flicker.duty_percent,
            high_v=LightSettings.high_v * flicker.level_percent / 100,
            sync_output=self.sync_output,
        )


if TYPE_CHECKING:
    _Lights = ScpiLightConfig | GardasoftLightConfig | LightSection
else:
    _Lights = with_plugins("light", (ScpiLightConfig, GardasoftLightConfig, TextLightConfig))

LightConfig = _Lights
