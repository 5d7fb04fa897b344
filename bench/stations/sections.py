"""Bases of the sections of stages, lights and cameras in a station file; a plug-in's section derives from one.

A section holds a driver's keys and opens it; this module loads no plug-in. docs/plugins.md is for their authors.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeVar

from pydantic import (
    AfterValidator,
    Field,
    field_validator,
)

from bench.base.clock import BenchClock
from bench.stations.placeholders import Unknown
from bench.stations.station_fields import SIMULATED_PREFIX, Frame, Serial, Text
from drivers.camera import EventCamera
from drivers.camera.frames import FrameCamera, FrameSettings
from drivers.clock import Clock
from drivers.light import Light, LightSettings
from drivers.serial_port import LineSettings
from drivers.stage import AxisLimits, Stage
from drivers.wire_log import WireLog
from sequences.schema import Angle, Axis
from sequences.script import Flicker
from sequences.strict_model import StrictModel, Within

NotNegative = Annotated[int, Field(ge=0, le=8191)]
Pixels = Annotated[int, Field(gt=0, le=8192)]
Hertz = Annotated[float, Within(0.001, 1e7, "Hz")]
Speed = Annotated[float, Within(0.001, 1000, "deg/s")]
_A = TypeVar("_A")
PortName = Callable[[str], str]
"""Returns the system's name of a port: of a simulated one, the name that it has today."""


Tolerance = Annotated[
    float,
    Within(1e-6, 1, "deg"),
    Field(description="Largest distance from the target at the end of a move."),
]
Controllers = Sequence[tuple[str, str | None]]
"""Port and serial number of each controller of a section; None where the section states no number."""

Bias = Annotated[int, Field(ge=-255, le=2047)]


class AxisConfig(StrictModel):
    """Keys of every rotary axis. Each driver has a scale in its own counts; it is never guessed from a name."""

    scale_key: ClassVar[str] = ""
    """The key that holds the steps of a degree; empty where the controller counts in degrees."""

    zero_deg: Angle = 0.0
    """Angle at which the counter of the controller is 0."""
    limits_deg: tuple[Angle, Angle]
    """Lowest and highest angle allowed on the bench."""
    speed_deg_s: Speed
    acceleration_deg_s2: Annotated[float, Within(0.001, 100_000, "deg/s^2")]
    tolerance_deg: Tolerance = 0.002  # Moves the image by 0.12 px at a focal length of 3345 px

    @field_validator("limits_deg")
    @classmethod
    def _in_order(cls, limits: tuple[float, float]) -> tuple[float, float]:
        if limits[0] >= limits[1]:
            raise ValueError("the lower limit must be below the upper one.")
        if not limits[0] <= 0 <= limits[1]:
            raise ValueError("0 degrees must be within the limits: the stage is parked there.")
        return limits

    @property
    def step_deg(self) -> float:
        """Angle of one step of the controller, degrees; 0 where it counts in degrees."""
        return 1.0 / abs(getattr(self, self.scale_key)) if self.scale_key else 0.0

    @property
    def limits(self) -> AxisLimits:
        """Limits, speed and acceleration for the driver."""
        return AxisLimits(*self.limits_deg, self.speed_deg_s, self.acceleration_deg_s2)

    def driver_options(self) -> dict[str, Any]:
        """Return the values besides the limits, as parameters of the driver's axis.

        Returns
        -------
        dict
            Values by parameter name.
        """
        return self.model_dump(exclude={"limits_deg", "speed_deg_s", "acceleration_deg_s2"})


class SerialLine(StrictModel):
    """Keys of a serial line that every driver with one port has; each driver has its own baud rate."""

    rtscts: bool | None = None
    """Whether the line has hardware flow control (RTS/CTS). Default: as the maker of the device says."""
    frame: Frame | None = None
    """Data bits, parity and stop bits. Default: as the maker of the device says."""
    xonxoff: bool | None = None
    """Whether the bytes XON and XOFF hold the sender. Default: false."""

    def line(self, clock: Clock, wire_log: WireLog | None) -> dict[str, Any]:
        """Return how the driver opens the line, by name; what is not stated is as the controller's family has it."""
        stated = self.model_dump(include=set(LineSettings._fields), exclude_none=True)
        return {"line": stated, "clock": clock, "wire_log": wire_log}


class _Section(StrictModel):
    """What the sections of stages and lights share."""

    maker: ClassVar[str] = ""
    """Word before the serial numbers of its controllers; empty if it names none."""

    if TYPE_CHECKING:

        @property
        def driver(self) -> str: ...

    @property
    def controllers(self) -> Controllers:
        """Controllers of the device: one for each axis with a port or a serial number of its own, else one."""
        parts = [*getattr(self, "axes", {}).values()] or [self]
        port, serial = (getattr(self, key, None) for key in ("port", "serial"))
        used = [(getattr(part, "port", port), getattr(part, "serial", serial)) for part in parts]
        return list(dict.fromkeys((own, number) for own, number in used if own is not None))

    @property
    def ports(self) -> tuple[str, ...]:
        """Ports of the device."""
        return tuple(dict.fromkeys(port for port, _ in self.controllers))

    @property
    def device_names(self) -> tuple[str, ...]:
        """Maker and serial number of each controller, which one process at a time may hold; none by default."""
        named = (
            f"{self.maker} {serial}"
            for port, serial in self.controllers
            if self.maker and serial and not port.startswith(SIMULATED_PREFIX)
        )
        return tuple(dict.fromkeys(named))


class AnyStage(_Section):
    """A stage section that opens its own driver."""

    if TYPE_CHECKING:

        @property
        def axes(self) -> Mapping[Axis, AxisConfig]: ...  # noqa: D102 - a key

    @abstractmethod
    def open_device(self, port: PortName, *, clock: Clock, wire_log: WireLog | None) -> Stage:
        """Open the stage. Nothing moves.

        Parameters
        ----------
        port
            Returns the system's name of a port.
        clock
            Every wait of the driver goes through it.
        wire_log
            Records the bytes on serial lines; None to record nothing.

        Returns
        -------
        Stage
            The open stage.

        Raises
        ------
        drivers.errors.DriverError
            If it cannot be opened, or is not the one that the section names.
        """


class StageSection(AnyStage):
    """A stage section of a plug-in.

    A subclass has the keys ``driver`` (a Literal) and ``axes``, a mapping of pan, tilt and roll to a subclass of
    `AxisConfig`.
    """

    driver: str
    axes: Mapping[Axis, AxisConfig]

    @property
    @abstractmethod
    def ports(self) -> tuple[str, ...]:
        """Ports of the stage."""


class AnyLight(_Section):
    """A light section that opens its own driver."""

    if TYPE_CHECKING:

        @property
        def frequency_range_hz(self) -> tuple[float, float]: ...  # noqa: D102 - a key
        @property
        def sync_output(self) -> bool: ...  # noqa: D102 - a key

    def settings(self, flicker: Flicker) -> LightSettings:
        """Convert the flicker of a sequence to settings of the driver, which takes 5 V as full level.

        Parameters
        ----------
        flicker
            Waveform, frequency and level.

        Returns
        -------
        LightSettings
            The level is in ``high_v``, V.
        """
        return LightSettings(
            waveform=flicker.waveform,
            frequency_hz=flicker.frequency_hz,
            duty_percent=flicker.duty_percent,
            high_v=LightSettings.high_v * flicker.level_percent / 100,
            sync_output=self.sync_output,
        )

    @abstractmethod
    def open_device(self, port: PortName, *, clock: Clock, wire_log: WireLog | None) -> Light:
        """Open the light. Nothing is switched.

        Parameters
        ----------
        port, clock, wire_log
            See `StageSection.open_device`.

        Returns
        -------
        Light
            The open light.

        Raises
        ------
        drivers.errors.DriverError
            If it cannot be opened, or is not the one that the section names.
        """


class LightSection(AnyLight):
    """A light section of a plug-in. A subclass has the key ``driver``, a Literal."""

    driver: str
    frequency_range_hz: tuple[Hertz, Hertz] = (1.0, 1_000.0)
    sync_output: bool = True

    @property
    @abstractmethod
    def ports(self) -> tuple[str, ...]:
        """Ports of the light."""


def driver_axes(kind: Callable[..., _A], axes: Mapping[Axis, AxisConfig], port: PortName) -> list[_A]:
    """Return the axes of a stage as its driver takes them; the names of parameters are those of the keys."""
    made = []
    for name, axis in axes.items():
        options = axis.driver_options()
        if "port" in options:
            options["port"] = port(options["port"])
        made.append(kind(name=name, limits=axis.limits, **options))
    return made


def differing(*keys: str) -> AfterValidator:
    """Return a check that no two axes have the same values of these keys; an open placeholder does not count."""

    def check(axes: dict[Axis, Any]) -> dict[Axis, Any]:
        given = [tuple(getattr(axis, key) for key in keys) for axis in axes.values()]
        filled = [values for values in given if Unknown.PORT not in values]
        if len(set(filled)) < len(filled):
            shared = " and ".join(keys)
            raise ValueError(f"two axes have the same {shared}.")
        return axes

    return AfterValidator(check)


class BiasesConfig(StrictModel):
    """Biases in the steps of the sensor; the camera knows the ranges. Those not named keep the factory value."""

    bias_diff_on: Bias = 0
    bias_diff_off: Bias = 0
    bias_fo: Bias = 0
    bias_hpf: Bias = 0
    bias_refr: Bias = 0

    def named(self) -> dict[str, int]:
        """Return the biases that the station names.

        Returns
        -------
        dict[str, int]
            Value by name.
        """
        return self.model_dump(exclude_unset=True)


class _CameraSection(StrictModel):
    """What the sections of cameras share."""

    if TYPE_CHECKING:

        @property
        def driver(self) -> str: ...

    lens: Text | None = None

    @property
    def ports(self) -> tuple[str, ...]:
        """Ports of the camera; most have none."""
        return ()


class EventCameraSection(_CameraSection):
    """An event camera section that opens its own driver. A subclass has the key ``driver``, a Literal."""

    serial: Serial
    biases: BiasesConfig = BiasesConfig()
    roi: tuple[NotNegative, NotNegative, Pixels, Pixels] | None = None
    """Region of interest: column, row, width, height, px. Only the driver `metavision` sets it."""

    @abstractmethod
    def open_device(self, port: PortName, *, clock: BenchClock) -> EventCamera:
        """Open the camera.

        Parameters
        ----------
        port, clock
            See `StageSection.open_device`.

        Returns
        -------
        EventCamera
            The open camera.

        Raises
        ------
        drivers.errors.DriverError
            If it cannot be opened, or is not the one that the section names.
        """


class FrameCameraSection(_CameraSection):
    """A frame camera section that opens its own driver. A subclass has the key ``driver``. Its light is steady."""

    serial: Annotated[str, Field(max_length=64)] = ""
    """Serial number on USB. If it is empty, any camera is accepted."""
    pictures: Annotated[int, Field(ge=1, le=1000)] = 8
    """Number of pictures that are averaged at each pose."""

    def settings(self) -> FrameSettings:
        """Return the settings for the driver.

        Returns
        -------
        FrameSettings
            Exposure and gain in the units of the camera's driver; None leaves them unchanged.
        """
        return FrameSettings()

    @abstractmethod
    def open_device(self, port: PortName, *, clock: BenchClock) -> FrameCamera:
        """See `EventCameraSection.open_device`."""
