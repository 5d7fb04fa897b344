"""What a station file says: which devices stand on a bench, where, and what they may be asked for.

Knows the shape and the sense of the file, not how a device is opened (``bench.devices``). The station alone
differs between a simulated bench and a real one; sequences fit both.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, ValidationInfo, field_validator, model_validator
from pydantic_core import PydanticCustomError

from calib.errors import InputMismatch
from calib.target import StarTarget
from drivers.light import LightSettings
from drivers.stage import AxisLimits
from sequences.reader import Located, find_document, read_document
from sequences.schema import Angle, Axis, Name, Words
from sequences.script import Flicker

SHIPPED = Path(__file__).parent / "stations"
SIMULATED = "sim:"
SIMULATED_PORTS = ("sim:gimbal", "sim:light", "sim:camera")


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


class ZaberAxis(Words):
    """One rotary axis of a Zaber chain. Its scale is stated, never guessed from a model's name."""

    device: Annotated[int, Field(ge=1, le=99, description="Address in the chain.")]
    axis: Annotated[int, Field(ge=1, le=9)] = 1
    serial: Serial
    microsteps_per_deg: Annotated[
        float, Field(description="Negative where the counter falls as the angle grows.")
    ]
    zero_deg: Annotated[Angle, Field(description="Angle at which the controller's counter is 0.")] = 0.0
    limits_deg: Annotated[tuple[Angle, Angle], Field(description="Lowest and highest angle of the bench.")]
    speed_deg_s: Annotated[float, Field(gt=0, le=1000)]
    acceleration_deg_s2: Annotated[float, Field(gt=0, le=100_000)]
    tolerance_deg: Annotated[float, Field(gt=0, le=1, description="How near its target a move must end.")] = (
        0.002
    )
    encoder_tolerance_deg: Annotated[float, Field(gt=0, le=5)] = 0.05

    @field_validator("microsteps_per_deg")
    @classmethod
    def _not_zero(cls, scale: float) -> float:
        if scale == 0:
            raise PydanticCustomError("no_scale", "a scale of 0 moves nothing.")
        return scale

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


class ZaberAsciiStage(Words):
    """One to three rotary axes that speak Zaber's ASCII protocol on one line."""

    driver: Literal["zaber_ascii"]
    port: Port
    baudrate: Annotated[int, Field(gt=0)] = 115_200
    axes: Annotated[dict[Axis, ZaberAxis], Field(min_length=1)]

    @field_validator("axes")
    @classmethod
    def _one_address_each(cls, axes: dict[Axis, ZaberAxis]) -> dict[Axis, ZaberAxis]:
        addresses = {(axis.device, axis.axis) for axis in axes.values()}
        if len(addresses) < len(axes):
            raise PydanticCustomError("same_address", "two axes have the same device and axis number.")
        return axes


class ScpiLight(Words):
    """A function generator that drives the lamp; its sync output goes to the camera's trigger input."""

    driver: Literal["scpi"]
    port: Port
    baudrate: Annotated[int, Field(gt=0)] = 9600
    serial: Serial | None = None
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


class Biases(Words):
    """Offsets from the factory values, within what an IMX636 takes; those not named stay at 0."""

    bias_diff_on: Annotated[int, Field(ge=-150, le=200)] = 0
    bias_diff_off: Annotated[int, Field(ge=-150, le=200)] = 0
    bias_fo: Annotated[int, Field(ge=-150, le=200)] = 0
    bias_hpf: Annotated[int, Field(ge=0, le=255)] = 0
    bias_refr: Annotated[int, Field(ge=-50, le=255)] = 0


class SimulatedEvk4(Words):
    """A simulated EVK4, reached over a local socket."""

    driver: Literal["simulated_evk4"]
    address: Port
    serial: Serial
    biases: Biases = Biases()
    lens: Text | None = None


class MetavisionCamera(Words):
    """A Prophesee camera, reached through Metavision or OpenEB as installed on this computer."""

    driver: Literal["metavision"]
    serial: Serial
    biases: Biases = Biases()
    lens: Text | None = None


class Target(Words):
    """The printed star pattern."""

    squares: tuple[int, int] = (50, 72)
    pitch_mm: Positive = 144.5 / 36
    segments: int = 16
    tag_id: int = 3
    tag_square: tuple[int, int] = (23, 34)
    tag_squares: int = 4

    @model_validator(mode="after")
    def _printable(self) -> Target:
        try:
            self.pattern()
        except InputMismatch as error:
            raise PydanticCustomError(
                "not_printable", "{what}", {"what": f"no such target can be printed: {error.what}"}
            ) from None
        return self

    def pattern(self) -> StarTarget:
        """Give the pattern as the engine takes it."""
        return StarTarget(
            squares_x=self.squares[0],
            squares_y=self.squares[1],
            pitch_mm=self.pitch_mm,
            segments=self.segments,
            tag_id=self.tag_id,
            tag_square=self.tag_square,
            tag_squares=self.tag_squares,
        )


class Collimator(Words):
    """What is known of the collimator beforehand; for the report, no estimator reads it."""

    serial: Serial | None = None
    nominal_r_mm: Positive | None = None
    certificate: Text | None = None


class Disk(Words):
    """What must be free on the disk before a run, besides what the run itself needs."""

    min_free_gb: Annotated[float, Field(ge=0, le=1_000_000)] = 1.0


_TRUTHS = {"true": True, "false": False}
_NUMBER = re.compile(r"[-+]?(?!0\d)(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")


def _plain_values(section: Any) -> Any:
    """Turn a free section's texts into numbers and truths; serial numbers and 007 stay text."""
    if isinstance(section, Mapping):
        return {key: value if "serial" in key else _plain_values(value) for key, value in section.items()}
    if isinstance(section, list):
        return [_plain_values(value) for value in section]
    if not isinstance(section, str) or not _NUMBER.fullmatch(section):
        return _TRUTHS.get(section, section) if isinstance(section, str) else section
    number = float(section)
    if not math.isfinite(number):
        return section
    return int(section) if section.lstrip("+-").isdigit() else number


Stage = ZaberAsciiStage
Light = ScpiLight
Camera = Annotated[SimulatedEvk4 | MetavisionCamera, Field(discriminator="driver")]


class Station(Words):
    """A station file."""

    format: Literal["starbench/station/1"]
    name: Name
    laboratory: Text | None = None
    operator: Text | None = None
    stage: Stage
    light: Light
    camera: Camera
    target: Target = Target()
    collimator: Collimator = Collimator()
    disk: Disk = Disk()
    simulation: Annotated[dict[str, Any], BeforeValidator(_plain_values)] | None = None

    @property
    def is_simulated(self) -> bool:
        """Whether any device of it is a simulated one."""
        ports = (self.stage.port, self.light.port, getattr(self.camera, "address", ""))
        return any(port.startswith(SIMULATED) for port in ports)


def load_station(name_or_path: str) -> Located[Station]:
    """Read a station file, or a shipped station by its name (``simulated``).

    Raises
    ------
    DocumentFaults
        With every fault found.
    """
    return read_document(find_document(name_or_path, SHIPPED), Station)
