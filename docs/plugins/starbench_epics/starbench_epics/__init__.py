"""Axes that are EPICS motor records, as a plug-in of Starbench: their section of a station file.

The driver, and with it caproto, is imported when the stage is opened: station files are read without it.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from bench.stations.sections import AxisConfig, PortName, StageSection
from bench.stations.station_fields import Text
from drivers.clock import Clock
from drivers.stage import Stage
from drivers.wire_log import WireLog
from sequences.schema import Axis


class EpicsAxisConfig(AxisConfig):
    """An axis in the station file."""

    record: Text
    home: Literal["HOMF", "HOMR"] = "HOMF"


class EpicsStageConfig(StageSection):
    """The section of the station file."""

    driver: Literal["epics_motor"]
    axes: Annotated[dict[Axis, EpicsAxisConfig], Field(min_length=1, max_length=3)]

    @property
    def ports(self) -> tuple[str, ...]:
        """The records: what names the device."""
        return tuple(axis.record for axis in self.axes.values())

    @property
    def device_names(self) -> tuple[str, ...]:
        """Only one process at a time may use a record."""
        return tuple(f"EPICS {record}" for record in self.ports)

    def open_device(self, port: PortName, *, clock: Clock, wire_log: WireLog | None) -> Stage:  # noqa: ARG002
        """Connect to the records. Nothing moves."""
        from starbench_epics.stage import EpicsAxis, EpicsStage

        axes = [
            EpicsAxis(name=name, limits=axis.limits, **axis.driver_options())
            for name, axis in self.axes.items()
        ]
        return EpicsStage(axes, clock=clock)
