"""Compiles the loops of the program by using each once; later processes read them from the disk. The stage stays."""

from __future__ import annotations

import gc
import os
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, cast

import click

from bench.base.clock import BenchClock
from bench.base.compile_missing import compile_missing
from bench.base.kernel_cache import PARTS, remove_stale_kernels, set_kernel_cache
from drivers.errors import RecordingFailed

if TYPE_CHECKING:
    from calib.target import StarTarget

_DURATION_S = 0.051  # A little more than three periods of 60 Hz
_ATTEMPTS = 5  # Each fails while the simulated camera is compiled
#: The drawn recording: sensor, frequency of the lamp, how often it is switched, and a pixel on the target.
_WIDTH, _HEIGHT, _HZ, _SWITCHED, _PIXEL_MM = 1280, 720, 60.0, 7, 255.0 / 3345.0


def compile_part(part: str) -> None:
    """Compile a part in this process, by using it once."""
    gc.disable()  # compiling makes millions of small objects; looking for cycles among them takes 7 % of the time
    with tempfile.TemporaryDirectory() as folder:
        {"stars": _measure, "simulator": _record}[part](Path(folder))


def _measure(folder: Path) -> None:
    """Draw a recording and measure it."""
    from bench.measure.measure import measure
    from calib.target import StarTarget

    target = StarTarget()
    path = folder / "warm-up.raw"
    _draw(path, target)
    measure(path, name="warm-up", target=target, image="auto", periods=2, expected_hz=_HZ)


def _draw(path: Path, target: StarTarget) -> None:
    """Write a recording of the target behind a lamp that is switched on and off: EVT3 words of Prophesee."""
    import numpy as np

    rng = np.random.default_rng(0)
    v, u = np.indices((_HEIGHT, _WIDTH))
    x_mm, y_mm = target.tag_centre_mm
    bright = target.reflectance(x_mm + _PIXEL_MM * (u - _WIDTH / 2), y_mm + _PIXEL_MM * (v - _HEIGHT / 2))
    y, x = np.nonzero(bright > 0.5)
    times = [(k + 1) * 5e5 / _HZ + rng.gamma(2.0, 150.0, len(x)) for k in range(_SWITCHED)]
    t = np.concatenate(times).astype(np.int64)
    on = np.repeat(np.arange(_SWITCHED) % 2 == 0, len(x))
    order = np.argsort(t, kind="stable")
    x, y, t, on = np.tile(x, _SWITCHED)[order], np.tile(y, _SWITCHED)[order], t[order], on[order]
    words = np.column_stack([0x8000 | t >> 12, 0x6000 | t & 0xFFF, y, 0x2000 | on << 11 | x])
    header = (
        f"% evt 3.0\n% format EVT3;height={_HEIGHT};width={_WIDTH}\n% geometry {_WIDTH}x{_HEIGHT}\n% end\n"
    )
    path.write_bytes(header.encode() + words.astype("<u2").tobytes())


def _record(folder: Path) -> None:
    """Make one recording with the simulated bench."""
    from bench.stations.devices import Devices
    from bench.stations.station import load_station
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
        for _ in range(_ATTEMPTS):  # the driver's deadline passes meanwhile
            with suppress(RecordingFailed):
                camera.record(path, _DURATION_S)
                break
            path = path.with_stem(f"{path.stem}-again")
    finally:
        devices.make_safe()
        devices.close()


if __name__ == "__main__":
    if sys.argv[1:]:
        compile_part(sys.argv[1])
    else:
        set_kernel_cache(os.environ)
        remove_stale_kernels()
        compile_missing(PARTS, click.echo)
