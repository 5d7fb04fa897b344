"""What a station file says of each family of devices: their words, their bounds, their defaults.

One model a driver; `devices` opens what they describe. The words of an axis are those of the driver's own
description of it, so that what a station says can be handed on as it stands.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, ValidationInfo, field_validator, model_validator
from pydantic_core import PydanticCustomError

from drivers.camera.frames import FrameSettings
from drivers.light import LightSettings
from drivers.light.scpi_dialects import DialectName, Load
from drivers.stage import AxisLimits
from sequences.schema import Angle, Axis, Words
from sequences.script import Flicker

SIMULATED = "sim:"
SIMULATED_PORTS = (
    "sim:gimbal",
    "sim:gimbal-pan",
    "sim:gimbal-tilt",
    "sim:gimbal-roll",
    "sim:light",
    "sim:camera",
    "sim:frame-camera",
)


def _simulated_or_real(port: str, info: ValidationInfo) -> str:
    """Let a simulated port pass only where the station has a simulation to give it."""
    if not port.startswith(SIMULATED):
        return port
    if port not in SIMULATED_PORTS:
        known = ", ".join(SIMULATED_PORTS)
        raise PydanticCustomError(
            "no_such_simulated_port", "no such simulated device; known: {known}.", {"known": known}
        )
    document = (info.context or {}).get("document", {})
    if "simulation" not in document:
        raise PydanticCustomError(
            "no_simulation", "a simulated device needs a simulation section (simulation: {} will do)."
        )
    return port


Text = Annotated[str, Field(min_length=1, max_length=200)]
Port = Annotated[Text, AfterValidator(_simulated_or_real)]
Serial = Annotated[
    str,
    Field(
        min_length=1,
        max_length=64,
        description="As the device says it, zeros included.",
        json_schema_extra={
            "type": ["string", "integer"]
        },  # an editor may take it for a number; the reader never
    ),
]
Positive = Annotated[float, Field(gt=0)]
Volts = Annotated[float, Field(ge=-20, le=20)]


def _not_zero(scale: float) -> float:
    if scale == 0:
        raise PydanticCustomError("no_scale", "a scale of 0 moves nothing.")
    return scale


Scale = Annotated[float, AfterValidator(_not_zero)]

# ---------------------------------------------------------------- stages


class AxisWords(Words):
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

    def own_words(self) -> dict[str, Any]:
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


class ZaberAxis(AxisWords):
    """One rotary axis of a Zaber chain."""

    device: Annotated[int, Field(ge=1, le=99, description="Address in the chain.")]
    axis: Annotated[int, Field(ge=1, le=9)] = 1
    serial: Serial
    microsteps_per_deg: Annotated[
        Scale, Field(description="Negative where the counter falls as the angle grows.")
    ]
    encoder_tolerance_deg: Annotated[float, Field(gt=0, le=5)] = 0.05


class ZaberAsciiStage(Words):
    """One to three rotary axes that speak Zaber's ASCII protocol on one line."""

    driver: Literal["zaber_ascii"]
    port: Port
    baudrate: Annotated[int, Field(gt=0)] = 115_200
    axes: Annotated[dict[Axis, ZaberAxis], Field(min_length=1), _differing("device", "axis")]

    @property
    def ports(self) -> tuple[str, ...]:
        """Its port."""
        return (self.port,)


class XimcAxis(AxisWords):
    """One axis on a Standa 8SMC4 or 8SMC5 controller of its own."""

    port: Port
    serial: Serial
    steps_per_deg: Annotated[Scale, Field(description="Full steps; negative where the counter falls.")]
    encoder_counts_per_deg: Scale | None = None
    encoder_tolerance_deg: Annotated[float, Field(gt=0, le=5)] = 0.05


class XimcStage(Words):
    """One to three rotary axes on Standa controllers that speak XIMC, each on its own port."""

    driver: Literal["ximc"]
    axes: Annotated[dict[Axis, XimcAxis], Field(min_length=1), _differing("port")]

    @property
    def ports(self) -> tuple[str, ...]:
        """The ports of its controllers."""
        return tuple(axis.port for axis in self.axes.values())


class GrblAxis(AxisWords):
    """One axis of a home-built gimbal."""

    letter: Annotated[
        Literal["X", "Y", "Z", "A", "B", "C"], Field(description="The board's name of the axis.")
    ]
    steps_per_deg: Annotated[float, Field(gt=0, description="As the board's $100 ... must say.")]


class GrblStage(Words):
    """One to three rotary axes on a board that runs GRBL 1.1."""

    driver: Literal["grbl"]
    port: Port
    baudrate: Annotated[int, Field(gt=0)] = 115_200
    serial: Annotated[
        Serial | None,
        Field(description="The name given to the board with $I=...; without it, any board will do."),
    ] = None
    axes: Annotated[dict[Axis, GrblAxis], Field(min_length=1), _differing("letter")]

    @property
    def ports(self) -> tuple[str, ...]:
        """Its port."""
        return (self.port,)


class EspAxis(AxisWords):
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


class EspStage(Words):
    """One to three rotary axes on a Newport ESP300, ESP301 or ESP302."""

    driver: Literal["esp30x"]
    port: Port
    baudrate: Annotated[int, Field(gt=0)] = 19_200
    axes: Annotated[dict[Axis, EspAxis], Field(min_length=1), _differing("number")]

    @property
    def ports(self) -> tuple[str, ...]:
        """Its port."""
        return (self.port,)


Stage = Annotated[ZaberAsciiStage | XimcStage | GrblStage | EspStage, Field(discriminator="driver")]

# ---------------------------------------------------------------- lights


class ScpiLight(Words):
    """A function generator that drives the lamp; its sync output goes to the camera's trigger input."""

    driver: Literal["scpi"]
    port: Port
    baudrate: Annotated[int, Field(gt=0)] = 9600
    serial: Serial | None = None
    dialect: Annotated[DialectName, Field(description="How it wants its commands; see docs/stations.md.")] = (
        "keysight"
    )
    load: Annotated[Load, Field(description="What its levels are stated for.")] = "high-z"
    low_v: Annotated[Volts, Field(description="The lamp dark.")] = 0.0
    high_v: Annotated[Volts, Field(description="The lamp at its brightest.")] = 5.0
    frequency_range_hz: tuple[Positive, Positive] = (0.1, 10_000.0)
    sync_output: bool = True

    @model_validator(mode="after")
    def _in_order(self) -> ScpiLight:
        if self.low_v >= self.high_v:
            raise PydanticCustomError("levels_order", "low_v must be below high_v.")
        if self.frequency_range_hz[0] >= self.frequency_range_hz[1]:
            raise PydanticCustomError("range_order", "frequency_range_hz must be [lowest, highest].")
        return self

    @property
    def ports(self) -> tuple[str, ...]:
        """Its port."""
        return (self.port,)

    def settings(self, flicker: Flicker) -> LightSettings:
        """Turn a sequence's flicker into this light's settings."""
        return LightSettings(
            waveform=flicker.waveform,
            frequency_hz=flicker.frequency_hz,
            duty_percent=flicker.duty_percent,
            low_v=self.low_v,
            high_v=self.low_v + (self.high_v - self.low_v) * flicker.level_percent / 100,
            sync_output=self.sync_output,
        )


class GardasoftLight(Words):
    """A Gardasoft RT strobe controller; one of its channels is the lamp, another the sync to the camera."""

    driver: Literal["gardasoft"]
    port: Port
    baudrate: Annotated[int, Field(gt=0)] = 115_200
    model: Annotated[
        Text | None, Field(description="As it says itself (RT420F-20); without it, any will do.")
    ] = None
    channel: Annotated[int, Field(ge=1, le=8)] = 1
    sync_channel: Annotated[int, Field(ge=1, le=8)] | None = 2
    full_percent: Annotated[
        float, Field(gt=0, le=1000, description="Brightness of the lamp at its fullest.")
    ] = 100.0
    sync_percent: Annotated[float, Field(gt=0, le=1000)] = 100.0
    frequency_range_hz: tuple[Positive, Positive] = (1.0, 1_000.0)

    @property
    def ports(self) -> tuple[str, ...]:
        """Its port."""
        return (self.port,)

    @property
    def sync_output(self) -> bool:
        """Whether one of its channels gives the camera its sync."""
        return self.sync_channel is not None

    def settings(self, flicker: Flicker) -> LightSettings:
        """Turn a sequence's flicker into this light's settings: its brightest is 5 V's worth."""
        return LightSettings(
            waveform=flicker.waveform,
            frequency_hz=flicker.frequency_hz,
            duty_percent=flicker.duty_percent,
            high_v=LightSettings.high_v * flicker.level_percent / 100,
            sync_output=self.sync_output,
        )


Light = Annotated[ScpiLight | GardasoftLight, Field(discriminator="driver")]

# ---------------------------------------------------------------- cameras


NotNegative = Annotated[int, Field(ge=0, le=8191)]
Pixels = Annotated[int, Field(gt=0, le=8192)]


class Biases(Words):
    """Offsets from the factory values, within what an IMX636 takes; those not named stay at 0."""

    bias_diff_on: Annotated[int, Field(ge=-150, le=200)] = 0
    bias_diff_off: Annotated[int, Field(ge=-150, le=200)] = 0
    bias_fo: Annotated[int, Field(ge=-150, le=200)] = 0
    bias_hpf: Annotated[int, Field(ge=0, le=255)] = 0
    bias_refr: Annotated[int, Field(ge=-50, le=255)] = 0


class CameraWords(Words):
    """What every camera has."""

    serial: Serial
    biases: Biases = Biases()
    roi: Annotated[
        tuple[NotNegative, NotNegative, Pixels, Pixels] | None,
        Field(
            description="Only part of the sensor: column, row, width, height, px. `metavision` alone sets it."
        ),
    ] = None
    lens: Text | None = None

    @property
    def ports(self) -> tuple[str, ...]:
        """Ports it is reached by; cameras on USB have none."""
        return ()


class SimulatedEvk4(CameraWords):
    """A simulated EVK4, reached over a local socket."""

    driver: Literal["simulated_evk4"]
    address: Port

    @property
    def ports(self) -> tuple[str, ...]:
        """Its address."""
        return (self.address,)


class MetavisionCamera(CameraWords):
    """A Prophesee camera, reached through Metavision or OpenEB as installed on this computer."""

    driver: Literal["metavision"]


class NeuromorphicEvk4(CameraWords):
    """An EVK4 reached through `neuromorphic-drivers` (extra ``evk4``), without the vendor's software."""

    driver: Literal["neuromorphic_evk4"]


class RecordedCamera(CameraWords):
    """RAW recordings played as a camera, one a recording in the order of their names."""

    driver: Literal["recorded"]
    path: Path


class FrameCameraWords(Words):
    """What every frame camera has; its light burns steadily."""

    serial: Annotated[
        str, Field(max_length=64, description="As USB tells it; without it, any camera will do.")
    ] = ""
    lens: Text | None = None
    pictures: Annotated[int, Field(ge=1, le=1000, description="Taken at each pose, and averaged.")] = 8

    @property
    def ports(self) -> tuple[str, ...]:
        """Ports it is reached by."""
        return ()

    def settings(self) -> FrameSettings:
        """Settings as drivers take them."""
        return FrameSettings()


class OpenCvCamera(FrameCameraWords):
    """Whatever OpenCV opens as a video source: a video device, a network camera."""

    driver: Literal["opencv"]
    source: Annotated[
        Port, Field(description="/dev/v4l/by-id/..., a number, or a URL (rtsp://, http://, tcp://).")
    ]
    exposure: Annotated[float | None, Field(description="In the camera driver's own units.")] = None
    gain: Annotated[float | None, Field(description="In the camera driver's own units.")] = None

    @property
    def ports(self) -> tuple[str, ...]:
        """Its source."""
        return (self.source,)

    def settings(self) -> FrameSettings:
        """Settings as drivers take them."""
        return FrameSettings(self.exposure, self.gain)


class PictureFolder(FrameCameraWords):
    """A folder of pictures played as a camera, so many a recording in the order of their names."""

    driver: Literal["pictures"]
    path: Path


Camera = Annotated[
    SimulatedEvk4 | MetavisionCamera | NeuromorphicEvk4 | RecordedCamera | OpenCvCamera | PictureFolder,
    Field(discriminator="driver"),
]
