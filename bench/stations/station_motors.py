"""The stage sections of Thorlabs rotation stages and of Dynamixel servos, and how they open their drivers."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field
from pydantic_core import PydanticCustomError

from bench.stations.placeholders import UNKNOWN_PORT, ToFillIn
from bench.stations.sections import AxisConfig, PortName, StageSection
from bench.stations.station_fields import SIMULATED_PREFIX, Port, Serial, Text
from drivers.clock import Clock
from drivers.stage import Stage
from drivers.stage.dynamixel import DynamixelAxis, DynamixelStage
from drivers.stage.thorlabs import ThorlabsAxis, ThorlabsStage
from drivers.wire_log import WireLog
from sequences.plain_number import Within
from sequences.schema import Axis


def _not_zero(scale: float) -> float:
    if scale == 0:
        raise PydanticCustomError("no_scale", "a scale of 0 moves nothing.")
    return scale


_Scale = Annotated[
    float,
    AfterValidator(_not_zero),
    Within(0.01, 1e9, "counts/deg", either_sign=True),
    ToFillIn,
]


def _each_its_own(key: str) -> AfterValidator:
    """Return a check that no two axes have the same value of a key; what is not filled in yet does not count."""

    def check(axes: dict[Axis, Any]) -> dict[Axis, Any]:
        given = [value for axis in axes.values() if (value := getattr(axis, key)) != UNKNOWN_PORT]
        if len(set(given)) < len(given):
            raise PydanticCustomError("same_address", "two axes have the same {key}.", {"key": key})
        return axes

    return AfterValidator(check)


class ThorlabsAxisConfig(AxisConfig):
    """One axis, on its own Thorlabs controller."""

    port: Port
    serial: Annotated[Serial, Field(description="Serial number of the controller, from its label.")]
    counts_per_deg: Annotated[
        _Scale,
        Field(
            description="136533.333 for a K10CR1, 1919.6418579 for a PRM1Z8; negative if the counter decreases."
        ),
    ]
    tolerance_deg: Annotated[
        float,
        Within(1e-6, 1, "deg"),
        Field(description="Largest distance from the target at the end of a move."),
    ] = 0.005


class ThorlabsStageConfig(StageSection):
    """One to three Thorlabs rotation stages (K10CR1, or on a KDC101 and the like), each on its own port."""

    driver: Literal["thorlabs_apt"]
    axes: Annotated[dict[Axis, ThorlabsAxisConfig], Field(min_length=1, max_length=3), _each_its_own("port")]

    @property
    def ports(self) -> tuple[str, ...]:
        """Ports of the controllers."""
        return tuple(axis.port for axis in self.axes.values())

    @property
    def device_names(self) -> tuple[str, ...]:
        """Maker and serial number of each controller that is not simulated."""
        return tuple(
            f"Thorlabs {axis.serial}"
            for axis in self.axes.values()
            if not axis.port.startswith(SIMULATED_PREFIX)
        )

    def open_device(self, port: PortName, *, clock: Clock, wire_log: WireLog | None) -> Stage:
        """See `StageSection.open_device`."""
        axes = [
            ThorlabsAxis(name=name, limits=axis.limits, **(axis.driver_options() | {"port": port(axis.port)}))
            for name, axis in self.axes.items()
        ]
        return ThorlabsStage.open(axes, clock=clock, wire_log=wire_log)


class DynamixelAxisConfig(AxisConfig):
    """One axis, turned by a Dynamixel servo of the X series."""

    id: Annotated[int, Field(ge=0, le=252, description="Id of the servo on the bus.")]
    model: Annotated[
        Text,
        Field(description="Model of the servo, such as XL430-W250; another one with this id is refused."),
    ]
    counts_per_deg: Annotated[
        _Scale,
        Field(
            description="11.377778 without a gear; times the ratio of a gear; negative if the counter decreases."
        ),
    ]
    zero_count: Annotated[
        int,
        Field(ge=0, le=4095, description="Count of the servo, within its turn, at the angle zero_deg."),
    ] = 2048
    tolerance_deg: Annotated[
        float,
        Within(1e-6, 1, "deg"),
        Field(description="Largest distance from the target at the end of a move."),
    ] = 0.3


class DynamixelStageConfig(StageSection):
    """One to three Dynamixel servos of the X series on one bus (Protocol 2.0)."""

    driver: Literal["dynamixel"]
    port: Port
    baudrate: Annotated[int, Within(50, 20_000_000, "Bd")] = 57_600
    axes: Annotated[dict[Axis, DynamixelAxisConfig], Field(min_length=1, max_length=3), _each_its_own("id")]

    @property
    def ports(self) -> tuple[str, ...]:
        """Port of the adapter."""
        return (self.port,)

    def open_device(self, port: PortName, *, clock: Clock, wire_log: WireLog | None) -> Stage:
        """See `StageSection.open_device`."""
        axes = [
            DynamixelAxis(name=name, limits=axis.limits, **axis.driver_options())
            for name, axis in self.axes.items()
        ]
        return DynamixelStage.open(
            port(self.port), axes, baudrate=self.baudrate, clock=clock, wire_log=wire_log
        )
