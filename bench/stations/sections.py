"""Bases of the sections of stages, lights and cameras in a station file. A plug-in's section derives from one of them.

A section holds the keys of a driver, with ranges and defaults, and opens the driver. The built-in sections are in
`station_stages`, `station_lights` and `station_cameras`; `devices` opens most of those. This module loads no plug-in,
so a plug-in may import it. docs/plugins.md is for its authors.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import Annotated, Any

from pydantic import Field, field_validator
from pydantic_core import PydanticCustomError

from bench.stations.station_fields import Serial, Text
from drivers.camera import EventCamera
from drivers.camera.frames import FrameCamera, FrameSettings
from drivers.clock import Clock
from drivers.light import Light, LightSettings
from drivers.stage import AxisLimits, Stage
from drivers.wire_log import WireLog
from sequences.plain_number import Within
from sequences.schema import Angle, Axis
from sequences.script import Flicker
from sequences.strict_model import StrictModel

NotNegative = Annotated[int, Field(ge=0, le=8191)]
Pixels = Annotated[int, Field(gt=0, le=8192)]
Hertz = Annotated[float, Within(0.001, 1e7, "Hz")]
PortName = Callable[[str], str]
"""Returns the system's name of a port: of a simulated one, the name that it has today."""


class AxisConfig(StrictModel):
    """Keys of every rotary axis. Each driver has a scale in its own counts; it is never guessed from a name."""

    zero_deg: Annotated[Angle, Field(description="Angle at which the counter of the controller is 0.")] = 0.0
    limits_deg: Annotated[
        tuple[Angle, Angle], Field(description="Lowest and highest angle allowed on the bench.")
    ]
    speed_deg_s: Annotated[float, Within(0.001, 1000, "deg/s")]
    acceleration_deg_s2: Annotated[float, Within(0.001, 100_000, "deg/s^2")]
    tolerance_deg: Annotated[
        float,
        Within(1e-6, 1, "deg"),
        Field(description="Largest distance from the target at the end of a move."),
    ] = 0.002

    @field_validator("limits_deg")
    @classmethod
    def _in_order(cls, limits: tuple[float, float]) -> tuple[float, float]:
        if limits[0] >= limits[1]:
            raise PydanticCustomError("limits_order", "the lower limit must be below the upper one.")
        if not limits[0] <= 0 <= limits[1]:
            raise PydanticCustomError(
                "no_zero", "0 degrees must be within the limits: the stage is parked there."
            )
        return limits

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


class StageSection(StrictModel):
    """A stage section that opens its own driver: one with a description, or a plug-in's.

    A subclass has the keys ``driver`` (a Literal) and ``axes``, a mapping of pan, tilt and roll to a subclass of
    `AxisConfig`.
    """

    driver: str
    axes: Mapping[Axis, AxisConfig]

    @property
    @abstractmethod
    def ports(self) -> tuple[str, ...]:
        """Ports of the stage."""

    @property
    def device_names(self) -> tuple[str, ...]:
        """Maker and serial number of each controller, which one process at a time may hold; none by default."""
        return ()

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


class LightSection(StrictModel):
    """A light section that opens its own driver: one with a description, or a plug-in's.

    A subclass has the key ``driver``, a Literal.
    """

    driver: str
    frequency_range_hz: tuple[Hertz, Hertz] = (1.0, 1_000.0)
    sync_output: bool = True

    @property
    @abstractmethod
    def ports(self) -> tuple[str, ...]:
        """Ports of the light."""

    @property
    def device_names(self) -> tuple[str, ...]:
        """Maker and serial number of each controller, which one process at a time may hold; none by default."""
        return ()

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


class BiasesConfig(StrictModel):
    """Bias offsets from the factory values, within the ranges of the IMX636. The default is 0."""

    bias_diff_on: Annotated[int, Field(ge=-150, le=200)] = 0
    bias_diff_off: Annotated[int, Field(ge=-150, le=200)] = 0
    bias_fo: Annotated[int, Field(ge=-150, le=200)] = 0
    bias_hpf: Annotated[int, Field(ge=0, le=255)] = 0
    bias_refr: Annotated[int, Field(ge=-50, le=255)] = 0


class EventCameraConfig(StrictModel):
    """Keys of every event camera."""

    serial: Serial
    biases: BiasesConfig = BiasesConfig()
    roi: Annotated[
        tuple[NotNegative, NotNegative, Pixels, Pixels] | None,
        Field(
            description="Region of interest: column, row, width, height, px. Only the driver `metavision` sets it."
        ),
    ] = None
    lens: Text | None = None

    @property
    def ports(self) -> tuple[str, ...]:
        """Ports of the camera; a camera on USB has none."""
        return ()


class EventCameraSection(EventCameraConfig):
    """A section of an event camera that opens its own driver: a plug-in's. A subclass has the key ``driver``."""

    driver: str

    @abstractmethod
    def open_device(self, port: PortName, *, clock: Clock) -> EventCamera:
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


class FrameCameraConfig(StrictModel):
    """Keys of every frame camera. Its light is steady."""

    serial: Annotated[
        str, Field(max_length=64, description="Serial number on USB. If it is empty, any camera is accepted.")
    ] = ""
    lens: Text | None = None
    pictures: Annotated[
        int, Field(ge=1, le=1000, description="Number of pictures that are averaged at each pose.")
    ] = 8

    @property
    def ports(self) -> tuple[str, ...]:
        """Ports of the camera; most have none."""
        return ()

    def settings(self) -> FrameSettings:
        """Return the settings for the driver.

        Returns
        -------
        FrameSettings
            Exposure and gain in the units of the camera's driver; None leaves them unchanged.
        """
        return FrameSettings()


class FrameCameraSection(FrameCameraConfig):
    """A section of a frame camera that opens its own driver: a plug-in's. A subclass has the key ``driver``."""

    driver: str

    @abstractmethod
    def open_device(self, port: PortName, *, clock: Clock) -> FrameCamera:
        """Open the camera.

        Parameters
        ----------
        port, clock
            See `StageSection.open_device`.

        Returns
        -------
        FrameCamera
            The open camera.

        Raises
        ------
        drivers.errors.DriverError
            If it cannot be opened, or is not the one that the section names.
        """
