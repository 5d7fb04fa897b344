"""Devices that a dead process has left: they are opened anew, made safe, and asked how they stand.

Nothing else is moved or switched. Devices of a simulated bench have ended with the process.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from typing import Any

from bench.base.clock import BenchClock
from bench.record.device_end import NOT_ASKED, DeviceEnd, DeviceName
from bench.stations.devices import stop_stage, switch_off
from bench.stations.sections import AnyLight, AnyStage
from bench.stations.station import Station
from bench.stations.station_fields import SIMULATED_PREFIX


def make_orphans_safe(station: Station, clock: BenchClock) -> list[DeviceEnd]:
    """Stop stage and light whose process died, each opened anew; return what they answered. Not simulated ones."""
    ends = []
    asked: tuple[tuple[DeviceName, AnyStage | AnyLight, Callable[[Any], str]], ...] = (
        ("stage", station.stage, stop_stage),
        ("light", station.light, switch_off),
    )
    for name, section, make_safe in asked:
        if any(port.startswith(SIMULATED_PREFIX) for port in section.ports):
            continue
        try:
            with closing(section.open_device(str, clock=clock, wire_log=None)) as device:
                ends.append(DeviceEnd(name, "confirmed safe", make_safe(device)))
        except Exception as error:  # noqa: BLE001 - whatever a driver does, the light is asked, too
            fault = f"the {name} of a dead process could not be made safe: {error}"
            ends.append(DeviceEnd(name, "not confirmed", fault))
    return [*ends, DeviceEnd("camera", "not confirmed", NOT_ASKED)] if ends else []
