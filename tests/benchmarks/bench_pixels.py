"""Speed of the simulated sensor: CPU seconds for a simulated second, one thread, compilation excluded.

The work: 1280 x 720, the star target in front of an f = 3345 px camera, contrast 10 : 1, thresholds of 25 %,
60 Hz. Each figure is the median of some slices of one flicker period, with the 95th percentile. Heavy noise is given twice: 10 Hz background
with 2e-4 hot pixels at 2 kHz and 12 % mismatch, as the published comparison has it, and the configuration's
``heavy`` (20 Hz, 5e-4, 25 %). Memory is that of a process of its own, which imports and simulates 33 ms: as
the words of a stream, and as one list of events. Beside
them stand those of published simulators on the same kind of work, measured once on a machine of the same class;
they are not run here.

    python tests/benchmarks/bench_pixels.py [--write]
"""

from __future__ import annotations

import subprocess
import sys
import time
from dataclasses import dataclass
from typing import Literal

import measured
import numpy as np

from simulators.optics import picture as optics
from simulators.pixels.evt3_writer import Evt3Writer
from simulators.pixels.sensor import Events, Sensor
from simulators.world.truth import NOISE_LEVELS, NoiseTruth, Truth
from simulators.world.world import LightState

PERIOD_US = 1e6 / 60.0
SLICES = 6
BUSY = NoiseTruth(mismatch=0.12, background_hz=10.0, hot_share=2e-4, hot_hz=2000.0, reset_noise=0.01)

PUBLISHED = (
    ("ESIM, square, 10 000 frames/s", 56.0),
    ("OpenEB simulator, square, 10 000 frames/s", 66.0),
    ("v2e clean, square, 10 000 frames/s", 139.0),
    ("IEBCS, square, 1000 and 10 000 frames/s", 120.0),
    ("ESIM, sine, 5000 frames/s", 43.0),
    ("OpenEB simulator, sine, 5000 frames/s", 32.0),
    ("v2e noisy, sine, 10 000 frames/s", 417.0),
    ("IEBCS, sine, 1000 frames/s", 224.0),
)
"""CPU seconds for a simulated second; none of them models the readout."""


@dataclass
class Figure:
    name: str
    cpu: measured.Spread
    events_s: float
    events: Events

    def __str__(self) -> str:
        return f"{self.name:44s} {self.cpu.text(2)} {self.events_s / 1e6:7.1f} Mev/s {self.event_ns:6.1f} ns/event"

    @property
    def event_ns(self) -> float:
        """Median CPU time of an event."""
        return 1e9 * self.cpu.median_s / self.events_s


def measure(name: str, picture: np.ndarray, waveform: Literal["square", "sine"], noise: NoiseTruth) -> Figure:
    """Slices of one flicker period, scaled to a second."""
    sensor = Sensor(noise=noise, camera_seed=1, seed=1)
    light = LightState(waveform=waveform, output=True)
    sensor.begin(picture, light, 0.3)
    times, events = [], sensor.run(0.0)
    for k in range(1, SLICES + 1):
        begin = time.process_time()
        events = sensor.run(k * PERIOD_US)
        times.append(60.0 * (time.process_time() - begin))
    return Figure(name, measured.spread(times), len(events.t) * 60.0, events)


def writing_times(events: Events) -> measured.Spread:
    """CPU times of writing events as EVT3 words."""
    times = []
    for _ in range(5):
        start = int(events.t[0]) // 16 * 16
        writer = Evt3Writer(start)
        begin = time.process_time()
        writer.write(*events, until_us=int(events.t[-1]) + 1)
        times.append(time.process_time() - begin)
    return measured.spread(times)


MEMORY = """
import numpy as np
import numba
def peak_mb():
    status = open("/proc/self/status").read()
    return int(status.split("VmHWM:")[1].split()[0]) / 1024
before = peak_mb()
from simulators.pixels.evt3_writer import Evt3Writer
from simulators.pixels.sensor import Sensor
from simulators.world.world import LightState
picture = np.random.default_rng(0).random((720, 1280), np.float32)
sensor, writer = Sensor(), Evt3Writer()
sensor.begin(picture, LightState(waveform="{waveform}", output=True), 0.3)
n, words = 0, []
for end_us in [*range({step_us}, 33_000, {step_us}), 33_000]:
    events = sensor.run(end_us)
    n += len(events.t)
    if {written}:
        words.append(writer.write(*events, until_us=end_us).copy())
print(f"{{peak_mb():.0f}} MB, {{before:.0f}} of them numpy and numba; {{n / 1e6:.1f}} million events")
"""


def memory(waveform: str, step_us: int, *, written: bool) -> str:
    """Peak memory of a process that simulates 33 ms of a dense picture, so much at a time."""
    script = MEMORY.format(waveform=waveform, step_us=step_us, written=written)
    command = [sys.executable, "-c", script]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def sensor_figures(picture: np.ndarray) -> list[Figure]:
    """The figures of the sensor; the first two slices are not counted (they compile)."""
    measure("", picture, "square", NOISE_LEVELS["none"]), measure("", picture, "sine", NOISE_LEVELS["none"])
    return [
        measure("square, typical noise", picture, "square", NOISE_LEVELS["typical"]),
        measure("square, 10 Hz background, 2e-4 hot pixels", picture, "square", BUSY),
        measure("square, heavy noise (20 Hz, 5e-4)", picture, "square", NOISE_LEVELS["heavy"]),
        measure("sine, typical noise, link full", picture, "sine", NOISE_LEVELS["typical"]),
    ]


def picture_of_a_pose() -> np.ndarray:
    truth = Truth()
    return optics.render(truth, optics.pose_rotation({"pan": 1.0, "tilt": -1.0}, truth.optics))


def main() -> None:
    picture_of_a_pose()
    begin = time.process_time()
    picture = picture_of_a_pose()
    render_s = time.process_time() - begin
    print("CPU time for a simulated second, this simulator (readout, link and noise included)")
    figures = sensor_figures(picture)
    for figure in figures:
        print(figure)
    print("\npublished simulators, pixels only          CPU time   times this one's typical")
    for name, cpu_s in PUBLISHED:
        own = figures[3 if "sine" in name else 0].cpu.median_s
        print(f"{name:44s} {cpu_s:7.1f} s {cpu_s / own:6.0f}")
    writing_times(figures[0].events)
    square, sine = (
        writing_times(events).rates(len(events.t) / 1e6) for events in (figures[0].events, figures[3].events)
    )
    print(f"\nEVT3 writing, Mev per CPU s, median and 95 %: {square} (square), {sine} (sine)")
    print(f"rendering a pose: {render_s:.2f} s")
    for waveform in ("square", "sine"):
        streamed, at_once = memory(waveform, 2000, written=True), memory(waveform, 33_000, written=False)
        print(f"peak memory, 33 ms, {waveform}, as words, 2 ms at a time as the stream does: {streamed}")
        print(f"peak memory, 33 ms, {waveform}, as one list of events: {at_once}")


if __name__ == "__main__":
    measured.run(main, "simulated-bench", "The simulated sensor")
