"""Compiles the event kernels before the first run. numba keeps them on the disk, so that later runs start at once.

It makes one recording with the simulated bench and measures it; that uses every kernel. The stage does not move.
"""

from __future__ import annotations

import tempfile
from contextlib import suppress
from pathlib import Path
from typing import cast

import click

from bench.align.live_figures import LiveSetting, LiveSlice, measure_live
from bench.base.clock import BenchClock
from bench.base.kernel_cache import remove_stale_kernels
from bench.stations.devices import Devices
from bench.stations.station import load_station
from bench.views.measure import measure
from drivers.camera import CameraSettings, EventCamera
from drivers.errors import RecordingFailed
from drivers.light import LightSettings

_DURATION_S = 0.051
_ATTEMPTS = 5


def warm_up() -> int:
    """Make one recording with the simulated bench and measure it.

    Raises drivers.errors.DriverError, SimulationError: When the simulated bench does not work on this
      computer.
    """
    remove_stale_kernels()
    station = load_station("simulated").value
    devices = Devices(station, seed=0, clock=BenchClock(), wire_log=None)
    try:
        camera = cast("EventCamera", devices.camera)
        camera.apply(CameraSettings())
        devices.light.apply(LightSettings())
        devices.light.on()
        with tempfile.TemporaryDirectory() as folder:
            path = _recorded(camera, Path(folder))
            found = measure(
                path,
                name="warm-up",
                target=station.target.pattern(),
                image="auto",
                periods=2,
                expected_hz=60.0,
            )
            measure_live(LiveSlice(path), LiveSetting.of_station(station, frequency_hz=60.0, light_on=True))
    finally:
        devices.make_safe()
        devices.close()
    return found.stars


def _recorded(camera: EventCamera, folder: Path) -> Path:
    """Record, several times if the driver's deadline passes while the kernels of the simulated camera are compiled."""
    *tries, last = (folder / f"warm-up-{number}.raw" for number in range(_ATTEMPTS))
    for path in tries:
        with suppress(RecordingFailed):
            camera.record(path, _DURATION_S)
            return path
    camera.record(last, _DURATION_S)
    return last


if __name__ == "__main__":
    click.echo(f"Event kernels are compiled (test recording: {warm_up()} stars found).")
