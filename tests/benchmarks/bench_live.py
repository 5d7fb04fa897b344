"""How accurate the figures of a live picture are, on simulated slices of one flicker period and one more.

    python tests/benchmarks/bench_live.py [--rows focus | turn]

``focus``: for levels of the light and diameters of the blur circle, the edge width and the number of stars. ``turn``:
distance of the tag from the middle of the image, px, after the turn that the figures give.
"""

import tempfile
from pathlib import Path
from typing import Any

import measured
import numpy as np

from bench.extras.pages.align.live_figures import LiveFigures, LiveMeter, LiveSetting, LiveSlice
from bench.stations.station import load_station
from simulators.optics.picture import TARGET, project, true_rotation
from tests.support.live_slices import bench, drive, seen, write_slice

SETTING = LiveSetting.of_station(load_station("simulated").value, frequency_hz=60.0, light_on=True)


def figures(
    folder: Path, truth: Any, angles: dict[str, float], light: Any, meter: LiveMeter, at_s: float
) -> LiveFigures:
    """Return the figures of a slice."""
    path = write_slice(folder / "slice.raw", seen(truth, **angles), light=light, seed=int(at_s) + 1)
    return meter.measure(LiveSlice(path, at_s, None, angles), SETTING)[1]


def focus_rows(folder: Path) -> None:
    """Print the focus figures."""
    print("light        circle px | edge px  stars")
    for waveform, level in (("square", 100.0), ("square", 30.0), ("square", 10.0), ("sine", 100.0)):
        for circle in (0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 14.0, 18.0, 24.0):
            live_figures = []
            for number, roll in enumerate((10.0, 17.0, 33.0)):
                truth = bench(circle_px=circle, roll_deg=roll)
                angles = {"pan": 1.0 - number, "tilt": 0.5 * number}
                light = drive(level, waveform=waveform)
                live_figures.append(figures(folder, truth, angles, light, LiveMeter(), float(number)))
            widths = [f.edge_width_px for f in live_figures if f.edge_width_px is not None]
            edge = f"{min(widths):.2f}-{max(widths):.2f}" if widths else "-"
            stars = "/".join(str(len(f.stars)) for f in live_figures)
            print(f"{waveform} {level:4.0f} % {circle:7.0f} | {edge}  {stars}", flush=True)


def turn_rows(folder: Path) -> None:
    """Print the errors of turns."""
    print("pan tilt circle | by | tag after the turn px")
    for circle, level in ((0.0, 100.0), (10.0, 10.0), (20.0, 10.0)):
        for pan, tilt in ((3.0, -2.0), (-6.0, 4.0), (8.0, 5.0), (12.0, -6.0), (17.0, 0.0)):
            truth, angles = bench(circle_px=circle), {"pan": pan, "tilt": tilt}
            f = figures(folder, truth, angles, drive(level), LiveMeter(), 0.0)
            there = {"pan": pan + (f.turn.pan or 0.0), "tilt": tilt + (f.turn.tilt or 0.0)}
            tag = project(np.array([TARGET.tag_centre_mm]), true_rotation(there, truth), truth)[0]
            print(
                f"{pan:3.0f} {tilt:4.0f} {circle:6.0f} | {f.turn.of:4s} | "
                f"{np.hypot(tag[0] - 639.5, tag[1] - 359.5):6.1f}",
                flush=True,
            )


def main() -> None:
    rows = {"focus": focus_rows, "turn": turn_rows}
    parser = measured.options(__doc__)
    parser.add_argument("--rows", choices=tuple(rows), action="append")
    with tempfile.TemporaryDirectory() as folder:
        for name in parser.parse_args().rows or rows:
            rows[name](Path(folder))


if __name__ == "__main__":
    measured.run(main, "align", "Focus and turns")
