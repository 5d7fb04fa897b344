"""Compiles the loops of the program by using each once. numba keeps them on the disk; later processes read them.

`bench.terminal.compiling` calls this module for each part in a process of its own. The stage does not move.
"""

from __future__ import annotations

import gc
import os
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import cast

import click

from bench.base.clock import BenchClock
from bench.base.home import PARTS, remove_stale_kernels, set_kernel_cache
from bench.terminal.compiling import compile_missing
from drivers.errors import RecordingFailed

_DURATION_S = 0.051
_ATTEMPTS = 5


def compile_part(part: str) -> None:
    """Compile a part in this process, by using it once.

    Raises drivers.errors.DriverError, SimulationError: When the simulated bench does not work on this
      computer.
    """
    gc.disable()  # compiling makes millions of small objects; looking for cycles among them takes 7 % of the time
    with tempfile.TemporaryDirectory() as folder:
        {"stars": _record_and_measure}[part](Path(folder))


def _record_and_measure(folder: Path) -> None:
    """Make one recording with the simulated bench, and measure it."""
    from bench.stations.devices import Devices
    from bench.stations.station import load_station
    from bench.views.measure import measure
    from drivers.camera import CameraSettings, EventCamera
    from drivers.light import LightSettings

    station = load_station("simulated").value
    devices = Devices(station, seed=0, clock=BenchClock(), wire_log=None)
    try:
        camera = cast("EventCamera", devices.camera)
        camera.apply(CameraSettings())
        devices.light.apply(LightSettings())
        devices.light.on()
        path = folder / "warm-up.raw"
        for _ in range(_ATTEMPTS):  # the driver's deadline passes while the simulated camera is compiled
            with suppress(RecordingFailed):
                camera.record(path, _DURATION_S)
                break
            path = path.with_stem(f"{path.stem}-again")
    finally:
        devices.make_safe()
        devices.close()
    target = station.target.pattern()
    measure(path, name="warm-up", target=target, image="auto", periods=2, expected_hz=60.0)


if __name__ == "__main__":
    if sys.argv[1:]:
        compile_part(sys.argv[1])
    else:
        set_kernel_cache(os.environ)
        remove_stale_kernels()
        compile_missing(PARTS, click.echo)
