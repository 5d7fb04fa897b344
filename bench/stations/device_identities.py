"""Locks on the devices of a station by family and serial number, in addition to the locks on their ports.

The same controller may be reachable through a second port (a network, a second cable, another name of the same port).
The lock on a port does not cover that.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager

from bench.stations import station_lights, station_stages
from bench.stations.sections import LightSection, StageSection
from bench.stations.station import Station
from bench.stations.station_fields import SIMULATED_PREFIX
from drivers.device_hold import DeviceHold


def serial_devices(station: Station) -> tuple[str, ...]:
    """Name the stage and light devices whose serial numbers are in the station file, except simulated ones.

    A strobe controller has no serial number, and that of a generator or a board is optional in the file.

    Returns: Family and serial number of each device, such as ``Zaber 100101``, without repetition.
    """
    found: list[tuple[str, str, str | None]] = []
    match station.stage:
        case station_stages.ZaberStageConfig() as config:
            found += [(config.port, "Zaber", axis.serial) for axis in config.axes.values()]
        case station_stages.XimcStageConfig() as config:
            found += [(axis.port, "Standa", axis.serial) for axis in config.axes.values()]
        case station_stages.EspStageConfig() as config:
            found += [(config.port, "Newport", axis.serial) for axis in config.axes.values()]
        case station_stages.GrblStageConfig() as config:
            found.append((config.port, "GRBL", config.serial))
    if isinstance(station.light, station_lights.ScpiLightConfig):
        found.append((station.light.port, "generator", station.light.serial))
    real = [
        f"{family} {serial}"
        for port, family, serial in found
        if serial and not port.startswith(SIMULATED_PREFIX)
    ]
    for section in (station.stage, station.light):
        if isinstance(section, StageSection | LightSection) and not any(
            port.startswith(SIMULATED_PREFIX) for port in section.ports
        ):
            real += section.device_names
    return tuple(dict.fromkeys(real))


@contextmanager
def hold_serial_devices(station: Station) -> Iterator[None]:
    """Lock the serial devices of a station against other processes of this computer, for the duration of the block.

    Yields: While the devices are locked.
    Raises drivers.errors.PortBusy: When another process uses one of the devices, through any port.
    """
    with hold_devices(serial_devices(station)):
        yield


@contextmanager
def hold_devices(devices: Iterable[str]) -> Iterator[None]:
    """Lock devices against other processes of this computer, for the duration of the block.

    devices: Family and serial number of each, from `serial_devices`.
    Yields: While the devices are locked.
    Raises drivers.errors.PortBusy: When another process uses one of the devices, through any port.
    """
    with ExitStack() as holds:
        for device in devices:
            holds.callback(DeviceHold(device).release)
        yield
