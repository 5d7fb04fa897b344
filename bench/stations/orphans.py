"""Devices that a dead process has left: they are opened anew, stopped and switched off, and asked how they stand.

Nothing else is moved or switched. Devices of a simulated bench have ended with the process.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing

from bench.base.clock import BenchClock
from bench.base.device_ends import NOT_ASKED, DeviceEnd, DeviceName
from bench.stations.devices import open_light, open_stage, stop_stage, switch_off
from bench.stations.station import Station
from bench.stations.station_fields import SIMULATED_PREFIX
from drivers.errors import DriverError


def make_orphans_safe(station: Station, clock: BenchClock) -> list[DeviceEnd]:
    """Stop the stage and switch the light off after the process that used them has died.

    Each device is opened anew, even if the other one fails.

    clock: Every wait of a driver goes through it.
    Returns: What stage and light answered; the camera is not asked. Simulated devices are left out: none is
      there to ask.
    """
    ends = []
    asked: tuple[tuple[DeviceName, list[str], Callable[[Station, BenchClock], str]], ...] = (
        ("stage", list(station.stage.ports), _stop_stage),
        ("light", list(station.light.ports), _switch_off),
    )
    for name, ports, make_safe in asked:
        if any(port.startswith(SIMULATED_PREFIX) for port in ports):
            continue
        try:
            ends.append(DeviceEnd(name, "confirmed safe", make_safe(station, clock)))
        except DriverError as error:
            fault = f"the {name} of a dead process could not be made safe: {error}"
            ends.append(DeviceEnd(name, "not confirmed", fault))
    return [*ends, DeviceEnd("camera", "not confirmed", NOT_ASKED)] if ends else []


def _stop_stage(station: Station, clock: BenchClock) -> str:
    with closing(open_stage(station, str, clock, None)) as stage:
        return stop_stage(stage)


def _switch_off(station: Station, clock: BenchClock) -> str:
    with closing(open_light(station, str, clock, None)) as light:
        return switch_off(light)
