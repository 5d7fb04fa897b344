"""The stage and light sections of a station file: keys, ranges and defaults, one model for each driver.

Keys of an axis are the driver's parameters. A driver is imported when its section is opened.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, Field, field_validator, model_validator

from bench.stations.placeholders import ToFillIn, not_zero
from bench.stations.plugins import with_plugins
from bench.stations.sections import (
    AnyLight,
    AnyStage,
    AxisConfig,
    Hertz,
    PortName,
    SerialLine,
    Speed,
    Tolerance,
    differing,
    driver_axes,
)
from bench.stations.station_fields import Port, Serial, Text
from bench.stations.station_text import TextLightConfig, TextStageConfig
from drivers.clock import Clock
from drivers.light import Light, LightSettings
from drivers.light.scpi_dialects import DialectName, Load
from drivers.stage import Stage
from drivers.wire_log import WireLog
from sequences.schema import Angle, Axis
from sequences.script import Flicker
from sequences.strict_model import Form, Within

_BAUD_RATES = Within(50, 20_000_000, "Bd")
Scale = Annotated[
    float, AfterValidator(not_zero), Within(0.01, 1e9, "counts/deg", either_sign=True), ToFillIn
]
Volts = Annotated[float, Field(ge=-20, le=20)]
Percent = Annotated[float, Within(0.01, 1000, "%")]


class ThorlabsAxisConfig(AxisConfig):
    """One axis, on its own Thorlabs controller."""

    scale_key: ClassVar[str] = "counts_per_deg"
    port: Port
    serial: Serial
    """Serial number of the controller, from its label."""
    counts_per_deg: Scale
    """136533.333 for a K10CR1, 1919.6418579 for a PRM1Z8; negative if the counter decreases."""
    home_offset_deg: Angle | None = None
    """Angle from the reference switch to the zero, as the controller counts it. Default: 4 (K10CR1, PRM1Z8)."""
    home_direction: Literal["forward", "reverse"] | None = None
    """Direction of the reference search. Default: reverse (K10CR1, PRM1Z8)."""
    home_speed_deg_s: Speed | None = None
    """Speed of the reference search. Default: 10, but at most speed_deg_s."""
    tolerance_deg: Tolerance = 0.005


class ThorlabsStageConfig(AnyStage):
    """One to three Thorlabs rotation stages (K10CR1, or on a KDC101 and the like), each on its own port."""

    maker: ClassVar[str] = "Thorlabs"
    driver: Literal["thorlabs_apt"]
    axes: Annotated[dict[Axis, ThorlabsAxisConfig], Field(min_length=1, max_length=3), differing("port")]

    def open_device(self, port: PortName, *, clock: Clock, wire_log: WireLog | None) -> Stage:
        """See `AnyStage.open_device`."""
        from drivers.stage.thorlabs import ThorlabsAxis, ThorlabsStage

        axes = driver_axes(ThorlabsAxis, self.axes, port)
        return ThorlabsStage.open(axes, clock=clock, wire_log=wire_log)


class ZaberAxisConfig(AxisConfig):
    """One rotary axis of a Zaber chain."""

    scale_key: ClassVar[str] = "microsteps_per_deg"
    device: Annotated[int, Field(ge=1, le=99)]
    """Address in the chain."""
    axis: Annotated[int, Field(ge=1, le=9)] = 1
    serial: Serial
    microsteps_per_deg: Scale
    """Negative if the counter decreases while the angle increases."""
    resolution: Annotated[int, Field(ge=1, le=256)] = 64
    """Microsteps a step for which microsteps_per_deg holds."""
    settings: Annotated[
        dict[
            Annotated[str, Form(r"^[a-z][a-z0-9.]{1,60}$", "the name of a setting, such as driver.dir")],
            float,
        ],
        Field(max_length=40),
    ] = Field(default_factory=dict)
    """Settings that change angles, such as driver.dir, and their values."""
    encoder_tolerance_deg: Annotated[float, Within(1e-6, 5, "deg")] = 0.05


class ZaberStageConfig(SerialLine, AnyStage):
    """One to three rotary axes with Zaber's ASCII protocol on one serial line."""

    maker: ClassVar[str] = "Zaber"
    driver: Literal["zaber_ascii"]
    port: Port
    baudrate: Annotated[int, _BAUD_RATES] = 115_200
    axes: Annotated[dict[Axis, ZaberAxisConfig], Field(min_length=1), differing("device", "axis")]

    def open_device(self, port: PortName, *, clock: Clock, wire_log: WireLog | None) -> Stage:
        """See `AnyStage.open_device`."""
        from drivers.stage.zaber import ZaberAxis, ZaberStage

        axes = driver_axes(ZaberAxis, self.axes, port)
        return ZaberStage.open(
            port(self.port),
            axes,
            **self.line(clock, wire_log),
        )


class XimcAxisConfig(AxisConfig):
    """One axis, on its own Standa 8SMC4 or 8SMC5 controller."""

    scale_key: ClassVar[str] = "steps_per_deg"
    port: Port
    serial: Serial
    steps_per_deg: Scale
    """Full steps; negative if the counter decreases."""
    encoder_counts_per_deg: Scale | None = None
    encoder_tolerance_deg: Annotated[float, Within(1e-6, 5, "deg")] = 0.05
    home_offset_deg: Angle | None = None
    """From the sensor to the zero. Default: none; a controller that goes on is then refused."""
    reversed: bool | None = None
    """Whether the controller reverses the motor. Default: not compared."""


class XimcStageConfig(AnyStage):
    """One to three rotary axes on Standa controllers with the XIMC protocol, each on its own port."""

    maker: ClassVar[str] = "Standa"
    driver: Literal["ximc"]
    axes: Annotated[dict[Axis, XimcAxisConfig], Field(min_length=1), differing("port")]

    def open_device(self, port: PortName, *, clock: Clock, wire_log: WireLog | None) -> Stage:
        """See `AnyStage.open_device`."""
        from drivers.stage.ximc import XimcAxis, XimcStage

        axes = driver_axes(XimcAxis, self.axes, port)
        return XimcStage.open(axes, clock=clock, wire_log=wire_log)


class GrblAxisConfig(AxisConfig):
    """One axis of a home-built gimbal."""

    scale_key: ClassVar[str] = "steps_per_deg"
    letter: Literal["X", "Y", "Z", "A", "B", "C", "U", "V", "W"]
    """Letter of the axis on the board."""
    steps_per_deg: Annotated[float, Within(0.01, 1e9, "steps/deg"), ToFillIn]
    """Must equal the setting of the board: $100 for its first axis, $101 for its second, and so on."""


class GrblStageConfig(SerialLine, AnyStage):
    """One to three rotary axes on a board that runs GRBL 1.1."""

    maker: ClassVar[str] = "GRBL"
    driver: Literal["grbl"]
    port: Port
    baudrate: Annotated[int, _BAUD_RATES] = 115_200
    serial: Serial | None = None
    """Name given to the board with $I=.... Without it, any board is accepted."""
    settings: Annotated[
        dict[
            Annotated[str, Form(r"^\$([0-9]{1,4}|/[a-z0-9_/]{1,80})$", "the name of a setting, such as $3")],
            float,
        ],
        Field(max_length=40),
    ] = Field(default_factory=dict)
    """Settings that change angles, such as $3, and their values."""
    axes: Annotated[dict[Axis, GrblAxisConfig], Field(min_length=1), differing("letter")]

    def open_device(self, port: PortName, *, clock: Clock, wire_log: WireLog | None) -> Stage:
        """See `AnyStage.open_device`."""
        from drivers.stage.grbl import GrblAxis, GrblStage

        return GrblStage.open(
            port(self.port),
            driver_axes(GrblAxis, self.axes, port),
            serial=self.serial or "",
            settings=self.settings,
            **self.line(clock, wire_log),
        )


class EspAxisConfig(AxisConfig):
    """One axis of a Newport ESP controller, which works in degrees."""

    number: Annotated[int, Field(ge=1, le=3)]
    serial: Serial
    """Serial number of the stage, from the controller's answer to 1ID?."""
    home_mode: Literal[1, 2, 3, 4, 5, 6] = 1
    """Method of the reference search: the number of the command OR."""
    direction: Literal[1, -1] = 1
    resolution_deg: Annotated[float, Within(1e-9, 10, "deg")] | None = None
    """Degrees of an encoder count, as the answer to 1SU? must be. Default: not compared."""

    @field_validator("direction", "home_mode", mode="before")
    @classmethod
    def _whole(cls, value: Any) -> Any:
        return int(value) if isinstance(value, str) and value in {"-1", "+1", *"123456"} else value


class EspStageConfig(SerialLine, AnyStage):
    """One to three rotary axes on a Newport ESP300, ESP301 or ESP302."""

    maker: ClassVar[str] = "Newport"
    driver: Literal["esp30x"]
    port: Port
    baudrate: Annotated[int, _BAUD_RATES] = 19_200
    axes: Annotated[dict[Axis, EspAxisConfig], Field(min_length=1), differing("number")]

    def open_device(self, port: PortName, *, clock: Clock, wire_log: WireLog | None) -> Stage:
        """See `AnyStage.open_device`."""
        from drivers.stage.esp import EspAxis, EspStage

        axes = driver_axes(EspAxis, self.axes, port)
        return EspStage.open(
            port(self.port),
            axes,
            **self.line(clock, wire_log),
        )


if TYPE_CHECKING:
    StageConfig = AnyStage
else:
    StageConfig = with_plugins(
        "stage",
        (
            ZaberStageConfig,
            XimcStageConfig,
            GrblStageConfig,
            EspStageConfig,
            ThorlabsStageConfig,
            TextStageConfig,
        ),
        taken_out={
            "dynamixel": "because a servo's step of 0.088 degrees is too coarse to calibrate a camera."
            " Use another stage."
        },
    )


class ScpiLightConfig(SerialLine, AnyLight):
    """A function generator that drives the lamp. Its sync output is connected to the camera's trigger input."""

    maker: ClassVar[str] = "generator"
    driver: Literal["scpi"]
    port: Port
    baudrate: Annotated[int, _BAUD_RATES] = 9600
    serial: Serial | None = None
    dialect: DialectName = "keysight"
    """Command dialect of the generator; see docs/stations.md."""
    load: Load = "high-z"
    """Load impedance for which the levels are stated."""
    low_v: Volts = 0.0
    """Level at which the lamp is dark, V."""
    high_v: Annotated[Volts, ToFillIn] = 5.0
    """Level at which the lamp is brightest, V."""
    frequency_range_hz: tuple[Hertz, Hertz] = (0.1, 10_000.0)
    sync_output: bool = True

    @model_validator(mode="after")
    def _in_order(self) -> ScpiLightConfig:
        if self.low_v >= self.high_v:
            raise ValueError("low_v must be below high_v.")
        if self.frequency_range_hz[0] >= self.frequency_range_hz[1]:
            raise ValueError("frequency_range_hz must be [lowest, highest].")
        return self

    def settings(self, flicker: Flicker) -> LightSettings:
        """Convert the flicker of a sequence to settings of the driver, with the levels of this lamp, V."""
        high_v = self.low_v + (self.high_v - self.low_v) * flicker.level_percent / 100
        return replace(super().settings(flicker), low_v=self.low_v, high_v=high_v)

    def open_device(self, port: PortName, *, clock: Clock, wire_log: WireLog | None) -> Light:
        """See `AnyLight.open_device`."""
        from drivers.light.scpi import ScpiLight

        return ScpiLight.open(
            port(self.port),
            serial=self.serial,
            load=self.load,
            dialect=self.dialect,
            **self.line(clock, wire_log),
        )


class GardasoftLightConfig(SerialLine, AnyLight):
    """A Gardasoft RT strobe controller. One channel drives the lamp, another one the camera's trigger input."""

    driver: Literal["gardasoft"]
    port: Port
    baudrate: Annotated[int, _BAUD_RATES] = 115_200
    model: Text | None = None
    """Model that the controller reports (RT420F-20). Without it, any is accepted."""
    channel: Annotated[int, Field(ge=1, le=8)] = 1
    sync_channel: Annotated[int, Field(ge=1, le=8)] | None = 2
    full_percent: Percent = 100.0
    """Brightness of the lamp at level 100 %."""
    sync_percent: Percent = 100.0
    frequency_range_hz: tuple[Hertz, Hertz] = (1.0, 1_000.0)

    @property
    def sync_output(self) -> bool:
        """Whether a channel drives the camera's trigger input."""
        return self.sync_channel is not None

    def open_device(self, port: PortName, *, clock: Clock, wire_log: WireLog | None) -> Light:
        """See `AnyLight.open_device`."""
        from drivers.light.gardasoft import GardasoftLight

        return GardasoftLight.open(
            port(self.port),
            model=self.model,
            channel=self.channel,
            sync_channel=self.sync_channel,
            full_percent=self.full_percent,
            sync_percent=self.sync_percent,
            **self.line(clock, wire_log),
        )


if TYPE_CHECKING:
    LightConfig = AnyLight
else:
    LightConfig = with_plugins("light", (ScpiLightConfig, GardasoftLightConfig, TextLightConfig))
