"""Compiles the event kernels ahead of the first run: numba keeps them beside the code, for every run that follows.

One recording of the simulated bench, from light to stars, passes through all of them. The stage does not move.
"""

from __future__ import annotations

import tempfile
from contextlib import suppress
from pathlib import Path
from typing import cast

import click

from bench.base.clock import BenchClock
from bench.stations.devices import Devices
from bench.stations.station import load_station
from bench.views.measure import measure
from drivers.camera import CameraSettings, EventCamera
from drivers.errors import RecordingFailed
from drivers.light import LightSettings

_DURATION_S = 0.051
_ATTEMPTS = 5


def warm_up() -> int:
    """Record and measure once; return the number of stars seen.

    Raises
    ------
    drivers.errors.DriverError, SimulationError
        When the simulated bench does not work here.
    """
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
    finally:
        devices.make_safe()
        devices.close()
    return found.stars


def _recorded(camera: EventCamera, folder: Path) -> Path:
    """Record, however long the kernels take to be compiled: a slow machine outlasts the driver's patience."""
    *tries, last = (folder / f"warm-up-{number}.raw" for number in range(_ATTEMPTS))
    for path in tries:
        with suppress(RecordingFailed):
            camera.record(path, _DURATION_S)
            return path
    camera.record(last, _DURATION_S)
    return last


if __name__ == "__main__":
    click.echo(f"Event kernels are compiled ({warm_up()} stars seen).")
