"""Slices of the simulated bench for tests of the live figures: RAW files with events and sync edges, and photographs."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from simulators.optics.picture import render, true_rotation
from simulators.pixels.evt3_writer import Evt3Writer
from simulators.pixels.sensor import Sensor
from simulators.world.truth import NOISE_LEVELS, OpticsTruth, Truth
from simulators.world.world import FULL_DRIVE_V, LightState

HEADER = b"% evt 3.0\n% format EVT3;height=720;width=1280\n% geometry 1280x720\n% serial_number 00050423\n% end\n"


def bench(psf_px: float = 0.7, roll_deg: float = 10.0, **truth: Any) -> Truth:
    """Return the simulated bench with the camera rolled against the target."""
    optics = OpticsTruth(psf_px=psf_px, mounting_deg=(0.31, -0.22, roll_deg))
    return dataclasses.replace(Truth(), optics=optics, **truth)


def picture(truth: Truth, angles_deg: dict[str, float], circle_px: float = 0.0) -> NDArray[np.float32]:
    """Return the share of the light at each pixel, blurred by a circle of the given diameter as a lens out of focus."""
    sharp = render(truth, true_rotation(angles_deg, truth))
    if circle_px <= 0.5:
        return sharp
    side = math.ceil(circle_px) + 2
    fine = np.zeros((8 * (2 * side + 1),) * 2, np.float32)
    middle = (fine.shape[0] - 1) / 2.0
    y, x = np.indices(fine.shape)
    fine[np.hypot(x - middle, y - middle) <= 4.0 * circle_px] = 1.0
    kernel = cv2.resize(fine, (2 * side + 1,) * 2, interpolation=cv2.INTER_AREA)
    return cv2.filter2D(sharp, cv2.CV_32F, kernel / kernel.sum(), borderType=cv2.BORDER_REFLECT)


def write_slice(
    path: Path,
    seen: NDArray[np.float32],
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
    sensor.begin(seen, light, phase)
    events = sensor.run(length_us)
    first = -phase * light.period_us % light.period_us
    up = np.arange(first - light.period_us, length_us + light.period_us, light.period_us)
    edges = np.concatenate([up, up + light.high_share * light.period_us])
    values = np.repeat(np.array([1, 0], np.uint8), len(up))
    inside = (edges >= 0) & (edges < length_us) & triggers
    order = np.argsort(edges[inside])
    words = Evt3Writer().write(
        *events,
        until_us=length_us + 1,
        trigger_t=edges[inside][order].astype(np.int64),
        trigger_value=values[inside][order],
    )
    path.write_bytes(HEADER + words.astype("<u2").tobytes())
    return path


def drive(level_percent: float = 100.0, **light: Any) -> LightState:
    """Return a light that is on at a level."""
    return LightState(**({"output": True, "sync": True} | light), high_v=FULL_DRIVE_V * level_percent / 100.0)
