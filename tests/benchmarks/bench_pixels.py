"""Speed of the simulated sensor: CPU seconds for a simulated second, one thread, compilation excluded.

The work: 1280 x 720, the star target in front of an f = 3345 px camera, contrast 10 : 1, thresholds of 25 %, 60 Hz. Each
figure is the median of some slices of one flicker period, with the 95th percentile. Heavy noise is given twice: 10 Hz
background with 2e-4 hot pixels at 2 kHz and 12 % mismatch, as the published comparison has it, and the configuration's
``heavy`` (20 Hz, 5e-4, 25 %). The page has those of published simulators on the same kind of work, measured once.

    python tests/benchmarks/bench_pixels.py [--write]
"""

import time
from dataclasses import dataclass
from typing import Literal

import measured
import numpy as np

from simulators.optics import picture as optics
from simulators.pixels.sensor import Sensor
from simulators.world.truth import NOISE_LEVELS, NoiseTruth, Truth
from simulators.world.world import LightState

PERIOD_US = 1e6 / 60.0
SLICES = 6
BUSY = NoiseTruth(mismatch=0.12, background_hz=10.0, hot_share=2e-4, hot_hz=2000.0, reset_noise=0.01)


@dataclass
class Figure:
    name: str
    cpu: measured.Spread
    events_s: float

    def __str__(self) -> str:
        event_ns = 1e9 * self.cpu.median_s / self.events_s
        return f"{self.name:44s} {self.cpu.text(2)} {self.events_s / 1e6:7.1f} Mev/s {event_ns:6.1f} ns/event"


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
    return Figure(name, measured.spread(times), len(events.t) * 60.0)


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
    print("CPU time for a simulated second, this simulator (readout, link and noise included)")
    for figure in sensor_figures(picture_of_a_pose()):
        print(figure)


if __name__ == "__main__":
    measured.run(main, "simulated-bench", "The simulated sensor")
