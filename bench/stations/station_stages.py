"""The stage section of a station file: keys, ranges and defaults. One model for each driver; `devices` opens them.

The keys of an axis are the parameter names of the driver's axis, so that the values are passed on unchanged.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AfterValidator, Field, field_validator
from pydantic_core import PydanticCustomError

from bench.stations.placeholders import ToFillIn
from bench.stations.plugins import with_plugins
from bench.stations.sections import AxisConfig, StageSection
from bench.stations.station_fields import Port, Serial
from bench.stations.station_motors import DynamixelStageConfig, ThorlabsStageConfig
from bench.stations.station_text import TextStageConfig
from sequences.plain_number import Within
from sequences.schema import Axis
from sequences.strict_model import StrictModel


def _not_zero(scale: float) -> float:
    if scale == 0:
        raise PydanticCustomError("no_scale", "a scale of 0 moves nothing.")
    return scale


_SCALES = Within(0.01, 1e9, "counts/deg", either_sign=True)
_BAUD_RATES = Within(50, 20_000_000, "Bd")
Scale = Annotated[float, AfterValidator(_not_zero), _SCALES, ToFillIn]


def _differing(*keys: str) -> AfterValidator:
    """Return a check that no two axes have the same values of these keys."""

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
        Scale,
        Field(description="Negative if the counter decreases while the angle increases."),
    ]
    encoder_tolerance_deg: Annotated[float, Within(1e-6, 5, "deg")] = 0.05


class ZaberStageConfig(StrictModel):
    """One to three rotary axes with Zaber's ASCII protocol on one serial line."""

    driver: Literal["zaber_ascii"]
    port: Port
    baudrate: Annotated[int, _BAUD_RATES] = 115_200
    axes: Annotated[dict[Axis, ZaberAxisConfig], Field(min_length=1), _differing("device", "axis")]

    @property
    def ports(self) -> tuple[str, ...]:
        """Port of the device."""
        return (self.port,)


class XimcAxisConfig(AxisConfig):
    """One axis, on its own Standa 8SMC4 or 8SMC5 controller."""

    port: Port
    serial: Serial
    steps_per_deg: Annotated[Scale, Field(description="Full steps; negative if the counter decreases.")]
    encoder_counts_per_deg: Scale | None = None
    encoder_tolerance_deg: Annotated[float, Within(1e-6, 5, "deg")] = 0.05


class XimcStageConfig(StrictModel):
    """One to three rotary axes on Standa controllers with the XIMC protocol, each on its own port."""

    driver: Literal["ximc"]
    axes: Annotated[dict[Axis, XimcAxisConfig], Field(min_length=1), _differing("port")]

    @property
    def ports(self) -> tuple[str, ...]:
        """Ports of the controllers."""
        return tuple(axis.port for axis in self.axes.values())


class GrblAxisConfig(AxisConfig):
    """One axis of a home-built gimbal."""

    letter: Annotated[
        Literal["X", "Y", "Z", "A", "B", "C"], Field(description="Letter of the axis on the board.")
    ]
    steps_per_deg: Annotated[
        float,
        Within(0.01, 1e9, "steps/deg"),
        ToFillIn,
        Field(description="Must equal the setting of the board: $100 for X, $101 for Y, and so on."),
    ]


class GrblStageConfig(StrictModel):
    """One to three rotary axes on a board that runs GRBL 1.1."""

    driver: Literal["grbl"]
    port: Port
    baudrate: Annotated[int, _BAUD_RATES] = 115_200
    serial: Annotated[
        Serial | None,
        Field(description="Name given to the board with $I=.... Without it, any board is accepted."),
    ] = None
    axes: Annotated[dict[Axis, GrblAxisConfig], Field(min_length=1), _differing("letter")]

    @property
    def ports(self) -> tuple[str, ...]:
        """Port of the device."""
        return (self.port,)


class EspAxisConfig(AxisConfig):
    """One axis of a Newport ESP controller, which works in degrees."""

    number: Annotated[int, Field(ge=1, le=3)]
    serial: Annotated[
        Serial, Field(description="Serial number of the stage, from the controller's answer to 1ID?.")
    ]
    home_mode: Annotated[
        Literal[1, 2, 3, 4, 5, 6],
        Field(description="Method of the reference search: the number of the command OR."),
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
    baudrate: Annotated[int, _BAUD_RATES] = 19_200
    axes: Annotated[dict[Axis, EspAxisConfig], Field(min_length=1), _differing("number")]

    @property
    def ports(self) -> tuple[str, ...]:
        """Port of the device."""
        return (self.port,)


if TYPE_CHECKING:
    _Stages = ZaberStageConfig | XimcStageConfig | GrblStageConfig | EspStageConfig | StageSection
else:
    _OWN = (ZaberStageConfig, XimcStageConfig, GrblStageConfig, EspStageConfig)
    _BUILT_IN = (*_OWN, ThorlabsStageConfig, DynamixelStageConfig, TextStageConfig)
    _Stages = with_plugins("stage", _BUILT_IN)

StageConfig = _Stages
