"""By which names a station's serial devices are kept to one process, beside their ports: family and serial number.

The same controller may be reached by another port as well (a network, a second cable, another name of the same
port), which no lock of a port knows.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from bench.stations import station_lights, station_stages
from bench.stations.station import Station
from bench.stations.station_fields import SIMULATED_PREFIX
from drivers.device_hold import DeviceHold


def serial_devices(station: Station) -> tuple[str, ...]:
    """Name the devices of stage and light that the station file knows by number; simulated ones need no lock.

    A strobe controller tells no number, and a generator or a board may go without.
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
    return tuple(dict.fromkeys(real))


@contextmanager
def hold_serial_devices(station: Station) -> Iterator[None]:
    """Keep the serial devices of a station to this process, for as long as the block lasts.

    Raises
    ------
    drivers.errors.PortBusy
        When another process of this computer has one of them, by whatever port.
    """
    with ExitStack() as holds:
        for device in serial_devices(station):
            holds.callback(DeviceHold(device).release)
        yield
