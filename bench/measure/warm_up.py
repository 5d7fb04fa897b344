"""Compiles the loops that find stars, by measuring a drawn recording: `python -m bench.measure.warm_up`."""

from __future__ import annotations

import gc
import tempfile
from pathlib import Path

import numpy as np

from bench.measure.measure import Measurement, measure
from calib.target import StarTarget

#: The drawn recording: sensor, frequency of the lamp, how often it is switched, and a pixel on the target.
_WIDTH, _HEIGHT, _HZ, _SWITCHED, _PIXEL_MM = 1280, 720, 60.0, 7, 255.0 / 3345.0


def measure_drawing() -> Measurement:
    """Draw a recording and measure it."""
    target = StarTarget()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "warm-up.raw"
        _draw(path, target)
        return measure(path, name="warm-up", target=target, image="auto", periods=2, expected_hz=_HZ)


def _draw(path: Path, target: StarTarget) -> None:
    """Write a recording of the target behind a lamp that is switched on and off: EVT3 words of Prophesee."""
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


if __name__ == "__main__":
    gc.disable()  # compiling makes millions of small objects; looking for cycles among them takes 7 % of the time
    measure_drawing()
