"""Locks on the devices of a station by family and serial number, in addition to the locks on their ports.

The same controller may be reachable through a second port (a network, a second cable, another name of the
same port). The lock on a port does not cover that.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager

from bench.stations.station import Station
from drivers.file_lock import DeviceHold


def serial_devices(station: Station) -> tuple[str, ...]:
    """Name, as ``Zaber 100101``, stage and light whose serial numbers the station file has, not simulated ones."""
    return tuple(dict.fromkeys((*station.stage.device_names, *station.light.device_names)))


@contextmanager
def hold_devices(devices: Iterable[str]) -> Iterator[None]:
    """Lock devices from `serial_devices` on this computer during the block; `PortBusy` if one is in use."""
    with ExitStack() as holds:
        for device in devices:
            holds.callback(DeviceHold(device).release)
        yield
