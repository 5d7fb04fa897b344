"""The events of the simulated sensor that a still picture under a flicker causes."""

import numpy as np
from numpy.typing import NDArray

from simulators.pixels.biases import PixelSettings
from simulators.pixels.sensor import Events, Link, Sensor
from simulators.world.truth import NOISE_LEVELS, NoiseTruth
from simulators.world.world import LightState


def simulate(
    picture: NDArray[np.float32],
    light: LightState,
    duration_us: float,
    *,
    phase: float = 0.0,
    noise: NoiseTruth = NOISE_LEVELS["typical"],
    settings: PixelSettings | None = None,
    camera_seed: int = 0,
    seed: int = 0,
    link: Link | None = None,
) -> Events:
    """Return a still picture's events under a flicker, from 0 to before ``duration_us``; ``phase`` in periods."""
    height, width = picture.shape
    sensor = Sensor(
        width, height, noise=noise, settings=settings, camera_seed=camera_seed, seed=seed, link=link
    )
    sensor.begin(picture, light, phase)
    return sensor.run(duration_us)
