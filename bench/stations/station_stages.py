"""What a station file says of stages: their words, their bounds, their defaults.

One model a driver; `devices` opens what they describe. The words of an axis are those of the driver's own
description of it, so that what a station says can be handed on as it stands.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, field_validator
from pydantic_core import PydanticCustomError

from bench.stations.station_fields import Port, Serial
from drivers.stage import AxisLimits
from sequences.schema import Angle, Axis, StrictModel


def _not_zero(scale: float) -> float:
    if scale == 0:
        raise PydanticCustomError("no_scale", "a scale of 0 moves nothing.")
    return scale


Scale = Annotated[float, AfterValidator(_not_zero)]


class AxisConfig(StrictModel):
    """What every rotary axis has. Its scale is stated in each family's own counts, never guessed from a name."""

    zero_deg: Annotated[Angle, Field(description="Angle at which the controller's counter is 0.")] = 0.0
    limits_deg: Annotated[tuple[Angle, Angle], Field(description="Lowest and highest angle of the bench.")]
    speed_deg_s: Annotated[float, Field(gt=0, le=1000)]
    acceleration_deg_s2: Annotated[float, Field(gt=0, le=100_000)]
    tolerance_deg: Annotated[float, Field(gt=0, le=1, description="How near its target a move must end.")] = (
        0.002
    )

    @field_validator("limits_deg")
    @classmethod
    def _in_order(cls, limits: tuple[float, float]) -> tuple[float, float]:
        if limits[0] >= limits[1]:
            raise PydanticCustomError("limits_order", "the lower limit must be below the upper one.")
        if not limits[0] <= 0 <= limits[1]:
            raise PydanticCustomError(
                "no_zero", "0 degrees must be within the limits: there the stage is parked."
            )
        return limits

    @property
    def limits(self) -> AxisLimits:
        """Limits as drivers take them."""
        return AxisLimits(*self.limits_deg, self.speed_deg_s, self.acceleration_deg_s2)

    def driver_options(self) -> dict[str, Any]:
        """Give what is said beside the limits, in the driver's own words."""
        return self.model_dump(exclude={"limits_deg", "speed_deg_s", "acceleration_deg_s2"})


def _differing(*keys: str) -> AfterValidator:
    """Let no two axes share what tells them apart."""

    def check(axes: dict[Axis, Any]) -> dict[Axis, Any]:
        if len({tuple(getattr(axis, key) for key in keys) for axis in axes.values()}) < len(axes):
            shared = " and ".join(keys)
            raise PydanticCustomError("same_address", "two axes have the same {shared}.", {"shared": shared})
        return axes

    return AfterValidator(check)


class ZaberAxisConfig(AxisConfig):
    """One rotary axis of a Zaber chain."""

    device: Annotated[int, Field(ge=1, le=99, description="Address in the chain.")]
    axis: Annotated[int, Field(ge=1, le=9)] = 1
    serial: Serial
    microsteps_per_deg: Annotated[
        Scale, Field(description="Negative where the counter falls as the angle grows.")
    ]
    encoder_tolerance_deg: Annotated[float, Field(gt=0, le=5)] = 0.05


class ZaberStageConfig(StrictModel):
    """One to three rotary axes that speak Zaber's ASCII protocol on one line."""

    driver: Literal["zaber_ascii"]
    port: Port
    baudrate: Annotated[int, Field(gt=0)] = 115_200
    axes: Annotated[dict[Axis, ZaberAxisConfig], Field(min_length=1), _differing("device", "axis")]

    @property
    def ports(self) -> tuple[str, ...]:
        """Its port."""
        return (self.port,)


class XimcAxisConfig(AxisConfig):
    """One axis on a Standa 8SMC4 or 8SMC5 controller of its own."""

    port: Port
    serial: Serial
    steps_per_deg: Annotated[Scale, Field(description="Full steps; negative where the counter falls.")]
    encoder_counts_per_deg: Scale | None = None
    encoder_tolerance_deg: Annotated[float, Field(gt=0, le=5)] = 0.05


class XimcStageConfig(StrictModel):
    """One to three rotary axes on Standa controllers that speak XIMC, each on its own port."""

    driver: Literal["ximc"]
    axes: Annotated[dict[Axis, XimcAxisConfig], Field(min_length=1), _differing("port")]

    @property
    def ports(self) -> tuple[str, ...]:
        """The ports of its controllers."""
        return tuple(axis.port for axis in self.axes.values())


class GrblAxisConfig(AxisConfig):
    """One axis of a home-built gimbal."""

    letter: Annotated[
        Literal["X", "Y", "Z", "A", "B", "C"], Field(description="The board's name of the axis.")
    ]
    steps_per_deg: Annotated[float, Field(gt=0, description="As the board's $100 ... must say.")]


class GrblStageConfig(StrictModel):
    """One to three rotary axes on a board that runs GRBL 1.1."""

    driver: Literal["grbl"]
    port: Port
    baudrate: Annotated[int, Field(gt=0)] = 115_200
    serial: Annotated[
        Serial | None,
        Field(description="The name given to the board with $I=...; without it, any board will do."),
    ] = None
    axes: Annotated[dict[Axis, GrblAxisConfig], Field(min_length=1), _differing("letter")]

    @property
    def ports(self) -> tuple[str, ...]:
        """Its port."""
        return (self.port,)


class EspAxisConfig(AxisConfig):
    """One axis of a Newport ESP controller, which counts in degrees itself."""

    number: Annotated[int, Field(ge=1, le=3)]
    serial: Annotated[Serial, Field(description="Of the stage, as the controller's 1ID? says it.")]
    home_mode: Annotated[
        Literal[1, 2, 3, 4, 5, 6], Field(description="How it searches its reference: the number behind OR.")
    ] = 1
    direction: Literal[1, -1] = 1

    @field_validator("direction", "home_mode", mode="before")
    @classmethod
    def _whole(cls, value: Any) -> Any:
        return int(value) if isinstance(value, str) and value in {"-1", "+1", *"123456"} else value


class EspStageConfig(StrictModel):
    """One to three rotary axes on a Newport ESP300, ESP301 or ESP302."""

    driver: Literal["esp30x"]
    port: Port
    baudrate: Annotated[int, Field(gt=0)] = 19_200
    axes: Annotated[dict[Axis, EspAxisConfig], Field(min_length=1), _differing("number")]

    @property
    def ports(self) -> tuple[str, ...]:
        """Its port."""
        return (self.port,)


StageConfig = Annotated[
    ZaberStageConfig | XimcStageConfig | GrblStageConfig | EspStageConfig, Field(discriminator="driver")
]
