"""Recordings of 33 ms of the simulated bench without devices: events of one pose, the flicker, and their images."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from still_picture import simulate

from calib.events.event_image import EventImages, make_images
from calib.events.flicker import Flicker
from simulators.optics.picture import render
from simulators.world.truth import Truth
from simulators.world.world import LightState

WINDOW_US = 33_000.0
"""As in the paper."""


def record(
    truth: Truth, rotation: NDArray[np.float64], waveform: str, seed: int, noise: Any = None
) -> tuple[Any, Flicker]:
    """Return the events of a pose, camera <- target, and the flicker of the light, whose phase the seed draws."""
    light = LightState(waveform=waveform, output=True, sync=True)
    phase = float(np.random.default_rng(seed).random())
    picture = render(truth, rotation)
    seeds = {"camera_seed": 7, "seed": seed}
    events = simulate(picture, light, WINDOW_US, phase=phase, noise=noise or truth.noise, **seeds)
    edge_us = -phase * light.period_us % light.period_us
    return events, Flicker(light.period_us, edge_us, 0.5, 0.0, 0, "triggers")


def images_of(
    truth: Truth, events: Any, flicker: Flicker, window_us: tuple[float, float] = (0.0, WINDOW_US)
) -> EventImages:
    size = (truth.camera.width, truth.camera.height)
    return make_images(events.t, events.x, events.y, events.p, size, flicker, window_us=window_us)
