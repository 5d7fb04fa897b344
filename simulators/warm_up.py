"""Loads the machine code of the pixel model, and compiles what is missing, by using it once.

python -m simulators.warm_up
"""

from __future__ import annotations

import gc

from simulators.config import BenchConfig
from simulators.pixels.sensor_stream import CameraState, SensorStream
from simulators.world.truth import Truth
from simulators.world.world import LightState, World


def warm_up(truth: Truth) -> None:
    """Let a simulated sensor make one frame."""
    world = World(truth)
    world.set_light(LightState(output=True, sync=True))
    SensorStream(world, CameraState(trigger_in=True), {}).next_frame()


if __name__ == "__main__":
    gc.disable()  # compiling makes millions of small objects; looking for cycles among them takes 7 % of the time
    warm_up(BenchConfig().truth_for(seed=0))
