"""Slices of the simulated bench for tests of the live figures: RAW files with events and sync edges, and photographs."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulators.optics.lens_focus import blur_px
from simulators.optics.scene import picture
from simulators.pixels.evt3_writer import Evt3Writer
from simulators.pixels.sensor import Sensor
from simulators.world.truth import NOISE_LEVELS, LensTruth, OpticsTruth, Truth
from simulators.world.world import FULL_DRIVE_V, LightState

HEADER = (
    b"% evt 3.0\n% format EVT3;height=720;width=1280\n% geometry 1280x720\n% serial_number 00050423\n% end\n"
)


def bench(*, psf_px: float = 0.7, roll_deg: float = 10.0, circle_px: float = 0.0, **truth: Any) -> Truth:
    """Return the simulated bench, its camera rolled against the target, its lens out of focus by a blur circle."""
    optics = OpticsTruth(psf_px=psf_px, mounting_deg=(0.31, -0.22, roll_deg))
    focused = dataclasses.replace(Truth(), optics=optics, **truth)
    if circle_px <= 0.0:
        return focused
    at_1_m = blur_px(dataclasses.replace(focused, lens=LensTruth(focus_distance_m=1.0)))
    return dataclasses.replace(focused, lens=LensTruth(focus_distance_m=at_1_m / circle_px))


def seen(truth: Truth, **angles_deg: float) -> NDArray[np.float32]:
    """Return the share of the light at each pixel with the gimbal at some angles."""
    return picture(truth, angles_deg)


def fired(share: NDArray[np.float32], *, level_percent: float = 100.0, seed: int = 1) -> NDArray[np.float32]:
    """Return about the event image of a bright square flicker, without the time it takes to simulate a sensor.

    A pixel fires at a small share of the light, with a threshold of its own.
    """
    thresholds = np.random.default_rng(seed).normal(1.0, 0.1, share.shape) * 4.0 / level_percent
    return (share > thresholds).astype(np.float32)


def write_slice(
    path: Path,
    light_share: NDArray[np.float32],
    *,
    periods: int = 1,
    noise: str = "typical",
    triggers: bool = True,
    seed: int = 1,
    light: LightState | None = None,
) -> Path:
    """Write a RAW file of some whole periods and one more of a picture under a flickering light."""
    light = light or LightState(output=True, sync=True)
    phase = float(np.random.default_rng(seed).random())
    length_us = math.ceil((periods + 1) * light.period_us + 1000.0)
    sensor = Sensor(noise=NOISE_LEVELS[noise], camera_seed=7, seed=seed)
    sensor.begin(light_share, light, phase)
    events = sensor.run(length_us)
    first = -phase * light.period_us % light.period_us
    up = np.arange(first - light.period_us, length_us + light.period_us, light.period_us)
    edges = np.concatenate([up, up + light.high_share * light.period_us])
    values = np.repeat(np.array([1, 0], np.uint8), len(up))
    inside = (edges >= 0) & (edges < length_us) & triggers
    order = np.argsort(edges[inside])
    triggers_us, values = edges[inside][order].astype(np.int64), values[inside][order]
    words = Evt3Writer().write(*events, until_us=length_us + 1, trigger_t=triggers_us, trigger_value=values)
    path.write_bytes(HEADER + words.astype("<u2").tobytes())
    return path


def drive(level_percent: float = 100.0, **light: Any) -> LightState:
    """Return a light that is on at a level."""
    return LightState(**({"output": True, "sync": True} | light), high_v=FULL_DRIVE_V * level_percent / 100.0)
